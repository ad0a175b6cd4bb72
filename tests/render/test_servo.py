"""The loop of the servo in this process, on a simulated clock: the calls of a device under faults."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given, strategies as st
from player_makers import OMNI, Absent, Failing, RestingDevice, Simulated, frame_of, laid_out, numbered_medium

from touchfield.errors import CorruptFile, DeviceError, InvalidArgument
from touchfield.render.block import LOG_ROWS, layout
from touchfield.render.offline import run_offline
from touchfield.render.point_device import Point, PointDevice
from touchfield.render.servo import VirtualClock, serve
from touchfield.render.spec import RenderSpec

TICK_S = 1e-3
PEAK_N, SLEW_N_PER_S = (
    0.8,
    120.0,
)  # both are reached often: the fields have 0.5 to 0.8 N, plus gravity


class Late(VirtualClock):
    """Wakes up later than requested, by a list of delays."""

    def __init__(self, delays_ns: list[int]) -> None:
        super().__init__()
        self._delays = list(delays_ns)

    def sleep_until(self, deadline_ns: int) -> int:
        return super().sleep_until(deadline_ns + (self._delays.pop(0) if self._delays else 0))


@dataclass
class Ordeal(PointDevice):
    """Jumps about, fails where configured, and records each call with its time."""

    clock: VirtualClock
    jumps: dict[int, Point] = field(default_factory=dict)
    position_fails_at: int | None = None
    puts_that_fail: range = range(0)
    calls: list[tuple[int, Point]] = field(default_factory=list)
    closed: int = 0
    reads: int = 0
    at_m: Point = (0.0, 0.0, 0.0)

    def open(self) -> None:
        assert not self.calls

    def position_m(self) -> Point:
        self.reads += 1
        if self.position_fails_at is not None and self.reads > self.position_fails_at:
            raise DeviceError("ordeal", "no answer", "a position")
        self.at_m = self.jumps.get(self.reads, self.at_m)
        return self.at_m

    def put_force_n(self, x: float, y: float, z: float) -> None:
        assert not self.closed
        self.calls.append((self.clock.now_ns(), (x, y, z)))
        if len(self.calls) in self.puts_that_fail:
            raise DeviceError("ordeal", "a broken pipe", "a device")

    def close(self) -> None:
        self.closed += 1


numbers = st.sampled_from([0.0, 0.004, -0.02, 0.024, 0.03, 1.0, -1e300, np.nan, np.inf])
events = st.one_of(
    st.tuples(st.just("seek_s"), st.floats(0, 0.5)),
    st.tuples(st.just("speed"), st.floats(0.01, 100)),
    st.tuples(st.just("mode"), st.sampled_from([layout.PLAYING, layout.PAUSED, layout.IDLE])),
    st.tuples(st.just("feed"), st.booleans()),
    st.tuples(st.just("heartbeat"), st.sampled_from([0, 1])),
    st.tuples(st.just("signal"), st.just(0)),
)
faults = st.fixed_dictionaries(
    {
        "jumps": st.dictionaries(st.integers(1, 250), st.tuples(numbers, numbers, numbers), max_size=12),
        "position_fails_at": st.none() | st.integers(0, 250),
        "puts_that_fail": st.one_of(
            st.just(range(0)),
            st.builds(lambda a, n: range(a, a + n), st.integers(1, 250), st.integers(1, 80)),
            st.just(range(100, 10_000)),
        ),
    }
)


@given(
    st.lists(st.tuples(st.integers(1, 60), events), max_size=12),
    faults,
    st.lists(st.sampled_from([0, 0, 0, 50_000, 900_000, 2_500_000, 40_000_000]), max_size=300),
    st.booleans(),
    st.none() | st.integers(0, 19),
)
def test_forces_always_keep_their_limits_and_end_at_zero(
    turns: list[tuple[int, tuple[str, object]]],
    faulty: dict[str, object],
    delays_ns: list[int],
    loop: bool,
    corrupt_from: int | None,
) -> None:
    spec = RenderSpec(
        peak_n=PEAK_N, slew_n_per_s=SLEW_N_PER_S, gravity_n=(0.1, 0.3, 0.0), damping_n_s_per_m=2.0
    )
    session, memory = laid_out(numbered_medium(corrupt_from=corrupt_from), spec, loop=loop)
    feeder, clock = session.feeder(memory, is_timed=False), Late(delays_ns)
    device = Ordeal(clock, **faulty)  # type: ignore[arg-type]
    receiver, is_fed = memory.receiver, True
    session.order(memory, mode=layout.PLAYING)
    script: dict[int, tuple[str, object]] = {}
    at = 0
    for after, event in turns:
        at += after
        script[at] = event

    def before_tick() -> bool:
        nonlocal is_fed
        ticks = int(receiver["counts"]["ticks"])
        option, value = script.get(ticks, ("", None))
        if option == "feed":
            is_fed = bool(value)
        elif option == "heartbeat":
            receiver["orders"]["heartbeat_ns"] = value
        elif option == "signal":
            return True
        elif option:
            applied = session.order(memory, **{option: value})  # type: ignore[arg-type]
            if option == "seek_s":
                feeder.seek(applied.generation, session.frame_at(applied.start_s))
        if is_fed:
            feeder.fill_lookahead(5)
        return ticks >= 300

    try:
        serve(memory, device, clock, before_tick)
    except DeviceError:
        assert device.position_fails_at is not None or len(device.puts_that_fail)
    assert device.closed >= 1
    assert device.calls
    times_ns = np.array([time for time, _ in device.calls])
    forces = np.array([force for _, force in device.calls])
    assert np.isfinite(forces).all()
    assert (np.linalg.norm(forces, axis=1) <= PEAK_N * (1 + 1e-12)).all()
    steps = np.linalg.norm(np.diff(forces, axis=0, prepend=np.zeros((1, 3))), axis=1)
    periods_s = np.minimum(np.diff(1e-9 * times_ns, prepend=1e-9 * times_ns[0] - TICK_S), 2 * TICK_S)
    assert (steps <= SLEW_N_PER_S * periods_s * (1 + 1e-9) + 1e-12).all()
    assert not forces[-1].any()


def served(device: PointDevice, must_stop: Callable[[int], bool], **options: object) -> None:
    session, memory = laid_out(numbered_medium(), **options)  # type: ignore[arg-type]
    feeder = session.feeder(memory, is_timed=False)
    session.order(memory, mode=layout.PLAYING)

    def before_tick() -> bool:
        feeder.fill_lookahead(3)
        return must_stop(int(memory.receiver["counts"]["ticks"]))

    serve(memory, device, VirtualClock(), before_tick)


def test_a_stop_ramps_down() -> None:
    device = RestingDevice()
    served(device, lambda ticks: ticks >= 200, loop=True)
    forces = np.array(device.forces)
    assert forces[199, 2] > 0.4 and 201 < len(forces) < 230
    assert (np.diff(forces[199:, 2]) < 0).all() and not forces[-1].any() and device.closed == 1


def test_a_failing_device_is_released_and_reported() -> None:
    device = Failing()
    with pytest.raises(DeviceError, match="fake device: found no answer"):
        served(device, lambda ticks: False)
    assert device.forces[99][2] > 0.4 and device.forces[-1] == (0.0, 0.0, 0.0) and device.closed == 1


def test_a_missing_device_is_closed_and_reported() -> None:
    device = Absent()
    with pytest.raises(DeviceError, match="nothing on the bus"):
        served(device, lambda ticks: False)
    assert not device.forces and device.closed == 1


def test_a_slow_device_does_not_delay_the_end() -> None:
    clock = VirtualClock()

    class Slow(Failing):
        def put_force_n(self, x: float, y: float, z: float) -> None:
            super().put_force_n(x, y, z)
            if len(self.forces) > 100:
                clock.sleep_until(clock.now_ns() + 10**9)

    session, memory = laid_out(numbered_medium(1))
    session.feeder(memory).step()
    session.order(memory, mode=layout.PLAYING)
    device = Slow()
    with pytest.raises(DeviceError):
        serve(memory, device, clock, lambda: False)
    assert device.forces[-1] == (0.0, 0.0, 0.0) and len(device.forces) < 110


def test_zero_is_reached_no_faster_than_the_slew_limit() -> None:
    clock, times_ns = VirtualClock(), []

    class Once(Failing):
        def put_force_n(self, x: float, y: float, z: float) -> None:
            super().put_force_n(x, y, z)
            if len(self.forces) == 102:  # after the failure: one call takes the duration of the ramp
                clock.sleep_until(clock.now_ns() + 10**10)
            times_ns.append(clock.now_ns())

    session, memory = laid_out(numbered_medium(1))
    session.feeder(memory).step()
    session.order(memory, mode=layout.PLAYING)
    device = Once()
    with pytest.raises(DeviceError):
        serve(memory, device, clock, lambda: False)
    last_n = np.linalg.norm(device.forces[-2])
    assert last_n > 0.1 and device.forces[-1] == (0.0, 0.0, 0.0)
    slew_n_per_s = float(memory.receiver["settings"]["force_limits"]["slew_per_s"])
    assert last_n <= 1e-9 * (times_ns[-1] - times_ns[-2]) * slew_n_per_s * (1 + 1e-9)


class Driver(RestingDevice):
    """A vendor's driver with its own thread, which calls the compiled cycle."""

    is_driven = True

    def __init__(self, calls: int = 10**9) -> None:
        super().__init__()
        self._calls = calls

    def drive(self, address: int, size_bytes: int) -> None:
        import ctypes
        import threading
        import time

        from touchfield.compute.native import native
        from touchfield.render.block import Memory

        memory = Memory((ctypes.c_char * size_bytes).from_address(address))

        def call() -> None:
            while not self.closed and len(self.forces) < self._calls:
                self.forces.append(native.cycle(memory.bytes, 0.0, 0.0, 0.0, time.perf_counter_ns()))
                time.sleep(5e-4)

        self._thread = threading.Thread(target=call, daemon=True)
        self._thread.start()

    def close(self) -> None:
        super().close()
        if self.is_open:
            self._thread.join()


