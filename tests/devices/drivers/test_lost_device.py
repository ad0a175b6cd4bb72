"""A device that loses calibration or power while it is driven: the force goes to zero, a note says why, and
the force returns. A standby opens the unit that the servo had opened, also if another one is found first."""

from __future__ import annotations

import ctypes
import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from multiprocessing import Pipe
from typing import Any

import numpy as np
import pytest
from fake_driver import FakeDriver, built
from fake_haply import FakeHaply, fake_haply
from tests.render.player_makers import OMNI, RestingDevice, laid_out, numbered_medium

from touchfield.devices.drivers.forcedimension import ForceDimension
from touchfield.devices.drivers.haply import Haply
from touchfield.devices.drivers.openhaptics import OpenHaptics
from touchfield.devices.drivers.registry import point_device
from touchfield.errors import DeviceError
from touchfield.render.block import FLAGS, layout
from touchfield.render.player import Player
from touchfield.render.point_device import PointDevice
from touchfield.render.readiness import Readiness, ReadinessWatch
from touchfield.render.servo import CLOSED, UNIT, VirtualClock, serve
from touchfield.render.spec import RenderSpec
from touchfield.render.standby import has_died, open_unit

READY = {"calibrated": True, "in_use": True, "power_supply": True, "ready": True, "started": True}


# -- the watch


def test_a_loss_is_noted_once_and_its_end_too() -> None:
    ready, lost = Readiness("7"), Readiness("7", is_powered=False, hint="Switch it on.")
    states = [ready, lost, lost, lost, ready]
    notes: list[str] = []
    watch = ReadinessWatch("arm", lambda: states.pop(0), 30.0, notes.append)
    answers = [watch.is_ready(0.01 * n) for n in range(60)]
    assert answers.index(False) == 25  # a quarter of a second after the first check
    assert answers[25:40] == [False] * 15 and answers[40:] == [True] * 20 and not states
    assert notes == [
        "arm 7 is without power: its force is zero until it is ready. Switch it on.",
        "arm 7 is ready again: its force returns",
    ]


def test_a_loss_that_lasts_for_longer_than_the_wait_is_an_error() -> None:
    lost = Readiness("7", is_calibrated=False, hint="Calibrate it.")
    watch = ReadinessWatch("arm", lambda: lost, 1.0, lambda note: None)
    assert not watch.is_ready(10.0) and not watch.is_ready(10.9)
    with pytest.raises(DeviceError, match=r"arm 7: found a device that is not calibrated;.*Calibrate it"):
        watch.is_ready(11.1)


class Losing(RestingDevice):
    """Is not calibrated for some of the checks of its state."""

    def __init__(self) -> None:
        super().__init__()
        self.checks: list[int] = []  # the tick of each

    def state(self) -> Readiness:
        self.checks.append(len(self.forces))
        return Readiness(is_calibrated=not 3 <= len(self.checks) <= 8)


def test_the_force_of_a_lost_device_goes_to_zero_and_returns_within_the_slew_limit() -> None:
    spec = RenderSpec(slew_n_per_s=40.0)
    session, memory = laid_out(numbered_medium(1), spec)
    feeder, device, notes = session.feeder(memory, is_timed=False), Losing(), []
    session.order(memory, mode=layout.PLAYING)
    ticks = memory.receiver["counts"]
    time_s = iter(range(10**6))
    watch = ReadinessWatch("arm", device.state, 30.0, notes.append)

    class Timed(ReadinessWatch):
        def is_ready(self, now_s: float) -> bool:  # by ticks, as this loop has no clock
            return watch.is_ready(1e-3 * next(time_s))

    def before_tick() -> bool:
        feeder.fill_lookahead(5)
        return bool(ticks["ticks"] > 1800)

    serve(memory, device, VirtualClock(), before_tick, watch=Timed("", device.state, 0.0, notes.append))
    forces = np.array(device.forces)[:1800, 2]
    lost, found = device.checks[2], device.checks[8]
    assert len(notes) == 2 and "not calibrated" in notes[0] and "ready again" in notes[1]
    assert lost == 500 and found == pytest.approx(500 + 6 * 50, abs=6)  # checks at 0, 250, 500, 550, ... ms
    assert forces[300:500] == pytest.approx(0.5) and not forces[530:found].any()
    assert forces[found + 100 : 1800] == pytest.approx(0.5)
    assert np.abs(np.diff(forces)).max() <= 1e-3 * 40.0 * (1 + 1e-9)


