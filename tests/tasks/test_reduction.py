"""A medium in fewer numbers (paper section 6.1): modes and their error, degrees of freedom, what no hand
reaches.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

import touchfield as tf
from touchfield.cli.main import _exit_code
from touchfield.errors import InvalidArgument
from touchfield.measure.estimators import binary_entropy_bits
from touchfield.pipeline.spec import ReductionSpec
from touchfield.reduction import (
    Hand,
    freedom,
    held_out,
    klt,
    pod,
    reach,
    reach_of,
    reduce_to_modes,
    snapshots,
)
from touchfield.reduction.kernels import weak_cells
from touchfield.reduction.reach import _Flood, _layers
from touchfield.tasks.reduction import reduce_medium, without_unreachable

HAND = Hand(push_n=1.0, mass_kg=0.1, speed_m_s=0.2)
STEP_M, COUNT = 0.003, 40
GRID = tf.Grid((COUNT,) * 3, (STEP_M,) * 3, (0.0,) * 3)


def matrix(seed: int, count: int = 24, length: int = 700) -> Any:
    rng = np.random.default_rng(seed)
    return (rng.normal(size=(count, 8)) * 10.0 ** -np.arange(8)) @ rng.normal(size=(8, length)) + 0.3


def floor(frames: int = 1, swing_m: float = 0.0) -> tf.HapticMedium:
    """A solid floor with a hill, which heaves: a wall of 1500 N/m up to 8 N."""
    x = np.stack(np.meshgrid(*[GRID.axis_m(a) for a in range(3)], indexing="ij"), axis=-1)
    fields = []
    for i in range(frames):
        t = 2 * np.pi * i / 30
        turn = 2 * np.pi * x[..., 0] / (COUNT * STEP_M) - t
        slope = -0.004 * 2 * np.pi / (COUNT * STEP_M) * np.cos(turn)
        height = 0.09 + 0.004 * np.sin(turn) + swing_m * np.sin(t)
        normal = np.stack([slope, 0 * slope, 1 + 0 * slope], axis=-1)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        size = np.minimum(1500 * np.maximum(height - x[..., 2], 0) * normal[..., 2], 8.0)
        fields.append(tf.ForceField.from_dense(GRID, (size[..., None] * normal).astype(np.float32)))
    return tf.HapticMedium.from_frames(fields, 60.0)


# -- modes -------------------------------------------------------------------------------------------------


@given(st.integers(0, 2**20))
def test_the_error_is_the_tail_known_beforehand(seed: int) -> None:
    snapshots = matrix(seed)
    modes = pod(snapshots)
    assert np.abs(modes.basis.T @ modes.basis - np.eye(modes.rank)).max() < 1e-12
    assert modes.energy == pytest.approx((snapshots**2).sum(), rel=1e-12)
    for rank in range(1, modes.rank + 1):
        some = modes.first(rank)
        error = ((snapshots - some.rebuild(some.coefficients(snapshots))) ** 2).sum()
        assert abs(error - modes.tail(rank)) <= 1e-10 * modes.energy
    for decibels in (-10.0, -40.0):
        rank = modes.rank_for(decibels)
        limit = 10 ** (decibels / 10) * modes.energy
        assert modes.tail(rank) <= limit and (rank == 0 or modes.tail(rank - 1) > limit)


def test_short_snapshots_give_the_same_modes() -> None:
    snapshots = matrix(1)
    whole = pod(snapshots)
    short = klt([snapshots.T[:100], snapshots.T[100:]])
    assert np.allclose(short.values[:5], whole.values[:5], rtol=1e-9)
    assert np.allclose(np.linalg.svd(snapshots, compute_uv=False)[:5], whole.values[:5], rtol=1e-9)
    assert whole.count == len(whole.values) == len(short.values) == 24 and short.count == 700
    few, tall = klt([snapshots.T[:4], snapshots.T[4:9]]), pod(snapshots.T[:40])
    assert (len(few.values), few.count, len(tall.values), tall.count) == (9, 9, 24, 40)
    assert pod(snapshots, 20).rank == pod(snapshots).rank == 8  # more are noise


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: pod(np.zeros((0, 3))),
        lambda: pod(np.full((2, 3), np.nan)),
        lambda: pod(np.ones((2, 3)), rank=3),
        lambda: pod(np.ones((2, 3), complex)),
        lambda: klt([]),
        lambda: klt([np.ones((2, 3)), np.ones((2, 4))]),
        lambda: pod(np.eye(3)).coefficients(np.ones((2, 4))),
        lambda: pod(np.eye(3)).rebuild(np.ones((2, 4))),
        lambda: reduce_to_modes(floor(), "columns"),
        lambda: held_out(floor(), "global"),
        lambda: held_out(
            tf.HapticMedium.from_frames([floor()[0], tf.ForceField.empty(GRID)], 30.0), "global"
        ),
        lambda: Hand(-1.0, 0.1, 0.2),
        lambda: ReductionSpec(nmse_db=3.0),
    ],
)
def test_what_makes_no_sense_is_refused(wrong: Any) -> None:
    with pytest.raises(InvalidArgument):
        wrong()


@pytest.mark.parametrize("kind", ["global", "bricks"])
def test_a_medium_comes_back_from_its_modes(kind: str) -> None:
    medium = floor(3)
    found = reduce_to_modes(medium, kind)
    energy = error = 0.0
    for i in range(len(medium)):
        own, back = medium[i].to_dense().astype(float), found.field(i).to_dense()
        energy, error = energy + (own**2).sum(), error + ((own - back) ** 2).sum()
    assert energy == pytest.approx(found.modes.energy, rel=1e-6)
    assert error <= found.modes.tail(found.modes.rank) + 1e-10 * energy


def test_frames_that_were_not_learnt_from_are_told_with_what_they_cost() -> None:
    medium = floor(60)
    found = held_out(medium, "global", -20.0)
    assert found.nmse_db <= -20.0 and found.share > found.share_of_coefficients > 0
    length = len(reduce_to_modes(medium, "global", 1).modes.basis)
    assert found.share == pytest.approx(found.modes * (length + 60) / (60 * length))
    learnt, odd = reduce_to_modes(medium, "global", 15, step=2), range(1, 60, 2)
    energy = sum(float((medium[i].forces_n.astype(float) ** 2).sum()) for i in odd)
    caught = sum(float((learnt.coefficients(i)[:, : found.modes] ** 2).sum()) for i in odd)
    assert found.nmse_db == pytest.approx(10 * np.log10(1 - caught / energy), abs=1e-3)
    assert (
        held_out(medium[:28], "global", -300.0).modes == 7
    )  # a quarter of the frames, where no number would do


def patchwork() -> tf.HapticMedium:
    """Eight bricks in each of 20 frames, each of six patterns of falling size."""
    frames = 20
    rng = np.random.default_rng(2)
    bricks = (rng.normal(size=(frames * 8, 6)) ** 3 * 0.5 ** np.arange(6)) @ rng.normal(size=(6, 1536))
    dense = bricks.reshape(frames, 2, 2, 2, 8, 8, 8, 3).transpose(0, 1, 4, 2, 5, 3, 6, 7)
    grid = tf.Grid((16,) * 3, (STEP_M,) * 3, (0.0,) * 3)
    return tf.HapticMedium.from_array(dense.reshape(frames, *grid.shape, 3).astype(np.float32), grid)


def test_of_bricks_the_greatest_coefficients_are_kept_with_their_places(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    medium, odd = patchwork(), range(1, 20, 2)
    learnt, asked = reduce_to_modes(medium, "bricks", 8, step=2), []
    monkeypatch.setattr(
        snapshots, "reduce_to_modes", lambda *given, step: asked.append((*given[1:], step)) or learnt
    )
    found, every = (held_out(medium, "bricks", decibels) for decibels in (-10.0, -300.0))
    assert asked == [("bricks", 8, 2)] * 2  # a mode for twenty bricks at most
    energy = error = kept = 0.0
    for i in odd:
        rows = learnt.coefficients(i)
        rows[np.abs(rows) < found.min_n * (1 - 1e-9)] = 0.0
        kept += np.count_nonzero(rows)
        own = medium[i].forces_n.reshape(8, -1).astype(float)
        energy, error = energy + (own**2).sum(), error + ((own - learnt.modes.rebuild(rows)) ** 2).sum()
    assert found.nmse_db == pytest.approx(10 * np.log10(error / energy), abs=1e-3) and found.nmse_db <= -10.0
    assert found.modes == 6 and found.numbers == pytest.approx(kept / 80)
    place_bits = 6 * binary_entropy_bits(found.numbers / 6)
    assert found.share_of_coefficients == pytest.approx((found.numbers + place_bits / 32) / 1536)
    assert found.share == pytest.approx(found.share_of_coefficients + 6 / 160)
    assert every.modes == every.numbers == 6 and every.share_of_coefficients == pytest.approx(6 / 1536)


def test_degrees_of_freedom_are_those_that_were_put_in() -> None:
    base = [floor(1)[0].to_dense(), floor(30)[7].to_dense()]
    both = [
        np.linalg.qr(np.stack([b.ravel() for b in base], axis=1))[0][:, k].reshape(base[0].shape)
        for k in (0, 1)
    ]
    frames = [100 * a * both[0] + 90 * b * both[1] for a in (-1, 1) for b in (-1, 1)] * 8
    medium = tf.HapticMedium.from_array(np.array(frames, np.float32), GRID)
    told = freedom(reduce_to_modes(medium, "global"), 0.05)
    assert 1.98 < told.effective < 2.0 and told.modes == 2
    assert told.bits == pytest.approx(1.0, abs=1e-9)  # heads or tails
    held = sum(field.support_count for field in medium)
    assert told.step_n == pytest.approx(0.05 * np.sqrt(12 * held / (32 * 2)))


# -- what no hand reaches ----------------------------------------------------------------------------------


def forces_along(
    medium: tf.HapticMedium, other: tf.HapticMedium, hand: Hand, seed: int, most_different: int | None = None
) -> tuple[int, float]:
    """Forces that differ along 500 paths of hands that do their worst, and the greatest one that they met.

    The hands stop once more than `most_different` forces differ.
    """
    medium, other = (tf.HapticMedium.from_frames(list(one), one.rate_hz) for one in (medium, other))
    rng, dt, count = np.random.default_rng(seed), 1e-3, 500
    high = GRID.to_m(np.array(GRID.shape) - 1)
    x = rng.uniform(0, 1, (count, 3)) * [high[0], high[1], 0.012] + [0, 0, high[2] - 0.012]
    v, differ, most = hand.speed_m_s * np.eye(3)[rng.integers(0, 3, count)], 0, 0.0
    for t in range(700):
        force = medium.sample_n(x, t * dt).astype(float)
        differ += int((force != other.sample_n(x, t * dt)).any(axis=1).sum())
        size = np.linalg.norm(force, axis=1, keepdims=True)
        most = max(most, float(size.max()))
        along = v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-9)
        swings = np.where(size > 0, along, [0.0, 0.0, -1.0])  # with the motion: each turn gains energy
        presses = np.where(size > 0, -force / np.maximum(size, 1e-9), [0.0, 0.0, -1.0])
        v = v + dt / hand.mass_kg * (
            force + hand.push_n * np.where(np.arange(count)[:, None] % 2, swings, presses)
        )
        speed = np.linalg.norm(v, axis=1, keepdims=True)
        v = v * np.minimum(1.0, hand.speed_m_s / np.maximum(speed, 1e-9))
        x = np.clip(x + dt * v, 0, high)
        if most_different is not None and differ > most_different:
            break
    return differ, most


@pytest.mark.parametrize(("frames", "swing_m"), [(1, 0.0), (45, 0.003)])
def test_no_hand_feels_what_is_left_out_of_a_solid(frames: int, swing_m: float) -> None:
    medium = floor(frames, swing_m)
    reach = reach_of(medium, HAND)
    shell = without_unreachable(medium, reach.samples)
    assert shell[0].support_count < 0.5 * medium[0].support_count and reach.stopped_n > HAND.push_n
    differ, most = forces_along(medium, shell, HAND, 3)
    assert differ == 0 and most > 1.0
    skin = np.linalg.norm(medium[0].to_dense(), axis=-1) < 2.0
    assert (
        forces_along(medium, without_unreachable(medium, skin), HAND, 3, most_different=0)[0] > 0
    )  # these hands do come in


def test_a_hand_that_is_stronger_than_the_field_reaches_all() -> None:
    medium = floor()
    assert reach_of(medium, Hand(9.0, 0.1, 0.2)).samples.all()
    assert reach_of(medium, Hand(1.0, 0.1, 5.0)).samples.all()
    shallow = np.where(
        floor()[0].to_dense()[..., 2:] > 6, 0, floor()[0].to_dense()
    )  # a skin, and nothing behind
    assert reach_of(tf.HapticMedium.from_array(shallow, GRID), HAND).samples.all()
    flat, full = floor()[0].to_dense()[None, :, :1], np.full((1, *GRID.shape, 3), 4.0)
    for forces in (flat, full):  # of one sample along y; and no place to begin at
        grid = tf.Grid(forces.shape[1:4], GRID.spacing_m, GRID.origin_m)
        assert reach_of(tf.HapticMedium.from_array(forces, grid), HAND).samples.all()


def test_the_strongest_frame_counts_and_frames_that_do_not_fit_together_are_looked_at_in_turn(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    own = floor(3, 0.003)
    deep = np.pad(
        own[1].to_dense()[:, :, 6:], [(0, 0), (0, 0), (0, 6), (0, 0)]
    )  # the floor of a frame is lower
    medium = tf.HapticMedium.from_frames(
        [own[0].scaled(0.9), tf.ForceField.from_dense(GRID, deep), own[2]], 60.0
    )
    whole = reach_of(medium, HAND)
    assert whole.stopped_n == pytest.approx(0.4 * 8) and not whole.samples.all()
    monkeypatch.setattr(reach, "_FRAMES_BYTES", 1)
    np.testing.assert_array_equal(reach_of(medium, HAND).samples, whole.samples)


def test_a_faster_hand_reaches_farther_and_more_friction_stops_no_less() -> None:
    medium = floor()
    slow, fast = (int(reach_of(medium, Hand(1.0, 0.1, v)).samples.sum()) for v in (0.05, 0.3))
    assert slow <= fast


@pytest.mark.parametrize("hand", [HAND, Hand(0.1, 0.5, 0.3), Hand(2.0, 0.02, 0.1)])
def test_a_layer_turns_a_hand_by_the_rule_at_the_head_of_the_module(hand: Hand) -> None:
    layers = _layers(floor(), hand, 8.0)
    assert layers
    for layer in layers:
        double_energy = hand.mass_kg * hand.speed_m_s**2
        least = (
            hand.push_n
            + double_energy / layer.start_m
            + double_energy / (2 * (layer.depth_m - layer.start_m))
        )
        assert least <= layer.need_n <= 2 * least
        flood = _Flood(floor(), layer, hand)  # with 5 % to spare, and neither more nor less
        assert flood.turn_nm == pytest.approx(1.05 * double_energy)
        assert flood.need_n == pytest.approx(1.05 * (least - double_energy / layer.start_m))
    assert (
        len(_layers(floor(), Hand(0.4 * 8.0 / 1.05, 0.01, 0.01), 8.0)) == 1
    )  # nothing to spare in the weaker one


PLACES = np.array([(i, j, 7) for i in (3, 4) for j in (3, 4)])
"""Nodes above a cell whose corners are nodes 3 and 4 of each axis."""


def is_weak(corners: Any, place: Any, step_m: Any, turn_nm: float, friction: float) -> bool:
    """True if forces at the corners of a cell, [2, 2, 2, 3], do not hold back a hand that comes from a
    place.
    """
    edges, weak = np.zeros((2, 8, 8, 8), bool), np.zeros(1, bool)
    edges[(0, *place)] = True
    cells, frames = np.full((1, 3), 3), corners[None].astype(np.float32)
    weak_cells(0, 1, cells, np.ones(1), edges, 2.0, 3, frames, np.array(step_m), 0.0, turn_nm, friction, weak)
    return bool(weak[0])


def least_held_nm(corners: Any, place: Any, step_m: Any, friction: float, points: int) -> float:
    """The least of -(x - a) . F - mu |(x - a) x F| at points of a cell, N m,
    of forces between its corners.
    """
    share = np.linspace(0.0, 1.0, points)
    weights = np.stack([1.0 - share, share])
    forces = np.einsum(
        "ia,jb,kc,ijkn->abcn", weights, weights, weights, corners.astype(np.float32).astype(float)
    )
    x = np.stack(np.meshgrid(share, share, share, indexing="ij"), axis=-1) * step_m
    away = x - (np.array(place) - 3) * step_m
    across = np.linalg.norm(np.cross(away, forces), axis=-1)
    return float((-(away * forces).sum(axis=-1) - friction * across).min())


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_a_cell_that_holds_at_its_corners_is_strong_only_if_it_holds_between_them(friction: float) -> None:
    rng, step_m, dips, strong = np.random.default_rng(4), (0.002, 0.003, 0.004), 0, 0
    for n in range(200):
        slopes, index = rng.normal(size=2), np.indices((2, 2, 2)) - 0.5
        corners = np.array([0.0, 0.0, 3.0]) + rng.normal(size=(2, 2, 2, 3)) * [0.2, 0.2, 0.05]
        for axis in range(2):
            corners[..., axis] += 2.0 * slopes[axis] * index[axis]
        place = PLACES[n % 4]
        at_corners, between = (least_held_nm(corners, place, step_m, friction, points) for points in (2, 9))
        turn_nm = at_corners - (0.003 if friction else 0.0003) * rng.random()
        dips += between < turn_nm
        if not is_weak(corners, place, step_m, turn_nm, friction):
            strong += 1
            assert between >= turn_nm - 1e-9
    assert strong > 20 and (friction or dips > 40)


@pytest.mark.parametrize("place", PLACES.tolist(), ids=str)
@pytest.mark.parametrize("axis", range(3))
def test_a_force_that_rises_from_corner_to_corner_loses_nothing_between_them(
    axis: int, place: list[int]
) -> None:
    corners, step_m = np.zeros((2, 2, 2, 3)), (0.002, 0.003, 0.004)
    corners[..., 2] = 3.0
    corners[..., axis] += np.indices((2, 2, 2))[axis] - 0.5
    held_nm = least_held_nm(corners, place, step_m, 0.0, 2)
    assert least_held_nm(corners, place, step_m, 0.0, 9) >= held_nm - 1e-9
    assert not is_weak(corners, place, step_m, held_nm - 1e-6, 0.0)
    assert is_weak(corners, place, step_m, held_nm + 1e-6, 0.0)


# -- the command -------------------------------------------------------------------------------------------


def test_the_command_tells_and_writes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    field, log = tmp_path / "floor.npz", tmp_path / "log.csv"
    medium = floor(4)
    tf.write_field(field, medium)
    log.write_text(
        "t_s,x_m,y_m,z_m\n" + "".join(f"{i / 1000},{0.03 + i * 5e-5},0.06,0.088\n" for i in range(100))
    )
    names = [str(tmp_path / name) for name in ("few.touch", "shell.touch")]
    few, shell = names
    hand = ["--push-n", "1", "--mass-kg", "0.1"]
    asked = ["reduce", str(field), few, "--cull", shell, "--mode", "lossless", *hand, "--json"]
    assert _exit_code(asked) == 0
    told = json.loads(capsys.readouterr().out)
    assert all(Path(name).stat().st_size for name in names)
    assert told["nmse_db"] < -29 and told["held_out"]["modes"] >= 1 and told["behind_samples"] > 0
    assert any("begins where no force is" in note for note in told["notes"])
    with tf.open_stream(shell) as stream:
        felt = reach_of(stream.medium, HAND).samples
        assert stream.medium[3].support_count == np.count_nonzero(
            (medium[3].to_dense() != 0).any(-1) & reach_of(medium, HAND).samples
        )
        assert felt.any()
    assert _exit_code(["reduce", str(field), "--trace", str(log), "--device", "touch", *hand, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["never_visited_samples"] > told["behind_samples"]


def test_bad_input_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    field = tmp_path / "floor.npz"
    tf.write_field(field, floor(2))
    for wrong in (
        ["--modes", "x"],
        ["--rank", "0"],
        ["--push-n", "nan"],
        ["--nmse-db", "3"],
        ["--cull", str(field)],
    ):
        assert _exit_code(["reduce", str(field), *wrong]) in (1, 2)
        assert len(capsys.readouterr().err.strip().splitlines()) == 1
    empty = tmp_path / "empty.npz"
    tf.write_field(empty, tf.HapticMedium.from_array(np.zeros((2, *GRID.shape, 3)), GRID))
    assert _exit_code(["reduce", str(empty)]) in (1, 2)
    assert "no frame with a force" in capsys.readouterr().err
    assert reduce_medium(field, spec=ReductionSpec(rank=1)).figures["rank"] == 1


def test_a_hand_is_told_with_its_own_figures() -> None:
    hand = Hand(push_n=2.5, mass_kg=0.125, speed_m_s=0.3)
    assert hand.text == "a hand of 125 g with its device that pushes with 2.5 N and moves at 0.3 m/s at most"
    assert hand.lunge_nm == pytest.approx(0.125 * 0.3**2)
    for name in ("push_n", "mass_kg", "speed_m_s"):
        with pytest.raises(InvalidArgument, match=f"{name}: found 0"):
            replace(hand, **{name: 0.0})