def test_a_driver_calls_until_the_force_is_zero() -> None:
    device = Driver()
    served(device, lambda ticks: ticks >= 250)  # the force comes within 0.1 s
    assert max(force[2] for force in device.forces) > 0.4 and device.forces[-1] == (0.0, 0.0, 0.0)


def test_a_driver_that_stops_calling_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("touchfield.render.servo._MAX_SILENCE_S", 0.2)
    device = Driver(calls=20)
    with pytest.raises(DeviceError, match="no call for"):
        served(device, lambda ticks: False)
    assert device.closed == 1


# -- without a process -------------------------------------------------------------------------------------


def test_an_offline_run_plays_the_complete_medium_reproducibly() -> None:
    devices: list[Simulated] = []

    def opener() -> Simulated:
        devices.append(Simulated())
        return devices[-1]

    runs = [run_offline(numbered_medium(20), OMNI, opener) for _ in range(2)]
    log = runs[0].log
    assert np.array_equal(log["force_n"], runs[1].log["force_n"])
    assert np.array_equal(log["force_n"], devices[0].forces)
    running = log[50:400]
    assert frame_of(running["field_force_n"][:, 2]) == pytest.approx(
        np.minimum(running["time_s"] * 50, 19), abs=1e-4
    )
    assert not log["force_n"][-1].any() and 400 < len(log) < 460
    assert runs[0].statistics["underruns"] == runs[0].statistics["waits"] == 0


