"""The delay of the loop: what is measured, and that the larger of measured and stated delay is used."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from player_makers import OMNI, RestingDevice, Simulated, laid_out, numbered_medium

from touchfield.render.block import Memory, layout
from touchfield.render.loop_delay import LoopMeter, LoopTimes
from touchfield.render.player import Player, Session
from touchfield.render.point_device import Point
from touchfield.render.servo import VirtualClock, serve
from touchfield.render.spec import DEFAULT_DELAY_S, RenderSpec, delay_s_of, stability_of


class Slow(RestingDevice):
    """Takes 4 ms to read its position, and 2 ms to set its force."""

    def position_m(self) -> Point:
        time.sleep(0.004)
        return super().position_m()

    def put_force_n(self, x: float, y: float, z: float) -> None:
        time.sleep(0.002)
        super().put_force_n(x, y, z)


def lag(delay_s: float, period_s: float = 1e-3) -> Callable[[float], float]:
    return LoopTimes(delay_s, delay_s, period_s).lag_s


def test_the_first_report_comes_soon_and_a_later_one_only_if_the_loop_is_slower() -> None:
    reports: list[LoopTimes] = []
    meter = LoopMeter(reports.append)
    for n in range(51):  # the period of the first tick is not known
        meter.add(1e-4 * (n + 1), 2e-3 * n)
    assert len(reports) == 1
    assert reports[0].median_s == pytest.approx(2.7e-3) and reports[0].delay_s == pytest.approx(4.6e-3)
    assert reports[0].period_s == pytest.approx(2e-3)
    for n in range(51, 1000):
        meter.add(4.6e-3, 2e-3 * n)
    assert len(reports) == 1
    for n in range(1000, 2000):
        meter.add(5e-3, 2e-3 * n)
    assert len(reports) == 2 and reports[1].delay_s == pytest.approx(5e-3)


def test_a_slow_loop_is_reported_after_a_tenth_of_a_second() -> None:
    reports: list[LoopTimes] = []
    meter = LoopMeter(reports.append)
    for n in range(12):
        meter.add(8e-3, 1e-2 * n)
        assert bool(reports) == (n >= 10)
    assert reports[0] == pytest.approx((8e-3, 8e-3, 1e-2))
    frames = LoopMeter(reports.append)
    for n in range(11):  # a driver that calls us: ten ticks for each that is seen
        frames.add(2e-4, 1e-2 * n, ticks=10)
    assert reports[1] == pytest.approx((2e-4, 2e-4, 1e-3))


def test_a_period_above_the_nominal_one_adds_half_of_the_difference() -> None:
    assert LoopTimes(0.0, 1e-3, 3e-3).lag_s(1000.0) == pytest.approx(2e-3)
    assert LoopTimes(0.0, 1e-3, 0.25e-3).lag_s(1000.0) == pytest.approx(1e-3)


def test_one_late_tick_in_ten_does_not_count() -> None:
    reports: list[LoopTimes] = []
    meter = LoopMeter(reports.append)
    for n in range(101):
        meter.add(0.05 if n % 10 == 5 else 1e-4, 1e-3 * n)
    assert reports[0].delay_s == pytest.approx(1e-4)


def test_the_assumed_delay_is_that_of_the_settings() -> None:
    unknown, stated = replace(OMNI, delay_ms=None), replace(OMNI, delay_ms=1e3 * DEFAULT_DELAY_S)
    spec = RenderSpec()
    assert stability_of(unknown, spec, 0.0, 500.0) == stability_of(stated, spec, 0.0, 500.0)
    assert stability_of(unknown, spec, 0.0, 500.0) != stability_of(
        replace(OMNI, delay_ms=2.0), spec, 0.0, 500.0
    )
    assert delay_s_of(unknown) == 1e-3 and delay_s_of(replace(OMNI, delay_ms=2.5)) == 2.5e-3


def settings_for(delay_ms: float) -> tuple[np.ndarray, np.ndarray]:
    """Settings of a session for a device that states this delay."""
    session = Session(numbered_medium(1), replace(OMNI, delay_ms=delay_ms), RenderSpec())
    memory = Memory.empty(session.layout.size_bytes)
    session.set_up(memory)
    session._adapt(memory, 800.0)
    return session, memory.receiver["settings"].copy()


def test_a_slow_loop_has_the_settings_of_a_profile_that_states_its_delay() -> None:
    session, memory = laid_out(numbered_medium(1))
    session._adapt(memory, 800.0)
    before = memory.receiver["settings"].copy()
    session.adapt_delay(memory, lag(0.5e-3))
    assert memory.receiver["settings"] == before and not any("from position" in n for n in session.notes)
    session.adapt_delay(memory, lag(3e-3))
    assert session.delay_s == pytest.approx(3e-3)
    _, expected = settings_for(3.0)
    _, assumed = settings_for(1.0)
    assert memory.receiver["settings"] == expected
    assert before == assumed and before != expected
    (note,) = [note for note in session.notes if "from position to force" in note]
    assert "takes 3 ms, more than the 1 ms that is assumed" in note
    assert any("N/m" in other and "damping" in other for other in session.notes)


def test_a_delay_below_that_of_the_profile_changes_nothing() -> None:
    profile = replace(OMNI, delay_ms=5.0)
    session = Session(numbered_medium(1), profile, RenderSpec())
    memory = Memory.empty(session.layout.size_bytes)
    session.set_up(memory)
    before = memory.receiver["settings"].copy()
    session.adapt_delay(memory, lag(4e-3))
    assert memory.receiver["settings"] == before and session.delay_s == 5e-3


def test_while_it_plays_the_delay_is_approached_in_small_steps() -> None:
    session, memory = laid_out(numbered_medium(1))
    session._adapt(memory, 800.0)
    session.order(memory, mode=layout.PLAYING)
    delays = [session.delay_s]
    brakes = [float(memory.receiver["settings"]["brake_n_s_per_m"])]
    for _ in range(40):
        session.adapt_delay(memory, lag(3e-3))
        delays.append(session.delay_s)
        brakes.append(float(memory.receiver["settings"]["brake_n_s_per_m"]))
    assert delays[-1] == pytest.approx(3e-3) and max(np.diff(delays)) < 2e-4
    assert (np.diff(delays) >= 0).all() and delays[10] < 2e-3 and len(set(brakes)) > 5
    _, expected = settings_for(3.0)
    assert memory.receiver["settings"] == expected


def test_a_driver_that_is_slow_is_measured_before_play_and_noted() -> None:
    with Player(numbered_medium(20), OMNI, Slow, loop=True, is_realtime=False) as player:
        assert player._session.delay_s >= 6e-3  # before a force was applied
        player.play()
        player.wait(0.2)
        figures = player.statistics()
        assert 6e3 <= figures["delay_p50_us"] <= figures["delay_p90_us"]
        # the hold lasts for a whole period of 6 ms in place of 1 ms
        assert figures["delay_used_us"] >= figures["delay_p90_us"] + 2e3
        assert any(
            "from position to force" in note and "1 ms that is assumed" in note for note in player.notes
        )


def test_a_simulated_device_has_no_delay_to_measure() -> None:
    with Player(numbered_medium(20), OMNI, Simulated, is_realtime=False) as player:
        player.play()
        player.wait(0.2)
        figures = player.statistics()
    assert figures["delay_p50_us"] is None and figures["delay_used_us"] == 1e6 * DEFAULT_DELAY_S
    session, memory = laid_out(numbered_medium(5))
    session.order(memory, mode=layout.PLAYING)
    reports: list[LoopTimes] = []
    ticks = memory.receiver["counts"]
    serve(memory, Simulated(), VirtualClock(), lambda: bool(ticks["ticks"] > 300), report_loop=reports.append)
    assert not reports
