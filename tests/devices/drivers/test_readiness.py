"""Readiness and identity: the states of each driver, no force before that, and one user per unit."""

from __future__ import annotations

import ctypes
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from fake_driver import FakeDriver, built
from fake_haply import FakeHaply, fake_haply
from tests.render.player_makers import OMNI, numbered_medium
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import ServerConnection, serve

from touchfield import pipeline
from touchfield.cli.main import _exit_code
from touchfield.devices import device
from touchfield.devices.drivers import bhaptics, forcedimension, haply, openhaptics
from touchfield.devices.drivers.bhaptics import BHaptics
from touchfield.devices.drivers.forcedimension import ForceDimension
from touchfield.devices.drivers.haply import Haply
from touchfield.devices.drivers.openhaptics import OpenHaptics
from touchfield.devices.drivers.registry import Check, DeviceKind, point_device
from touchfield.devices.drivers.unit_lock import UnitLock
from touchfield.errors import DeviceAbsent, DeviceError, InvalidArgument, MissingExtra
from touchfield.options import duration_s
from touchfield.pipeline.spec import EncodeSpec
from touchfield.render.array_player import ArrayPlayer
from touchfield.render.player import Player
from touchfield.render.readiness import Readiness, open_when_ready
from touchfield.sources.tiny_scenes import tiny_scenes
from touchfield.tasks.setup import connected_units, device_checks

READY = {"calibrated": True, "in_use": False, "power_supply": True, "ready": True, "started": True}


# -- the wait, with a device that is told what to report


class Scripted:
    """Reports these states one after the other, the last for ever; an exception is raised by `open`."""

    title: ClassVar[str] = "arm"

    def __init__(self, *states: Readiness | Exception) -> None:
        self.states, self.log = list(states), ""

    def _next(self) -> Readiness | Exception:
        return self.states.pop(0) if len(self.states) > 1 else self.states[0]

    def open(self) -> None:
        self.log += "o"
        if isinstance(self.states[0], Exception):
            error = self._next()
            assert isinstance(error, Exception)
            raise error

    def readiness(self) -> Readiness:
        self.log += "r"
        state = self._next()
        assert isinstance(state, Readiness)
        return state

    def close(self) -> None:
        self.log += "c"


def test_a_device_that_reports_nothing_is_ready_at_once() -> None:
    arm = Scripted(Readiness())
    assert open_when_ready(arm, 0.0) and arm.log == "or"
    assert Readiness().text == "its driver reports no state"


def test_each_state_that_lasts_gives_one_note() -> None:
    cold = Readiness("A7", is_powered=False, is_calibrated=False, hint="Switch it on.")
    warm = Readiness("A7", is_powered=True, is_calibrated=False, hint="Calibrate it.")
    notes: list[str] = []
    arm = Scripted(cold, cold, cold, warm, warm, cold, Readiness("A7", is_powered=True, is_calibrated=True))
    assert open_when_ready(arm, 5.0, on_note=notes.append)
    assert notes == [
        "arm A7 is without power, not calibrated: waiting for it. Switch it on.",
        "arm A7 is not calibrated: waiting for it. Calibrate it.",
    ]


def test_a_device_that_does_not_get_ready_is_an_error_of_one_line_after_the_wait() -> None:
    arm = Scripted(Readiness("A7", is_calibrated=False, hint="Calibrate it."))
    before_s = time.monotonic()
    with pytest.raises(DeviceError) as caught:
        open_when_ready(arm, 0.2)
    assert 0.2 <= time.monotonic() - before_s < 2.0
    assert (
        str(caught.value)
        == "arm A7: found a device that is not calibrated; expected a ready one. Calibrate it."
    )


def test_an_absent_device_is_opened_again_and_another_error_ends_the_wait() -> None:
    absent = DeviceAbsent("arm", "none", "one")
    arm, notes = Scripted(absent, absent, absent, Readiness()), []
    assert open_when_ready(arm, 5.0, on_note=notes.append) and arm.log == "ocococor"
    assert notes == ["waiting for arm: found none; expected one"]
    with pytest.raises(DeviceAbsent, match="found none"):
        open_when_ready(Scripted(absent), 0.1)
    with pytest.raises(DeviceError, match="broken"):
        open_when_ready(Scripted(DeviceError("arm", "broken")), 5.0)