def test_an_offline_run_of_given_duration_loops() -> None:
    run = run_offline(
        numbered_medium(5), OMNI, Simulated, RenderSpec(rate_hz=500), seconds=1.0, loop=True, speed=3.0
    )
    assert 500 < len(run.log) < 530 and run.log["media_s"][499] == pytest.approx(499 * 3 / 500)
    assert (run.log["field_force_n"][50:500, 2] > 0.49).all()
    assert not run_offline(numbered_medium(5), OMNI, Simulated, seconds=0.0).log["force_n"].any()
    ticks = LOG_ROWS + 1000  # the ring of the log is drained in time
    long = run_offline(numbered_medium(1), OMNI, Simulated, seconds=ticks / 1000)
    assert len(long.log) >= ticks and np.allclose(np.diff(long.log["time_s"]), 1e-3)


def test_an_offline_run_raises_an_error_of_the_medium_after_the_ramp() -> None:
    device = Simulated()
    with pytest.raises(CorruptFile, match="segment 3"):
        run_offline(numbered_medium(20, corrupt_from=8), OMNI, lambda: device)
    assert max(force[2] for force in device.forces) > 0.5 and device.forces[-1] == (0.0, 0.0, 0.0)
    assert device.closed == 1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"loop": True}, "seconds"),
        ({"seconds": -1.0}, "seconds"),
        ({"seconds": float("nan")}, "seconds"),
        ({"speed": 0.0}, "speed"),
        ({"speed": float("inf")}, "speed"),
        ({"start_s": -1.0}, "time"),
        ({"start_s": float("nan")}, "time"),
    ],
)
def test_an_offline_run_refuses_invalid_options(options: dict[str, object], message: str) -> None:
    with pytest.raises(InvalidArgument, match=message):
        run_offline(numbered_medium(), OMNI, Simulated, **options)  # type: ignore[arg-type]
    with pytest.raises(InvalidArgument, match="one that sets its own rate"):
        run_offline(numbered_medium(), OMNI, Driver)
