"""Force Dimension with a fake library: forces, order of calls, and one-line errors."""

from __future__ import annotations

import ctypes
import math
import pickle
from types import SimpleNamespace

import numpy as np
import pytest
from fake_driver import FakeDriver, built

from touchfield.devices.drivers import forcedimension
from touchfield.devices.drivers.forcedimension import ForceDimension, quaternion_of_rows
from touchfield.devices.drivers.registry import point_device
from touchfield.errors import DeviceError, InvalidArgument
from touchfield.medium.pose_track import rotation_matrices
from touchfield.render.standby import _write_zero

VARIABLE = "TOUCHFIELD_FORCEDIMENSION_LIBRARY"


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    return built("fake_dhd", tmp_path_factory.mktemp("dhd"))


@pytest.fixture
def fake(library, monkeypatch):
    monkeypatch.setenv(VARIABLE, str(library))
    driver = FakeDriver(library)
    yield driver
    assert not driver.faults, driver.faults


def test_positions_and_forces_are_passed_and_the_last_force_is_zero(fake) -> None:
    device = pickle.loads(pickle.dumps(point_device("forcedimension").opener))()
    device.open()
    positions_m = []
    for n in range(20):
        positions_m.append(device.position_m())
        device.put_force_n(float(n), 0.5, -1.0)
    device.close()
    device.close()
    assert positions_m == [(0.001 * n, -0.01, 0.02) for n in range(20)]
    assert fake.forces.tolist() == [[0, 0, 0], *([n, 0.5, -1] for n in range(20)), [0, 0, 0]]
    assert fake.log == "OEeC"


def torques(fake) -> np.ndarray:
    """All torques sent with the forces, newton metres, [n, 3]."""
    fake.library.fake_torques.restype = ctypes.POINTER(ctypes.c_double)
    return np.ctypeslib.as_array(fake.library.fake_torques(), (len(fake.forces), 3)).copy()