def test_a_stop_ends_the_wait() -> None:
    arm, stops = Scripted(Readiness(is_powered=False)), iter([False, False, True])
    assert not open_when_ready(arm, 60.0, lambda: next(stops)) and arm.log == "orr"


@pytest.mark.parametrize(
    ("text", "seconds"), [("30s", 30.0), ("0", 0.0), ("500ms", 0.5), ("1.5 min", 90.0), (" 2s ", 2.0)]
)
def test_durations(text: str, seconds: float) -> None:
    assert duration_s(text, "wait") == pytest.approx(seconds)


@pytest.mark.parametrize("text", ["", "s", "-1s", "1h", "1e3s", "nan", "infs", "1 2s", "9" * 40])
def test_invalid_durations_are_refused(text: str) -> None:
    with pytest.raises(InvalidArgument, match="wait: found"):
        duration_s(text, "wait")


# -- one user for a unit


def test_a_unit_has_one_user_and_others_are_free() -> None:
    first = UnitLock("arm", "A7")
    with pytest.raises(DeviceError, match=f"process {os.getpid()} drives it; .* Name another"):
        UnitLock("arm", "A7", "Name another")
    other = UnitLock("arm", "B7")
    first.release()
    first.release()
    UnitLock("arm", "A7").release()
    other.release()


def test_a_crash_frees_the_unit() -> None:
    code = (
        "import os, sys, time; from touchfield.devices.drivers.unit_lock import UnitLock\n"
        "lock = UnitLock('arm', 'C7'); print('locked', flush=True); time.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stdout.readline() == "locked\n"
        with pytest.raises(DeviceError, match=f"process {process.pid} drives it"):
            UnitLock("arm", "C7")
        process.kill()
        process.wait()
        UnitLock("arm", "C7").release()


@pytest.mark.skipif(os.name != "posix", reason="permissions are those of POSIX")
def test_a_folder_that_cannot_be_used_is_an_error_of_one_line(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "missing"))
    with pytest.raises(DeviceError, match=r"lock of the device.* XDG_RUNTIME_DIR"):
        UnitLock("arm", "A7")


# -- what `doctor` and `devices --connected` report


@pytest.mark.parametrize(
    ("error", "found", "fix"),
    [
        (DeviceError("arm", "silence", hint="Start it."), "silence", "Start it."),
        (MissingExtra("arm", "armlib", "devices"), "that the library armlib is not installed", "pip install"),
    ],
)
def test_units_that_cannot_be_listed_are_one_line(error: Exception, found: str, fix: str) -> None:
    def find(rest: str) -> list[Readiness]:
        raise error

    (check,) = device_checks(kind_of(find))
    assert (check.what, check.is_there, check.found) == ("units", False, found) and fix in check.mend


def kind_of(find: Callable[[str], list[Readiness]], checks: tuple[Check, ...] = ()) -> DeviceKind:
    return DeviceKind("arm", "arm", "an arm", None, lambda *_: None, lambda: [*checks], find_units=find)


def test_units_are_looked_for_at_an_address_or_where_all_requirements_are_met() -> None:
    searched: list[str] = []

    def find(rest: str) -> list[Readiness]:
        searched.append(rest)
        return []

    missing = Check("service", False, "silent")
    assert device_checks(kind_of(find, (missing,))) == [missing] and searched == []
    assert device_checks(kind_of(find, (missing,)), "there")[1].found == "none connected"
    device_checks(kind_of(find))
    assert searched == ["there", ""]


# -- Haply


def service(
    status: Callable[[int], dict[str, Any] | None] = lambda n: READY,
    ids: tuple[str, ...] = ("04BA",),
    is_centred: bool = False,
) -> Any:
    """A fake service whose devices have these ids; `status` is that of message n, 0 being the first.

    With `is_centred` the hand rests at the origin.
    """

    def message(n: int) -> dict[str, Any]:
        state = FakeHaply.state(n)
        entry = state["inverse3"][0]
        extra = {} if status(n) is None else {"status": status(n)}
        if is_centred:
            entry["state"]["cursor_position"] = {"x": 0.0, "y": 0.0, "z": 0.0}
        return {**state, "inverse3": [{**entry, "device_id": name, **extra} for name in ids]}

    return fake_haply(first=message(0), answer=lambda n, _: message(n))


