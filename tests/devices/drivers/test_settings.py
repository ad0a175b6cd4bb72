"""Settings of devices: gravity compensation and handedness, what `doctor` reports of them, and the delay that
it measures."""

from __future__ import annotations

import pickle
from contextlib import closing

import pytest
from fake_driver import FakeDriver
from fake_haply import fake_haply, fake_haply_with_settings

from touchfield.cli.main import _exit_code
from touchfield.devices.drivers import forcedimension, haply
from touchfield.devices.drivers.registry import point_device
from touchfield.errors import DeviceError, InvalidArgument
from touchfield.tasks.setup import examine


@pytest.mark.parametrize(
    ("device", "settings", "found"),
    [
        ("forcedimension", "gravity=maybe", "on or off"),
        ("forcedimension", "mass=0", "a number above 0, up to 5"),
        ("forcedimension", "mass=nan", "a number above 0"),
        ("forcedimension", "mass=heavy", "a number above 0"),
        ("forcedimension", "handedness=left", r"gravity=on\|off, mass=KG"),
        ("forcedimension", "gravity", r"gravity=on\|off"),
        ("forcedimension", "gravity=on,gravity=off", r"gravity=on\|off"),
        ("haply", "handedness=both", "left or right"),
        ("haply", "gravity=3", "a number above 0, up to 2"),
        ("haply", "gravity=", r"gravity=on\|off\|FACTOR, handedness=left\|right"),
        ("openhaptics", "gravity=on", "none: openhaptics has no settings"),
        ("sim", "gravity=on", "none: sim has no settings"),
    ],
)
def test_an_invalid_setting_is_one_clear_error(device: str, settings: str, found: str) -> None:
    with pytest.raises(InvalidArgument, match=f"--settings.*expected {found}"):
        point_device(device, settings=settings)


# -- Force Dimension


def test_gravity_compensation_of_force_dimension_is_set_before_forces_are_on(dhd: FakeDriver) -> None:
    opener = point_device("forcedimension:301", settings="gravity=off, mass=0.25").opener
    with closing(pickle.loads(pickle.dumps(opener))()) as arm:
        arm.open()
        assert dhd.library.fake_gravity() == 0 and dhd.library.fake_mass() == 0.25
    assert dhd.log == "OMGEeC"
    with closing(point_device("forcedimension", settings="gravity=on").opener()) as arm:
        arm.open()
    assert dhd.library.fake_gravity() == 1


def test_without_a_setting_the_library_keeps_its_own(dhd: FakeDriver) -> None:
    with closing(point_device("forcedimension").opener()) as arm:
        arm.open()
    assert "G" not in dhd.log and "M" not in dhd.log


def test_a_setting_that_fails_is_an_error_and_closes_the_device(dhd: FakeDriver) -> None:
    dhd.fail("dhdSetGravityCompensation", 0)
    arm = point_device("forcedimension", settings="gravity=off").opener()
    with pytest.raises(DeviceError, match="could not set the gravity compensation"):
        arm.open()
    assert dhd.log.endswith("C") and not dhd.forces.any()


def test_doctor_reports_handedness_and_gravity_of_force_dimension(dhd: FakeDriver) -> None:
    (unit,) = forcedimension.find_units()
    assert unit.settings == ("right-handed", "gravity compensation on")
    dhd.library.fake_hand(1)
    (arm,) = (check for check in examine("forcedimension")["forcedimension"] if "301" in check.what)
    assert arm.is_there and arm.found.endswith("started; left-handed; gravity compensation on")
    rows = {check.what: check.found for check in examine("forcedimension")["forcedimension"]}
    assert rows["settings (play --settings)"] == "gravity=on|off, mass=KG"


# -- Haply


def test_settings_of_an_inverse3_are_sent_and_read_back() -> None:
    with fake_haply_with_settings() as door:
        text = f"haply:127.0.0.1:{door.port}/04BA"
        arm = point_device(text, settings="gravity=0.8,handedness=left").opener()
        with closing(arm):
            arm.open()
            arm.position_m()
        assert door.posts == [
            ("/inverse3/04BA/config/gravity_compensation", {"enabled": True, "scaling_factor": 0.8}),
            ("/inverse3/04BA/config/handedness", {"handedness": "left"}),
        ]
        (unit,) = haply.find_units(f"127.0.0.1:{door.port}")
        assert unit.settings == ("left-handed", "gravity compensation on, factor 0.8")
        again = point_device(text, settings="gravity=0.8,handedness=left").opener()
        with closing(again):
            again.open()
        assert len(door.posts) == 2  # it has them


def test_gravity_compensation_of_an_inverse3_can_be_switched_off() -> None:
    with fake_haply_with_settings() as door:
        arm = point_device(f"haply:127.0.0.1:{door.port}", settings="gravity=off").opener()
        with closing(arm):
            arm.open()
        assert [content["enabled"] for _, content in door.posts] == [False]
        (unit,) = haply.find_units(f"127.0.0.1:{door.port}")
    assert unit.settings == ("right-handed", "gravity compensation off")


@pytest.mark.parametrize(
    ("options", "found"),
    [
        ({"status": 404}, "status 404 for /inverse3/04BA/config/handedness"),
        ({"is_deaf": True}, 'that 04BA did not take handedness = "left"'),
    ],
)
def test_a_service_that_takes_no_setting_is_an_error(options: dict, found: str) -> None:
    with fake_haply_with_settings(**options) as door:
        arm = point_device(f"haply:127.0.0.1:{door.port}", settings="handedness=left").opener()
        with closing(arm), pytest.raises(DeviceError, match=f"{found}.*the service's own program"):
            arm.open()
        assert not door.fake.forces


def test_a_service_without_http_is_an_error() -> None:
    with fake_haply() as fake:
        arm = point_device(f"haply:127.0.0.1:{fake.port}", settings="handedness=left").opener()
        with closing(arm), pytest.raises(DeviceError, match=r"setting.*from version 3\.5 on"):
            arm.open()


# -- the delay


def test_doctor_measures_the_delay_without_a_force() -> None:
    with fake_haply() as fake:
        (*_, check) = examine(f"haply:127.0.0.1:{fake.port}", measures_delay=True)["haply"]
    assert check.what == "delay from position to force"
    assert " ms in nine of ten ticks, " in check.found and check.found.endswith("no delay, 1 ms is assumed")
    assert fake.forces and not any(map(any, fake.forces))


def test_a_delay_that_cannot_be_measured_is_reported(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(InvalidArgument, match="a device with a position and a force"):
        examine("osc:127.0.0.1:9000", measures_delay=True)
    with pytest.raises(InvalidArgument, match="the device whose delay"):
        examine(measures_delay=True)
    (*_, check) = examine("haply:127.0.0.1:1", measures_delay=True)["haply"]
    assert not check.is_there and check.what == "delay from position to force"
    assert _exit_code(["doctor", "--delay"]) == 2
    assert "--device" in capsys.readouterr().err