def test_a_device_that_stays_lost_ends_the_playback_with_a_force_of_zero() -> None:
    session, memory = laid_out(numbered_medium(1))
    feeder, device = session.feeder(memory, is_timed=False), RestingDevice()
    feeder.fill_lookahead(5)
    session.order(memory, mode=layout.PLAYING)
    ticks = memory.receiver["counts"]

    def state() -> Readiness:
        return Readiness("7", is_powered=bool(ticks["ticks"] < 100))

    watch = ReadinessWatch("arm", state, 0.5, lambda note: None)
    clock = iter(range(10**6))
    watch_is_ready = watch.is_ready
    watch.is_ready = lambda now_s: watch_is_ready(1e-3 * next(clock))  # type: ignore[method-assign]
    with pytest.raises(DeviceError, match="arm 7: found a device that is without power; expected a ready"):
        serve(memory, device, VirtualClock(), lambda: False, watch=watch)
    forces = np.array(device.forces)[:, 2]
    assert forces[90] > 0.4 and not forces[400:].any() and 700 < len(forces) < 800 and device.closed


# -- the drivers


def lost_service(is_lost: Callable[[int], bool]) -> Any:
    """A fake service whose device rests at the origin and is without power in some messages."""

    def message(n: int) -> dict[str, Any]:
        state = FakeHaply.state(n)
        entry = state["inverse3"][0]
        entry["state"]["cursor_position"] = {"x": 0.0, "y": 0.0, "z": 0.0}
        entry["status"] = {**READY, "in_use": n > 0, "power_supply": not is_lost(n)}
        return state

    return fake_haply(first=message(0), answer=lambda n, _: message(n))