def arm_of(fake: FakeHaply, unit: str | None = None) -> Haply:
    return Haply(("127.0.0.1", fake.port), 5.0, unit)


@pytest.mark.parametrize(
    ("lack", "text"),
    [
        ({"calibrated": False}, "not calibrated"),
        ({"power_supply": False}, "without power"),
        ({"ready": False}, "not started"),
        ({"started": False}, "not started"),
        ({"calibrated": False, "power_supply": False}, "without power, not calibrated"),
    ],
)
def test_an_inverse3_that_is_not_ready_gets_no_force(lack: dict[str, bool], text: str) -> None:
    with service(lambda n: {**READY, **lack}) as fake:
        arm = arm_of(fake)
        with pytest.raises(DeviceError, match=rf"Haply Inverse3 04BA: found a device that is {text};"):
            open_when_ready(arm, 0.2)
        arm.close()
    assert fake.forces and not np.any(fake.forces)


def test_an_inverse3_that_gets_ready_is_driven() -> None:
    notes: list[str] = []
    with service(lambda n: {**READY, "calibrated": n > 3}) as fake:
        arm = arm_of(fake)
        assert open_when_ready(arm, 5.0, on_note=notes.append)
        position_m = arm.position_m()
        ticks = len(fake.forces)
        assert position_m == (0.001 * ticks, -0.02, 0.1)  # no state is left unread
        arm.put_force_n(1.0, 0.0, 0.0)
        arm.close()
    assert len(notes) == 1 and "04BA is not calibrated: waiting" in notes[0]
    assert not np.any(fake.forces[:ticks]) and fake.forces[ticks:] == [(1.0, 0.0, 0.0), (0.0, 0.0, 0.0)]


def test_an_inverse3_in_use_gets_no_command_until_it_is_free() -> None:
    status = {**READY, "in_use": True}
    with service(lambda n: status) as fake:
        fake.first["inverse3"][0]["status"] = status
        arm = arm_of(fake)
        with pytest.raises(DeviceError, match="in use by another program"):
            open_when_ready(arm, 0.2)
        arm.close()
        assert fake.forces == []
        fake.first["inverse3"][0]["status"] = READY  # from then on, it is in use by us
        assert open_when_ready(arm, 5.0)
        arm.close()
    assert fake.forces


def test_a_service_without_status_is_driven() -> None:
    with service(lambda n: None) as fake:
        arm = arm_of(fake)
        assert open_when_ready(arm, 0.0)
        assert arm.readiness() == Readiness("04BA", is_connected=True)
        arm.close()


def test_an_absent_inverse3_is_waited_for() -> None:
    found = "the devices AAAA, BBBB; expected one with the id CCCC"
    with service(ids=("AAAA", "BBBB")) as fake, pytest.raises(DeviceAbsent, match=found):
        open_when_ready(arm_of(fake, "CCCC"), 0.1)
    with service(ids=()) as fake, pytest.raises(DeviceAbsent, match="no Inverse3"):
        open_when_ready(arm_of(fake), 0.1)


def test_two_inverse3_of_one_service_work_side_by_side_and_each_has_one_user() -> None:
    with service(ids=("AAAA", "BBBB")) as fake:
        fake.ids = ("AAAA", "BBBB")
        first, second = (
            point_device(f"haply:127.0.0.1:{fake.port}{name}").opener() for name in ("", "/BBBB")
        )
        first.open()
        second.open()
        deadline_s = time.monotonic() + 5
        while len(fake.forces) < 2:
            assert time.monotonic() < deadline_s
            time.sleep(0.005)
        for unnamed in (arm_of(fake), arm_of(fake, "AAAA")):
            with pytest.raises(
                DeviceError, match=f"AAAA: found that process {os.getpid()} drives it.*Name another"
            ):
                open_when_ready(unnamed, 5.0)
            unnamed.close()
        second.position_m()
        second.put_force_n(1.0, 0.0, 0.0)
        second.position_m()
        assert fake.commanded == ["AAAA", "BBBB", "BBBB"]
        first.close()
        again = arm_of(fake)
        again.open()
        again.close()
        second.close()


