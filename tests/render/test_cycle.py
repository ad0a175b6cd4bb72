"""One cycle of the servo: the media clock, the frames in use, the counters and the log."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from player_makers import RATE_HZ, frame_of, laid_out, numbered_medium
from receiver_values import value_of

from touchfield.compute.native import native
from touchfield.medium import HapticMedium
from touchfield.render.block import FLAGS, TickLog, layout, statistics_of
from touchfield.render.spec import RenderSpec

TICK_NS = 1_000_000
START_NS = 5_000_000_000


class Desk:
    """A session with access to its ticks, feed and orders."""

    def __init__(self, medium: HapticMedium, spec: RenderSpec | None = None, **options: object) -> None:
        self.session, self.memory = laid_out(medium, spec, **options)
        self.feeder = self.session.feeder(self.memory, is_timed=False)  # time is the number of the tick
        self.log = TickLog(self.memory, 1 << 30)
        self.now_ns, self.is_fed = START_NS, True

    def order(self, **changes: object) -> None:
        applied = self.session.order(self.memory, **changes)  # type: ignore[arg-type]
        if "seek_s" in changes:
            self.feeder.seek(applied.generation, self.session.frame_at(applied.start_s))

    def tick(self, count: int = 1, step_ns: int = TICK_NS) -> tuple[float, float, float]:
        force = (0.0, 0.0, 0.0)
        for _ in range(count):
            if self.is_fed:
                self.feeder.fill_lookahead(4)
            force = native.cycle(self.memory.bytes, 0.0, 0.0, 0.0, self.now_ns)
            self.now_ns += step_ns
        return force

    def played_frame(self) -> float:
        """The frame number encoded by the force; fractional between two frames."""
        return frame_of(float(self.memory.receiver["state"]["field_force_n"][2]))

    def value(self, path: str) -> int:
        return int(value_of(self.memory, path))

    @property
    def media_s(self) -> float:
        return float(self.memory.receiver["clock"]["media_s"])

    @property
    def counts(self) -> dict[str, float]:
        return statistics_of(self.memory)


def playing(frames: int = 20, **options: object) -> Desk:
    desk = Desk(numbered_medium(frames), **options)  # type: ignore[arg-type]
    desk.order(mode=layout.PLAYING)
    return desk


def test_no_force_before_play() -> None:
    desk = Desk(numbered_medium())
    for _ in range(50):
        assert desk.tick() == (0.0, 0.0, 0.0)
    assert desk.media_s == 0 and desk.value("clock.is_resting")
    desk.order(mode=layout.PLAYING)
    assert desk.tick(100)[2] > 0 and desk.counts["waits"] == 0


def test_the_force_is_exact_at_frames_and_blended_between() -> None:
    desk = playing()
    for n in range(200):
        desk.tick()
        assert desk.media_s == pytest.approx(n * 1e-3, abs=1e-12)
        assert desk.played_frame() == pytest.approx(n * 1e-3 * RATE_HZ, abs=1e-5)


@given(st.floats(0.05, 20.0), st.floats(0.0, 0.3))
def test_speed_and_start(speed: float, start_s: float) -> None:
    desk = playing(speed=speed, start_s=start_s, loop=True)
    desk.tick(40)
    media_s = start_s + 39e-3 * speed
    assert desk.media_s == pytest.approx(media_s, abs=1e-9)
    position = math.fmod(media_s * RATE_HZ, 20)
    is_slow = (
        speed * RATE_HZ <= 20
    )  # from the last frame back to the first; a faster medium jumps (touch_seam.h)
    back = 19 * (20 - position) if is_slow else 19.0
    assert desk.played_frame() == pytest.approx(position if position <= 19 else back, abs=1e-4)


def test_a_change_of_speed_is_continuous() -> None:
    desk = playing()
    desk.tick(101)
    desk.order(speed=0.25)
    desk.tick()  # the order is applied at its start
    before = desk.media_s
    assert before == pytest.approx(0.101)
    desk.tick(40)
    assert desk.media_s == pytest.approx(before + 0.01)


def test_pause_keeps_the_field_and_the_time() -> None:
    desk = playing()
    desk.tick(151)
    desk.order(mode=layout.PAUSED)
    force = desk.tick(400)
    assert desk.media_s == pytest.approx(0.151, abs=1e-9)
    assert force[2] == pytest.approx(0.5 + 0.151 * RATE_HZ / 64, abs=1e-6)
    desk.order(mode=layout.PLAYING)
    desk.tick(11)
    assert desk.media_s == pytest.approx(0.161, abs=1e-9) and desk.counts["underruns"] == 0


def test_the_end_is_a_ramp_to_zero() -> None:
    desk = playing(10)
    desk.tick(200)
    assert (
        desk.played_frame() == 9.0 and desk.value("clock.feed") == layout.RUNNING
    )  # the last frame stays for its duration
    assert desk.tick()[2] > 0 and desk.value("clock.feed") == layout.ENDED
    assert desk.tick(40) == (0.0, 0.0, 0.0) and desk.value("clock.is_resting")
    assert desk.media_s == pytest.approx(0.2)
    desk.order(seek_s=0.1)
    assert desk.tick(60)[2] > 0 and desk.value("clock.feed") == layout.RUNNING
    assert desk.media_s == pytest.approx(0.158, abs=2e-3)


def test_a_single_frame_stays() -> None:
    desk = playing(1)
    assert desk.tick(3000)[2] == pytest.approx(0.5)
    assert desk.value("clock.feed") == layout.RUNNING


def test_an_underrun_is_counted_once_and_keeps_time() -> None:
    desk = playing()
    desk.tick(50)
    desk.is_fed = False
    for ticks in (200, 50):  # the lookahead is used up, then the force fades to zero
        assert desk.tick(ticks) == (0.0, 0.0, 0.0)
    assert desk.counts["underruns"] == 1 and desk.counts["waits"] == 0
    late = desk.counts["stalled_ticks"]
    assert desk.media_s == pytest.approx(0.3, abs=2e-3) and 0 < late < 300
    assert desk.counts["stalled_share"] == late / 300
    desk.is_fed = True
    assert desk.tick(31)[2] > 0
    assert desk.media_s == pytest.approx(0.33, abs=2e-3)
    assert desk.counts["underruns"] == 1


def test_the_clock_stops_after_the_last_frame() -> None:
    desk = playing()
    desk.tick(50)
    desk.is_fed, desk.memory.receiver["orders"]["has_feed_failed"] = False, 1
    assert desk.tick(500) == (0.0, 0.0, 0.0)
    stood_s = desk.media_s
    desk.tick(500)
    assert desk.media_s == stood_s < 0.4 and desk.value("clock.feed") == layout.STALLED


def test_waiting_for_the_first_frames_is_no_underrun() -> None:
    desk = Desk(numbered_medium())
    desk.is_fed = False
    desk.order(mode=layout.PLAYING)
    assert desk.tick(30) == (0.0, 0.0, 0.0)
    assert (desk.counts["waits"], desk.counts["waiting_ticks"], desk.counts["underruns"]) == (1, 30, 0)
    desk.is_fed = True
    desk.tick(30)
    desk.is_fed = False
    desk.order(seek_s=0.2)
    desk.tick(30)
    assert (desk.counts["waits"], desk.counts["underruns"]) == (2, 0)
    assert desk.media_s == 0.2


def test_a_silent_player_stops_the_servo() -> None:
    desk = playing(1)
    desk.memory.receiver["orders"]["heartbeat_ns"] = START_NS
    assert desk.tick(1000)[2] > 0
    assert desk.tick(60) == (0.0, 0.0, 0.0)
    desk.memory.receiver["orders"]["heartbeat_ns"] = desk.now_ns
    assert desk.tick(60)[2] > 0 and desk.counts["underruns"] == 0


def test_a_stop_ends_in_zero() -> None:
    desk = playing(1)
    assert desk.tick(100)[2] > 0
    desk.order(is_stopping=True)
    assert desk.tick()[2] > 0 and not desk.value("clock.is_released")
    assert desk.tick(60) == (0.0, 0.0, 0.0) and desk.value("clock.is_released")
    desk.order(mode=layout.PLAYING)
    assert desk.tick(100) == (0.0, 0.0, 0.0)


def test_an_unfinished_order_is_not_applied() -> None:
    desk = playing()
    desk.tick(10)
    desk.memory.receiver["orders"]["sequence"] += 1
    desk.memory.receiver["orders"]["is_stopping"] = 1
    assert desk.tick(30)[2] > 0
    desk.memory.receiver["orders"]["sequence"] += 1
    assert desk.tick(60) == (0.0, 0.0, 0.0)


def test_time_of_a_simulated_device_is_the_number_of_its_tick() -> None:
    desk = playing()
    desk.memory.receiver["layout"]["is_simulated"] = 1
    desk.tick(101, step_ns=7_654_321)
    assert desk.media_s == pytest.approx(0.1, abs=1e-12)


def test_jitter_and_lateness_are_counted() -> None:
    desk = playing(1)
    late_ns = [0, 100_000, 0, 700_000, 3_500_000, 0, 0]
    for n, late in enumerate(late_ns):
        periods = n if n < 5 else n + 3  # three periods were missed
        native.cycle(desk.memory.bytes, 0.0, 0.0, 0.0, START_NS + periods * TICK_NS + late)
    counts = desk.counts
    assert counts["ticks"] == 7 and counts["missed_ticks"] == 3 and counts["late_ticks"] == 2
    assert counts["lateness_worst_us"] == 3500 and counts["jitter_worst_us"] == 2800
    assert counts["lateness_p50_us"] == 1 and counts["lateness_p99_9_us"] == 3500
    assert counts["seconds"] == pytest.approx(9e-3) and counts["mean_rate_hz"] == pytest.approx(6 / 9e-3)


@given(st.lists(st.integers(0, 5_000_000), min_size=3, max_size=60))
def test_quantiles_are_those_of_the_ticks(late_ns: list[int]) -> None:
    desk = playing(1)
    found = []
    for late in late_ns:
        deadline = desk.value("clock.deadline_ns") or START_NS
        found.append(late if desk.value("counts.ticks") else 0)
        native.cycle(desk.memory.bytes, 0.0, 0.0, 0.0, deadline + found[-1])
    ordered = np.sort(found) * 1e-3
    for name, fraction in (("p50", 0.5), ("p99", 0.99)):
        exact = ordered[max(math.ceil(fraction * len(ordered)) - 1, 0)]
        reported_us = desk.counts[f"lateness_{name}_us"]
        assert exact <= reported_us + 1e-9 and (reported_us <= exact + 1 or exact >= 3000)
    assert desk.counts["lateness_worst_us"] == pytest.approx(ordered[-1])


def test_each_used_frame_counts_once() -> None:
    desk = playing()
    for _ in range(20):
        desk.feeder.step()
    desk.tick(100)  # five frames, at 20 ms intervals
    assert desk.counts["frames_used"] == 5


def test_the_log_has_a_row_for_each_tick() -> None:
    desk = playing(3)
    forces = [desk.tick() for _ in range(120)]
    desk.log.drain()
    desk.order(mode=layout.PAUSED, seek_s=0.0)
    forces += [desk.tick() for _ in range(5)]
    desk.log.drain()
    rows = desk.log.rows()
    assert np.array_equal(rows["force_n"], forces) and desk.log.lost == 0
    assert rows["time_s"] == pytest.approx(np.arange(125) * 1e-3)
    assert rows["flags"][10] == FLAGS["running"] and rows["flags"][70] == FLAGS["ended"]
    assert rows["flags"][124] == FLAGS["paused"]
    assert rows["field_force_n"][10, 2] == pytest.approx(0.5 + 0.5 / 64)
    assert not rows["position_m"].any() and not rows["friction_n"].any()


def test_lost_rows_are_counted() -> None:
    desk = playing(1)
    ring = desk.session.layout.log_rows
    desk.tick(ring + 100)
    desk.log.drain()
    rows = desk.log.rows()
    assert len(rows) + desk.log.lost == ring + 100 and 100 <= desk.log.lost <= 101
    assert rows["time_s"][-1] == pytest.approx((ring + 99) * 1e-3)
    few = TickLog(desk.memory, 10)
    for _ in range(5):
        desk.tick(10)
        few.drain()
    assert len(few.rows()) == 10 and few.rows()["time_s"][-1] == pytest.approx((ring + 149) * 1e-3)
    few.let_go()
    few.drain()
    assert len(few.rows()) == 10