def test_wrist_has_an_orientation_and_a_torque_that_ends_at_zero(fake) -> None:
    fake.library.fake_wrist(1)
    device = ForceDimension()
    device.open()
    half = math.sqrt(0.5)
    assert device.orientation() == pytest.approx((half, 0, 0, half))
    assert device.buttons() == 5 and device.gripper_m() == 0.017
    device.put_wrench(1.0, 2.0, 3.0, 0.0, 0.0, 0.05)
    device.put_wrench(1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    with pytest.raises(DeviceError, match="newton metres"):
        device.put_wrench(1.0, 0.0, 0.0, math.nan, 0.0, 0.0)
    device.put_wrench(0.0, 0.0, 0.5, 0.0, 0.1, 0.0)
    device.close()
    assert fake.forces.tolist() == [[0, 0, 0], [1, 2, 3], [1, 0, 0], [0, 0, 0.5], [0, 0, 0]]
    assert torques(fake).tolist() == [[0, 0, 0], [0, 0, 0.05], [0, 0, 0], [0, 0.1, 0], [0, 0, 0]]


def test_new_connection_ends_the_torque_of_a_killed_process(fake) -> None:
    fake.library.fake_wrist(1)
    killed = ForceDimension()
    killed.open()
    killed.put_wrench(1.0, 0.0, 0.0, 0.0, 0.0, 0.05)
    fake.library.dhdEnableForce(0, 0)
    fake.library.dhdClose(0)  # as the system does; the torque remains
    killed._lock.release()
    answers: list[str] = []
    _write_zero(ForceDimension, SimpleNamespace(send=answers.append))
    assert answers == [""] and not fake.faults
    assert not torques(fake)[-1].any() and not fake.forces[-1].any()


def test_loading_the_library_does_not_contact_the_device(fake, monkeypatch) -> None:
    before = fake.log
    ForceDimension().load()
    assert fake.log == before
    monkeypatch.setenv(VARIABLE, "/nowhere/libdhd.so")
    with pytest.raises(DeviceError, match="nowhere"):
        ForceDimension().load()


def test_torque_that_cannot_be_zeroed_turns_the_motors_off(fake) -> None:
    fake.library.fake_wrist(1)
    device = ForceDimension()
    device.open()
    device.put_wrench(1.0, 0.0, 0.0, 0.0, 0.0, 0.05)
    fake.fail("dhdSetForceAndTorqueAndGripperForce", 0)
    device.close()
    assert fake.forces[-1].tolist() == [0, 0, 0] and fake.log.endswith("eC") and not fake.faults


def test_device_without_a_wrist_gets_no_torque_calls(fake) -> None:
    device = ForceDimension()
    device.open()
    assert (device.orientation(), device.buttons(), device.gripper_m()) == ((1, 0, 0, 0), 0, 0)
    device.put_wrench(1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    device.close()
    assert fake.forces.tolist() == [[0, 0, 0], [1, 0, 0], [0, 0, 0]]


@pytest.mark.parametrize(
    ("function", "message"),
    [
        ("dhdGetOrientationFrame", "orientation"),
        ("turn nan", "rotation"),
        ("dhdGetGripperGap", "gripper"),
        ("dhdSetForceAndTorqueAndGripperForce", "torque"),
    ],
)
def test_wrist_failure_is_an_error(fake, function, message) -> None:
    fake.library.fake_wrist(1)
    device = ForceDimension()
    device.open()
    fake.fail(function, 0)

    def run() -> None:
        device.orientation()
        device.gripper_m()
        device.put_wrench(0.0, 0.0, 0.0, 0.1, 0.0, 0.0)

    with pytest.raises(DeviceError, match=message):
        run()
    device.close()


@pytest.mark.parametrize("axis", range(4))
def test_quaternion_agrees_with_its_matrix(axis) -> None:
    q = np.random.default_rng(axis).normal(0, 0.2, 4)
    q[axis] += 1.0
    q /= np.linalg.norm(q)
    found = np.array(quaternion_of_rows(*rotation_matrices(q).ravel()))
    assert found * np.sign(found @ q) == pytest.approx(q, abs=1e-12)


def test_device_can_be_opened_again(fake) -> None:
    device = ForceDimension()
    device.open()
    device.open()
    assert device.position_m() == (0.0, -0.01, 0.02)
    device.close()
    assert fake.log == "OEeCOEeC"


@pytest.mark.parametrize("function", ["dhdOpen", "dhdEnableForce", "dhdSetForce"])
def test_failure_to_open_is_an_error_and_closes_the_device(fake, function) -> None:
    fake.fail(function, 0)
    device = ForceDimension()
    with pytest.raises(DeviceError, match="no device found") as caught:
        device.open()
    assert "\n" not in str(caught.value)
    assert fake.log == "O" if function == "dhdOpen" else fake.log.endswith("C")
    device.close()
    with pytest.raises(DeviceError, match="not open"):
        device.position_m()


@pytest.mark.parametrize("function", ["dhdGetPosition", "dhdSetForce", "nan"])
def test_device_failure_is_an_error(fake, function) -> None:
    device = ForceDimension()
    device.open()
    fake.fail(function, 5)

    def run() -> None:
        for _ in range(20):
            device.position_m()
            device.put_force_n(1.0, 0.0, 0.0)

    with pytest.raises(DeviceError, match=r"no device found|finite metres"):
        run()
    device.close()
    assert fake.log == "OEeC"


def test_forces_that_are_not_finite_are_not_sent(fake) -> None:
    device = ForceDimension()
    device.open()
    with pytest.raises(DeviceError, match="finite newtons"):
        device.put_force_n(0.0, math.inf, 0.0)
    device.close()
    assert not fake.forces.any()


def test_missing_library_error_says_how_to_install_it(monkeypatch, tmp_path) -> None:
    broken = tmp_path / "libdhd.so"
    broken.write_bytes(b"no library at all")
    for path in (broken, tmp_path / "missing.so"):
        monkeypatch.setenv(VARIABLE, str(path))
        with pytest.raises(
            DeviceError, match="Install the maker's SDK, or name its file in TOUCHFIELD_FORCE"
        ):
            ForceDimension().open()
        (check,) = forcedimension.DRIVER.checks()
        assert not check.is_there and VARIABLE in check.mend


def test_wrong_library_is_an_error(monkeypatch) -> None:
    monkeypatch.setenv(VARIABLE, "libm.so.6")
    with pytest.raises(DeviceError, match=r"no function dhdOpen|cannot|found"):
        ForceDimension().open()


def test_check_finds_the_library(fake) -> None:
    (check,) = forcedimension.DRIVER.checks()
    assert check.is_there and check.found == str(fake.path)


@pytest.mark.parametrize("serial", ["a", "-1", "65536", "1.5", "\u0661", "000001"])
def test_a_name_that_is_no_serial_number_is_refused(serial) -> None:
    with pytest.raises(InvalidArgument, match="forcedimension:SERIAL, a serial number"):
        point_device(f"forcedimension:{serial}")