def test_units_of_a_service_are_listed_without_a_command() -> None:
    with service(lambda n: {**READY, "calibrated": False}, ids=("AAAA", "BBBB")) as fake:
        units = haply.find_units(f"127.0.0.1:{fake.port}")
        (named,) = haply.find_units(f"127.0.0.1:{fake.port}/BBBB")
        checks = device_checks(haply.KIND, f"127.0.0.1:{fake.port}")
    assert [unit.unit for unit in units] == ["AAAA", "BBBB"] and named == units[1]
    assert units[0].text == "not calibrated" and not units[0].is_ready
    assert [(c.what, c.is_there, c.found) for c in checks[-2:]] == [
        ("unit AAAA", False, "not calibrated; right-handed"),
        ("unit BBBB", False, "not calibrated; right-handed"),
    ]
    assert fake.forces == []


def test_zero_reaches_an_inverse3_that_its_dead_user_still_occupies() -> None:
    """A standby opens it in that state; until it sets zero, nothing is sent."""
    with service(lambda n: {**READY, "in_use": True}) as fake:
        arm = arm_of(fake)
        arm.open()
        arm.put_wrench(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        arm.close()
    assert fake.forces == [(0.0, 0.0, 0.0)] * 2  # the second by `close`


@pytest.mark.skipif(os.name != "posix", reason="signals are those of POSIX")
def test_the_standby_gets_the_lock_of_a_killed_servo() -> None:
    with service(is_centred=True) as fake:
        opener = point_device(f"haply:127.0.0.1:{fake.port}").opener
        with Player(numbered_medium(20), OMNI, opener, loop=True) as player:
            player.play()
            assert not player.wait(0.5) and player.servo_pid is not None
            with pytest.raises(DeviceError, match="drives it"):
                opener().open()
            os.kill(player.servo_pid, signal.SIGKILL)
            with pytest.raises(DeviceError, match="servo process"):
                player.wait(30)
        assert any("set to zero through a new connection" in note for note in player.notes), player.notes
        assert np.any(fake.forces) and not np.any(fake.forces[-1])
        arm = opener()
        arm.open()
        arm.close()


def test_a_player_waits_for_its_device_and_a_stop_ends_the_wait() -> None:
    notes: list[str] = []
    with service(lambda n: {**READY, "calibrated": False}) as fake:
        opener = point_device(f"haply:127.0.0.1:{fake.port}").opener
        player = Player(numbered_medium(20), OMNI, opener, wait_s=1.0, on_note=notes.append)
        with pytest.raises(DeviceError, match="not calibrated; expected a ready one"), player:
            raise AssertionError("entered without a device that is ready")
        assert len(notes) == 1 and not np.any(fake.forces)
        waiting = Player(numbered_medium(20), OMNI, opener, wait_s=600.0, on_note=lambda note: stop())

        def stop() -> None:
            raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt), waiting:
            raise AssertionError("entered without a device that is ready")
        assert not np.any(fake.forces)


