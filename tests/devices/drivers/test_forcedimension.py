"""Force Dimension against a fake library: every force arrives, calls come in order, a failure is one clear
line.
"""

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
from touchfield.render.servo import _write_zero

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


def test_positions_and_forces_pass_and_the_last_force_is_zero(fake) -> None:
    device = pickle.loads(pickle.dumps(point_device("forcedimension").opener))()
    device.open()
    places = []
    for n in range(20):
        places.append(device.position_m())
        device.put_force_n(float(n), 0.5, -1.0)
    device.close()
    device.close()
    assert places == [(0.001 * n, -0.01, 0.02) for n in range(20)]
    assert fake.forces.tolist() == [[0, 0, 0], *([n, 0.5, -1] for n in range(20)), [0, 0, 0]]
    assert fake.log == "OEeC"


def torques(fake) -> np.ndarray:
    """All torques that went with the forces, newton metres, [n, 3]."""
    fake.library.fake_torques.restype = ctypes.POINTER(ctypes.c_double)
    return np.ctypeslib.as_array(fake.library.fake_torques(), (len(fake.forces), 3)).copy()


def test_a_wrist_tells_how_it_is_turned_and_gets_the_torque_and_zero_in_the_end(fake) -> None:
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


def test_a_fresh_connection_ends_the_torque_of_a_process_that_was_killed(fake) -> None:
    fake.library.fake_wrist(1)
    killed = ForceDimension()
    killed.open()
    killed.put_wrench(1.0, 0.0, 0.0, 0.0, 0.0, 0.05)
    fake.library.dhdEnableForce(0, 0)
    fake.library.dhdClose(0)  # as the system does; the torque is put still
    answers: list[str] = []
    _write_zero(ForceDimension, SimpleNamespace(send=answers.append))
    assert answers == [""] and not fake.faults
    assert not torques(fake)[-1].any() and not fake.forces[-1].any()


def test_a_torque_that_cannot_be_zeroed_leaves_the_force_zero_and_the_motors_off(fake) -> None:
    fake.library.fake_wrist(1)
    device = ForceDimension()
    device.open()
    device.put_wrench(1.0, 0.0, 0.0, 0.0, 0.0, 0.05)
    fake.fail("dhdSetForceAndTorqueAndGripperForce", 0)
    device.close()
    assert fake.forces[-1].tolist() == [0, 0, 0] and fake.log.endswith("eC") and not fake.faults


def test_a_device_without_a_wrist_is_not_asked_for_it(fake) -> None:
    device = ForceDimension()
    device.open()
    assert (device.orientation(), device.buttons(), device.gripper_m()) == ((1, 0, 0, 0), 0, 0)
    device.put_wrench(1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    device.close()
    assert fake.forces.tolist() == [[0, 0, 0], [1, 0, 0], [0, 0, 0]]


@pytest.mark.parametrize(
    ("function", "words"),
    [
        ("dhdGetOrientationFrame", "orientation"),
        ("turn nan", "rotation"),
        ("dhdGetGripperGap", "gripper"),
        ("dhdSetForceAndTorqueAndGripperForce", "torque"),
    ],
)
def test_a_wrist_that_fails_is_told(fake, function, words) -> None:
    fake.library.fake_wrist(1)
    device = ForceDimension()
    device.open()
    fake.fail(function, 0)

    def run() -> None:
        device.orientation()
        device.gripper_m()
        device.put_wrench(0.0, 0.0, 0.0, 0.1, 0.0, 0.0)

    with pytest.raises(DeviceError, match=words):
        run()
    device.close()


@pytest.mark.parametrize("axis", range(4))
def test_a_quaternion_is_that_of_its_matrix(axis) -> None:
    q = np.random.default_rng(axis).normal(0, 0.2, 4)
    q[axis] += 1.0
    q /= np.linalg.norm(q)
    found = np.array(quaternion_of_rows(*rotation_matrices(q).ravel()))
    assert found * np.sign(found @ q) == pytest.approx(q, abs=1e-12)


def test_it_opens_again_and_twice_in_a_row(fake) -> None:
    device = ForceDimension()
    device.open()
    device.open()
    assert device.position_m() == (0.0, -0.01, 0.02)
    device.close()
    assert fake.log == "OEeCOEeC"


@pytest.mark.parametrize("function", ["dhdOpen", "dhdEnableForce", "dhdSetForce"])
def test_a_device_that_does_not_open_is_told_and_let_go(fake, function) -> None:
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
def test_a_device_that_goes_away_is_told(fake, function) -> None:
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


def test_a_force_that_is_no_number_is_not_sent(fake) -> None:
    device = ForceDimension()
    device.open()
    with pytest.raises(DeviceError, match="finite newtons"):
        device.put_force_n(0.0, math.inf, 0.0)
    device.close()
    assert not fake.forces.any()


def test_without_the_library_it_says_how_to_get_it(monkeypatch, tmp_path) -> None:
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


def test_a_library_of_something_else_is_told(monkeypatch) -> None:
    monkeypatch.setenv(VARIABLE, "libm.so.6")
    with pytest.raises(DeviceError, match=r"no function dhdOpen|cannot|found"):
        ForceDimension().open()


def test_the_check_finds_it(fake) -> None:
    (check,) = forcedimension.DRIVER.checks()
    assert check.is_there and check.found == str(fake.path)


def test_nothing_stands_behind_the_name() -> None:
    with pytest.raises(InvalidArgument, match="without a colon"):
        point_device("forcedimension:1")
