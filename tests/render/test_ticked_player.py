"""`TickedPlayer` renders the forces of the player, tick by tick in the caller's loop."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from player_makers import numbered_medium

import touchfield as tf
from touchfield.devices import device
from touchfield.devices.drivers.simulated import SimHand
from touchfield.errors import CorruptFile, InvalidArgument
from touchfield.medium import Grid, HapticMedium
from touchfield.medium.trace import Trace
from touchfield.render.offline import run_offline
from touchfield.render.spec import RenderSpec
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Box

GOLDEN = Path(__file__).resolve().parents[2] / "conformance" / "v1"
PROFILE, SPEC, TICK_NS = device("phantom-omni"), RenderSpec(up="lattice"), 1_000_000


@pytest.fixture(scope="module")
def plate(tmp_path_factory: pytest.TempPathFactory) -> HapticMedium:
    """A plate of 60 x 40 x 2 mm."""
    path = tmp_path_factory.mktemp("plate") / "plate.touch"
    tf.encode(AnalyticScene((Box((0, 0, 0), (0.03, 0.02, 0.001)),)), path, tf.EncodeSpec(nw=7, mapping="1"))
    return tf.decode(path)


def forces_n(player: tf.TickedPlayer, positions_m: np.ndarray, first: int = 0) -> np.ndarray:
    """Forces of successive ticks of 1 ms, float64 [n, 3]."""
    rows = enumerate(np.atleast_2d(positions_m).tolist())
    return np.array([player.tick(tuple(p), (first + n) * TICK_NS) for n, p in rows])


def press(count: int) -> np.ndarray:
    """A hand that goes from 5 mm above the plate to its underside and rests, float64 [count, 3]."""
    height_m = np.interp(np.arange(count), [0, 300, count], [0.006, -0.001, -0.001])
    return np.stack([np.full(count, 0.004), np.full(count, 0.003), height_m], axis=1)


@pytest.mark.parametrize("name", ["touch-block", "objects-touch", "objects-touch-deforming"])
def test_forces_are_those_of_the_player(name: str) -> None:
    with tf.open_stream(GOLDEN / f"{name}.touch") as stream:
        medium = stream.scene or stream.medium
        profile = replace(PROFILE, axes=medium.axes)
        low, high = stream.grid.box_m
        corners = low + (high - low) * np.random.default_rng(5).uniform(0.2, 0.8, (9, 3))
        way = np.stack([np.interp(np.linspace(0, 8, 400), np.arange(9), c) for c in corners.T], axis=1)
        hand = SimHand(Trace(np.arange(400) * 1e-3, way, None))
        log = run_offline(medium, profile, lambda: hand, SPEC, seconds=0.4, loop=True).log[:400]
        with tf.TickedPlayer(medium, profile, SPEC, loop=True, is_simulated=True) as player:
            player.play()
            found_n = forces_n(player, log["position_m"])
    assert np.abs(found_n).max() > 0.05
    np.testing.assert_allclose(found_n, log["force_n"], atol=1e-9, rtol=0)


def test_thin_plate_resists_the_hand_until_a_stop(plate: HapticMedium) -> None:
    with tf.TickedPlayer(plate, PROFILE, SPEC, is_simulated=True) as player:
        player.play()
        pressed_n = forces_n(player, press(600))
        assert (pressed_n[400:, 2] > 0.5).all()  # the stored force would push the hand down, or not at all
        player.stop()
        released_n = forces_n(player, np.tile(press(600)[-1], (40, 1)), 600)
        assert player.is_released and not released_n[-1].any()
    steps_n = np.linalg.norm(np.diff(np.concatenate([pressed_n, released_n]), axis=0), axis=1)
    assert steps_n.max() <= player.force_max_n / 0.005 * 1e-3


@pytest.mark.parametrize("missing", [None, (math.nan, 0.0, 0.0)])
def test_force_ramps_without_a_position_and_returns(
    plate: HapticMedium, missing: tuple[float, float, float] | None
) -> None:
    with tf.TickedPlayer(plate, PROFILE, SPEC, is_simulated=True) as player:
        player.play()
        before_n = np.linalg.norm(forces_n(player, press(600))[-1])
        sizes_n = [math.hypot(*player.tick(missing, (600 + n) * TICK_NS)) for n in range(30)]
        assert 0.9 * before_n < sizes_n[0] < before_n
        assert sizes_n == sorted(sizes_n, reverse=True) and sizes_n[-1] == 0.0
        again_n = forces_n(player, np.concatenate([press(600)[:300:3], press(600)[300:]]), 630)
    assert np.linalg.norm(again_n[-1]) == pytest.approx(before_n, rel=0.01)


def test_orders_move_the_media_clock() -> None:
    grid = Grid((8, 8, 8), (0.01,) * 3, (0.0, 0.0, 0.0))
    frames = np.zeros((10, 8, 8, 8, 3), np.float32)
    frames[..., 0] = np.linspace(0.1, 1.0, 10)[:, None, None, None]
    medium = HapticMedium.from_array(frames, grid, 100.0)
    middle = np.full((1, 3), 0.035)
    with tf.TickedPlayer(medium, PROFILE, SPEC, is_simulated=True) as player:
        assert not forces_n(player, middle).any() and player.media_s == 0.0
        player.play()
        forces_n(player, np.repeat(middle, 21, axis=0), 1)
        assert player.media_s == pytest.approx(0.02)
        player.pause()
        forces_n(player, np.repeat(middle, 9, axis=0), 22)
        paused_s = player.media_s
        assert forces_n(player, np.repeat(middle, 9, axis=0), 31).any() and player.media_s == paused_s
        player.seek(0.07)
        player.play()
        forces_n(player, np.repeat(middle, 11, axis=0), 40)
        assert player.media_s == pytest.approx(0.08, abs=0.002) and not player.is_ended
        forces_n(player, np.repeat(middle, 60, axis=0), 51)
        assert player.is_ended
        with pytest.raises(InvalidArgument):
            player.seek(-1.0)


def test_thread_decodes_ahead_in_real_time() -> None:
    with (
        tf.open_stream(GOLDEN / "touch-block.touch") as stream,
        tf.TickedPlayer(stream.medium, PROFILE, SPEC, loop=True) as player,
    ):
        low, high = stream.grid.box_m
        player.play()
        deadline_s = time.monotonic() + 10.0
        while player.media_s < 0.1 and time.monotonic() < deadline_s:
            player.tick(tuple((0.5 * (low + high)).tolist()))
            time.sleep(0.001)
        assert player.media_s >= 0.1 and player.error is None


@pytest.mark.parametrize("seek_s", [0.1, 0.3])
def test_a_simulated_player_goes_on_after_a_seek(seek_s: float) -> None:
    """Back, too, in a loop whose frames are counted on."""
    medium = numbered_medium(20)
    with tf.TickedPlayer(medium, PROFILE, SPEC, loop=True, is_simulated=True) as player:
        player.play()
        forces_n(player, np.zeros((1000, 3)))
        player.seek(seek_s)
        found_n = forces_n(player, np.zeros((300, 3)), 1000)
        assert player.media_s == pytest.approx(seek_s + 0.3, abs=0.01)
    with tf.TickedPlayer(medium, PROFILE, SPEC, loop=True, start_s=seek_s, is_simulated=True) as player:
        player.play()
        fresh_n = forces_n(player, np.zeros((300, 3)))
    assert np.linalg.norm(fresh_n[-1]) > 0.4
    np.testing.assert_allclose(found_n[-1], fresh_n[-1], atol=0.02)


def test_error_of_the_medium_ends_the_force() -> None:
    medium = numbered_medium(20, corrupt_from=15)
    with tf.TickedPlayer(medium, PROFILE, SPEC, is_simulated=True) as player:
        player.play()
        found_n = forces_n(player, np.zeros((int(1000 * 20 / medium.rate_hz), 3)))
        assert found_n.any() and not found_n[-1].any()
        assert player.is_ended and isinstance(player.error, CorruptFile)
    with pytest.raises(CorruptFile), tf.TickedPlayer(numbered_medium(20, corrupt_from=1), PROFILE, SPEC):
        pass