def test_play_notes_what_it_waits_for_and_ends_with_exit_code_1(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "scene.touch"
    pipeline.encode(tiny_scenes()[0], path, EncodeSpec(nw=3))
    with service(lambda n: {**READY, "calibrated": False}) as fake:
        arguments = ["play", str(path), "--device", f"haply:127.0.0.1:{fake.port}/04BA", "--wait", "1s"]
        assert _exit_code(arguments) == 1
    arm, hint = "Haply Inverse3 04BA", "Calibrate it: see the service's own page."
    assert capsys.readouterr().err.splitlines() == [
        f"note: {arm} is not calibrated: waiting for it. {hint}",
        f"touchfield: {arm}: found a device that is not calibrated; expected a ready one. {hint}",
    ]
    assert fake.forces and not np.any(fake.forces)


# -- Force Dimension


@pytest.mark.parametrize(
    ("status", "text"),
    [(0, "without power"), (1, "not connected"), (2, "not started"), (3, "not calibrated")],
)
def test_a_force_dimension_device_is_waited_for(dhd: FakeDriver, status: int, text: str) -> None:
    dhd.library.fake_lack(status, 1 << 30)
    arm = ForceDimension()
    with pytest.raises(DeviceError, match=rf"Force Dimension device 301: found a device that is {text};"):
        open_when_ready(arm, 0.1)
    arm.close()
    assert not dhd.forces.any()
    dhd.library.fake_lack(status, 3)
    notes: list[str] = []
    assert open_when_ready(arm, 5.0, on_note=notes.append) and len(notes) == 1 and text in notes[0]
    arm.close()
    assert not dhd.forces.any()


def test_an_absent_force_dimension_device_is_waited_for(dhd: FakeDriver) -> None:
    dhd.library.fake_unit(301, 0)
    with pytest.raises(DeviceAbsent, match="could not open"):
        open_when_ready(ForceDimension(), 0.1)
    dhd.library.fake_unit(301, 1)
    with pytest.raises(DeviceAbsent, match="could not open"):
        open_when_ready(ForceDimension(302), 0.1)


def test_two_force_dimension_devices_work_side_by_side_and_each_has_one_user(
    dhd: FakeDriver, tmp_path: Path, monkeypatch
) -> None:
    other_path = built("fake_dhd", tmp_path)  # a second process has its own copy of the library
    other = FakeDriver(other_path)
    other.library.fake_unit(302, 1)
    first = point_device("forcedimension:301").opener()
    first.open()
    monkeypatch.setenv("TOUCHFIELD_FORCEDIMENSION_LIBRARY", str(other_path))
    second = point_device("forcedimension:302").opener()
    second.open()
    second.put_force_n(1.0, 0.0, 0.0)
    second.close()
    other.library.fake_reset()
    other.library.fake_unit(301, 1)
    with pytest.raises(DeviceError, match=r"301: found that process .* drives it"):
        ForceDimension().open()
    assert other.log == "OC" and not len(other.forces) and not other.faults
    first.close()
    assert not dhd.forces.any()


def test_force_dimension_devices_are_listed_without_forces(
    dhd: FakeDriver, capsys: pytest.CaptureFixture[str]
) -> None:
    dhd.library.fake_lack(3, 1)
    (unit,) = forcedimension.find_units()
    assert (unit.unit, unit.text) == ("301", "not calibrated")
    assert dhd.log == "OC" and not len(dhd.forces)
    (listed,) = connected_units()["forcedimension"]
    assert listed.unit == "301" and listed.is_ready
    assert _exit_code(["devices", "--connected"]) == 0
    printed = capsys.readouterr().out
    assert "forcedimension" in printed and "301" in printed and "powered, calibrated, started" in printed
    dhd.fail("dhdOpen", 0)
    (unit,) = forcedimension.find_units()
    assert unit.text == "in use by another program"
    dhd.library.fake_unit(301, 0)
    assert forcedimension.find_units() == []


# -- OpenHaptics


@pytest.fixture(scope="module")
def hd_path(tmp_path_factory) -> Path:
    return built("fake_hd", tmp_path_factory.mktemp("hd"))


@pytest.fixture
def hd(hd_path: Path, monkeypatch) -> Iterator[FakeDriver]:
    monkeypatch.setenv("TOUCHFIELD_OPENHAPTICS_LIBRARY", str(hd_path))
    driver = FakeDriver(hd_path)
    yield driver
    assert not driver.faults, driver.faults


def test_a_touch_that_is_not_calibrated_gets_no_force(hd: FakeDriver) -> None:
    hd.library.fake_calibration(0x5002, 0)
    found = r"a device that is not calibrated.*Put the pen into its inkwell"
    with closing(OpenHaptics()) as arm, pytest.raises(DeviceError, match=found):
        open_when_ready(arm, 1.0)
    assert len(hd.forces) and not hd.forces.any() and hd.log == "IESRUTD"


def wait_for(arm: OpenHaptics, text: str) -> None:
    """Poll a device until it reports this state."""
    deadline_s = time.monotonic() + 20
    while arm.readiness().text != text:
        assert time.monotonic() < deadline_s, arm.readiness().text
        time.sleep(0.01)


def test_a_touch_is_calibrated_in_its_inkwell_and_must_then_move(hd: FakeDriver) -> None:
    hd.library.fake_calibration(0x5002, 0)
    hd.library.fake_freeze(1 << 30)
    with closing(OpenHaptics()) as arm:
        arm.open()
        wait_for(arm, "not calibrated")
        hd.library.fake_calibration(0x5002, 1)  # the pen is in the inkwell
        wait_for(arm, "still at its first position")
        time.sleep(0.05)
        assert not arm.readiness().is_ready
        hd.library.fake_freeze(0)
        wait_for(arm, "calibrated, started, moved")
    assert len(hd.forces) > 50 and not hd.forces.any()


def test_a_touch_that_stays_at_its_inkwell_is_refused(hd: FakeDriver) -> None:
    hd.library.fake_freeze(1 << 30)
    found = "device Left Device: found a device that is still at its first position.*Take the pen"
    with closing(OpenHaptics("Left Device")) as arm, pytest.raises(DeviceError, match=found):
        open_when_ready(arm, 1.0)
    assert len(hd.forces) and not hd.forces.any()


def test_a_touch_is_driven_after_it_was_ready(hd: FakeDriver) -> None:
    memory = np.zeros(512, np.int64)  # of the renderer of ``fake_hd.c``: ticks, and an order to release
    tick = ctypes.cast(hd.library.fake_tick, ctypes.c_void_p).value
    with closing(OpenHaptics(None, tick)) as arm:
        assert open_when_ready(arm, 20.0)
        arm.drive(memory.ctypes.data, memory.nbytes)
        deadline_s = time.monotonic() + 10
        while memory[0] < 30:
            assert time.monotonic() < deadline_s
            time.sleep(0.005)
        memory[1] = 1
    assert hd.log == "IESRUSTD" and hd.forces.any() and not hd.forces[-1].any()


def test_an_absent_touch_is_waited_for(hd: FakeDriver) -> None:
    hd.fail("nothing", 0)
    notes: list[str] = []
    with pytest.raises(DeviceAbsent, match="no device"):
        open_when_ready(OpenHaptics(), 0.5, on_note=notes.append)
    assert len(notes) == 1


def test_two_touch_devices_work_side_by_side_and_each_has_one_user(
    hd: FakeDriver, tmp_path: Path, monkeypatch
) -> None:
    other_path = built("fake_hd", tmp_path)  # a second process has its own copy of the library
    other = FakeDriver(other_path)
    first = point_device("openhaptics:Left Device").opener()
    first.open()
    monkeypatch.setenv("TOUCHFIELD_OPENHAPTICS_LIBRARY", str(other_path))
    with pytest.raises(DeviceError, match=r"1: found that process .* drives it"):
        OpenHaptics("Left Device").open()
    assert other.log == "ID"
    other.library.fake_serial(b"2")
    second = OpenHaptics("Right Device")
    second.open()
    second.close()
    first.close()
    assert not other.faults


def test_touch_devices_are_listed_by_the_names_in_the_settings(
    hd: FakeDriver, tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.setenv("GTDD_HOME", str(tmp_path))
    assert [unit.unit for unit in openhaptics.find_units()] == [""]
    (tmp_path / "config").mkdir()
    for name in ("Left Device", "Right Device"):
        (tmp_path / "config" / f"{name}.config").touch()
    hd.library.fake_serial(b"S7")
    units = openhaptics.find_units()
    assert [unit.unit for unit in units] == ["Left Device", "Right Device"] and "S7" in units[0].hint
    assert not len(hd.forces)
    hd.fail("nothing", 0)
    assert openhaptics.find_units() == []


# -- bHaptics


class Vest:
    """A fake Player that sends `states` one after the other: at first, and after each frame."""

    def __init__(self, *states: dict[str, Any]) -> None:
        self.states, self.frames = list(states), []

    def __call__(self, line: ServerConnection) -> None:
        states = list(self.states)
        try:
            while states:
                line.send(json.dumps(states.pop(0)))
                if len(states) == 0:
                    for text in line:
                        self.frames.append(text)
                else:
                    time.sleep(0.1)
        except ConnectionClosed:
            pass


@pytest.fixture
def player() -> Iterator[Callable[[Vest], int]]:
    """Starts a fake Player; returns its port."""
    servers = []

    def start(vest: Vest) -> int:
        server = serve(vest, "127.0.0.1", 0, max_queue=None, close_timeout=1)
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        servers.append((server, thread))
        return int(server.socket.getsockname()[1])

    yield start
    for server, thread in servers:
        server.shutdown()
        thread.join(10)


WITHOUT_VEST = {"ConnectedDeviceCount": 0, "ConnectedPositions": [], "ActiveKeys": []}
WITH_VEST = {"ConnectedDeviceCount": 1, "ConnectedPositions": ["Vest"], "ActiveKeys": []}


class Drives:
    """One frame of full drives."""

    rate_hz, frame_count = 20.0, 1

    def drives(self, frame: int) -> np.ndarray:
        return np.ones((2, 5, 4), np.float32)

    def frequencies(self, frame: int) -> None:
        return None


def test_a_missing_vest_is_reported_and_gets_no_frame(player) -> None:
    fake = Vest(WITHOUT_VEST)
    vest = BHaptics(device("tactsuit-x40"), ("127.0.0.1", player(fake)))
    with pytest.raises(DeviceError, match=r"bHaptics vest: found a device that is not connected.*pair it"):
        ArrayPlayer(Drives(), vest, wait_s=0.2).start()
    time.sleep(0.1)
    assert all(dot["Intensity"] == 0 for text in fake.frames for dot in dots_of(text))


def dots_of(text: str) -> list[dict[str, int]]:
    return [dot for part in json.loads(text)["Submit"] for dot in part["Frame"]["DotPoints"]]


def test_a_vest_that_is_paired_later_is_driven_and_its_loss_is_noted(player) -> None:
    fake = Vest(WITHOUT_VEST, WITHOUT_VEST, WITH_VEST)
    notes: list[str] = []
    vest = BHaptics(device("tactsuit-x40"), ("127.0.0.1", player(fake)))
    with ArrayPlayer(Drives(), vest, wait_s=5.0, on_note=notes.append) as array_player:
        assert not array_player.wait(0.3) and array_player.notes == ()
        vest._has_vest = False
        assert not array_player.wait(0.2)
        assert array_player.notes == (bhaptics._LOST,)
    assert len(notes) == 1 and "not connected" in notes[0]
    assert any(dot["Intensity"] == 100 for text in fake.frames for dot in dots_of(text))


def test_a_vest_has_one_user(player) -> None:
    port = player(Vest(WITH_VEST))
    first, second = (BHaptics(device("tactsuit-x40"), ("127.0.0.1", port)) for _ in range(2))
    first.open()
    with pytest.raises(DeviceError, match="drives it"):
        second.open()
    first.close()
    second.open()
    second.close()


def test_the_vest_of_a_player_is_listed(player) -> None:
    found = [bhaptics.find_units(f"127.0.0.1:{player(Vest(state))}") for state in (WITHOUT_VEST, WITH_VEST)]
    assert [[unit.text for unit in units] for units in found] == [["not connected"], ["connected"]]


@pytest.mark.parametrize(
    ("state", "has_vest"),
    [
        ("{}", None),
        ("no JSON", None),
        ("[1]", None),
        ('{"ConnectedDeviceCount": 0}', False),
        ('{"ConnectedDeviceCount": 1}', None),
        ('{"ConnectedPositions": ["ForearmL"]}', False),
        ('{"ConnectedPositions": ["Head", "VestFront"]}', True),
        ('{"ConnectedPositions": 3}', None),
    ],
)
def test_the_state_of_a_player_names_a_vest_or_not(state: str, has_vest: bool | None) -> None:
    assert bhaptics.vest_in(state) is has_vest