def test_an_inverse3_that_loses_its_power_has_no_force_until_it_is_back() -> None:
    notes: list[str] = []
    lost: list[float] = []

    def is_lost(n: int) -> bool:
        """From message 600 on, for half a second."""
        if n >= 600:
            lost.append(time.monotonic())
        return n >= 600 and time.monotonic() - lost[0] < 0.5

    with lost_service(is_lost) as fake:
        opener = point_device(f"haply:127.0.0.1:{fake.port}").opener
        player = Player(
            numbered_medium(1), OMNI, opener, log_rows=100_000, is_realtime=False, on_note=notes.append
        )
        with player:
            player.play()
            deadline_s = time.monotonic() + 30
            while len(notes) < 2:
                assert time.monotonic() < deadline_s and player.error is None
                player.wait(0.05)
            player.wait(0.3)
        rows = player.log()
    assert notes[0].startswith("Haply Inverse3 04BA is without power: its force is zero until it is ready")
    assert notes[1] == "Haply Inverse3 04BA is ready again: its force returns"
    forces = np.abs(rows["force_n"][rows["flags"] == FLAGS["running"], 2])
    without = np.flatnonzero(forces[len(forces) // 10 :] == 0.0)
    assert forces[-1] == pytest.approx(0.5) and len(without) > 20
    assert forces.max() == pytest.approx(0.5)


def test_a_state_of_an_inverse3_is_that_of_its_latest_message() -> None:
    with lost_service(lambda n: n == 2) as fake, closing(Haply(("127.0.0.1", fake.port), 5.0)) as arm:
        arm.open()
        for expected in (True, False, True):
            arm.position_m()
            assert arm.state().is_ready == expected
            arm.put_force_n(0.0, 0.0, 0.0)


def test_the_state_of_a_force_dimension_device_is_read_while_it_is_driven(dhd: FakeDriver) -> None:
    with closing(ForceDimension()) as arm:
        arm.open()
        arm.put_force_n(1.0, 0.0, 0.0)
        assert arm.state() == Readiness("301", True, True, True, True)
        dhd.library.fake_lack(0, 1)
        assert arm.state().missing == ("without power",) and arm.state().is_ready
    assert dhd.forces.tolist() == [[0, 0, 0], [1, 0, 0], [0, 0, 0]]  # a check sets no force


@pytest.fixture
def hd(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Iterator[FakeDriver]:
    path = built("fake_hd", tmp_path_factory.mktemp("hd"))
    monkeypatch.setenv("TOUCHFIELD_OPENHAPTICS_LIBRARY", str(path))
    driver = FakeDriver(path)
    yield driver
    assert not driver.faults, driver.faults


def wait_until(condition: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + 20
    while not condition():
        assert time.monotonic() < deadline_s
        time.sleep(0.002)


def test_a_touch_that_loses_its_calibration_has_no_position_until_it_has_it_again(hd: FakeDriver) -> None:
    memory = np.zeros(512, np.int64)  # of the renderer of ``fake_hd.c``: ticks, a release, and a position
    position_m = memory.view(np.float64)[4:7]
    tick = ctypes.cast(hd.library.fake_tick, ctypes.c_void_p).value
    with closing(OpenHaptics("Left Device", tick)) as arm:
        arm.open()
        arm.drive(memory.ctypes.data, memory.nbytes)
        wait_until(lambda: memory[0] > 70 and np.isfinite(position_m).all())
        assert arm.state() == Readiness("Left Device", is_calibrated=True, hint=arm.state().hint)
        hd.library.fake_calibration(0x5002, 0)
        wait_until(lambda: not np.isfinite(position_m).any())
        assert arm.state().missing == ("not calibrated",)
        hd.library.fake_calibration(0x5002, 1)  # the pen is in the inkwell: the callback updates it
        wait_until(lambda: bool(np.isfinite(position_m).all()))
        assert arm.state().is_ready
        memory[1] = 1


def test_the_force_of_a_touch_goes_to_zero_while_it_is_not_calibrated(hd: FakeDriver) -> None:
    session, memory = laid_out(numbered_medium(1), RenderSpec(scale=0.1))  # the hand stays within the field
    feeder, device, notes = session.feeder(memory, is_timed=False), OpenHaptics(), []
    feeder.fill_lookahead(5)
    session.order(memory, mode=layout.PLAYING)
    ticks, steps = memory.receiver["counts"], [(200, 0x5002, 0), (600, 0x5002, 1)]

    def before_tick() -> bool:
        if steps and ticks["ticks"] > steps[0][0]:
            hd.library.fake_calibration(*steps.pop(0)[1:])
        return bool(ticks["ticks"] > 1200)

    watch = ReadinessWatch(device.title, device.state, 30.0, notes.append)
    serve(memory, device, VirtualClock(), before_tick, watch=watch)
    forces = np.linalg.norm(hd.forces, axis=1)
    has_force = forces[100:1100] > 0.1
    first, last = np.flatnonzero(~has_force)[[0, -1]] + 100
    assert 200 <= first <= 350 and 600 <= last <= 800, "within 64 frames, the ramp and a poll of the orders"
    assert not forces[first + 30 : last - 30].any() and forces[first - 50] > 0.4 and forces[1050] > 0.4
    assert np.abs(np.diff(forces)).max() < 0.2
    assert len(notes) == 2 and "not calibrated" in notes[0] and "inkwell" in notes[0]
    assert "is ready again" in notes[1]


def test_buttons_of_a_touch_are_written_at_each_frame_and_its_delay_is_measured(hd: FakeDriver) -> None:
    memory = np.zeros(512, np.int64)
    fields = layout.RECEIVER.fields, layout.GRIP.fields
    assert fields[0] is not None and fields[1] is not None
    index = (fields[0]["grip"][1] + fields[1]["buttons"][1]) // 8
    tick = ctypes.cast(hd.library.fake_tick, ctypes.c_void_p).value
    with closing(OpenHaptics(None, tick)) as arm:
        arm.open()
        arm.drive(memory.ctypes.data, memory.nbytes)
        for pressed in (0, 1, 3, 2, 0):
            hd.library.fake_buttons(pressed)
            wait_until(lambda pressed=pressed: memory[index] == pressed)
        assert 0.0 < arm.frame_s() < 1.0
        memory[1] = 1


def test_a_touch_plays_with_its_buttons_in_the_log(hd: FakeDriver) -> None:
    """In this process, so that the fake can be ordered while it is driven."""
    session, memory = laid_out(numbered_medium(1))
    feeder, times = session.feeder(memory, is_timed=False), []
    feeder.fill_lookahead(5)
    session.order(memory, mode=layout.PLAYING)
    hd.library.fake_buttons(2)
    ticks = memory.receiver["counts"]
    serve(memory, OpenHaptics(), VirtualClock(), lambda: bool(ticks["ticks"] > 300), report_loop=times.append)
    rows = memory.array(layout.LOG_ROW, session.layout.log, 300)
    assert (rows["buttons"] == 2).all()
    (first, *_) = times
    assert 0.0 < first.median_s <= first.delay_s < 0.1 and 0.5e-3 < first.period_s < 0.1


# -- the unit that a standby opens


def test_the_standby_learns_which_unit_the_servo_has_opened() -> None:
    lifeline, servo_end = Pipe(duplex=False)
    pipe, player_end = Pipe()
    units: list[str] = []
    servo_end.send_bytes(UNIT + b"301")
    servo_end.send_bytes(CLOSED)
    assert not has_died(os.getpid(), lifeline, pipe, 1.0, units.append)
    servo_end.send_bytes(UNIT + b"302")
    servo_end.close()
    assert has_died(os.getpid(), lifeline, pipe, 1.0, units.append)
    assert units == ["301", "302"]
    player_end.close()


def test_an_unnamed_unit_is_opened_again_by_its_serial_number(dhd: FakeDriver) -> None:
    arm = point_device("forcedimension", settings="gravity=on").opener()
    arm.open()
    assert arm.unit == "301"
    arm.close()
    dhd.library.fake_unit(302, 1)  # now another one is found first
    again = open_unit(point_device("forcedimension").opener, "301")
    with pytest.raises(DeviceError, match="could not open"):
        again.open()
    dhd.library.fake_unit(301, 1)
    again.open()
    assert again.unit == ""  # it is named
    again.close()
    named = point_device("forcedimension:301").opener()
    named.open()
    assert named.unit == ""
    named.close()
    assert PointDevice.unit.fget(Losing()) == ""


@pytest.mark.skipif(os.name != "posix", reason="signals are those of POSIX")
def test_a_standby_sets_zero_on_the_unnamed_inverse3_that_the_servo_has_driven() -> None:
    with lost_service(lambda n: False) as fake:
        fake.ids = ("04BA", "AAAA")
        opener = point_device(f"haply:127.0.0.1:{fake.port}").opener
        with Player(numbered_medium(20), OMNI, opener, loop=True, is_realtime=False) as player:
            player.play()
            assert not player.wait(0.5) and player.servo_pid is not None
            # another unit is plugged in, and the service lists it first
            entry = fake.first["inverse3"][0]
            fake.first["inverse3"] = [{**entry, "device_id": "AAAA"}, entry]
            os.kill(player.servo_pid, signal.SIGKILL)
            with pytest.raises(DeviceError, match="servo process"):
                player.wait(30)
        assert any("set to zero through a new connection" in note for note in player.notes), player.notes
    assert set(fake.commanded) == {"04BA"} and not np.any(fake.forces[-1])
