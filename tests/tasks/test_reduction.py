"""Dimension reduction (paper section 6.1): modes and their error, degrees of freedom, unreachable samples."""

from __future__ import annotations

import json
from dataclasses import replace
from importlib.util import find_spec
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
from touchfield.viewer import reduction as reduction_pictures

HAND = Hand(push_n=1.0, mass_kg=0.1, speed_m_s=0.2)
STEP_M, COUNT = 0.003, 40
GRID = tf.Grid((COUNT,) * 3, (STEP_M,) * 3, (0.0,) * 3)


def matrix(seed: int, count: int = 24, length: int = 700) -> Any:
    rng = np.random.default_rng(seed)
    return (rng.normal(size=(count, 8)) * 10.0 ** -np.arange(8)) @ rng.normal(size=(8, length)) + 0.3


def floor(frames: int = 1, swing_m: float = 0.0) -> tf.HapticMedium:
    """A solid floor with a hill that heaves: a wall of 1500 N/m up to 8 N."""
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
def test_the_error_equals_the_tail_of_the_energy(seed: int) -> None:
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
    expected = pod(snapshots)
    short = klt([snapshots.T[:100], snapshots.T[100:]])
    assert np.allclose(short.values[:5], expected.values[:5], rtol=1e-9)
    assert np.allclose(np.linalg.svd(snapshots, compute_uv=False)[:5], expected.values[:5], rtol=1e-9)
    assert expected.count == len(expected.values) == len(short.values) == 24 and short.count == 700
    few, tall = klt([snapshots.T[:4], snapshots.T[4:9]]), pod(snapshots.T[:40])
    assert (len(few.values), few.count, len(tall.values), tall.count) == (9, 9, 24, 40)
    assert pod(snapshots, 20).rank == pod(snapshots).rank == 8  # the rest is noise


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
def test_invalid_snapshots_are_refused(wrong: Any) -> None:
    with pytest.raises(InvalidArgument):
        wrong()


@pytest.mark.parametrize("kind", ["global", "bricks"])
def test_a_medium_is_rebuilt_from_its_modes(kind: str) -> None:
    medium = floor(3)
    found = reduce_to_modes(medium, kind)
    energy = error = 0.0
    for i in range(len(medium)):
        original, rebuilt = medium[i].to_dense().astype(float), found.field(i).to_dense()
        energy, error = energy + (original**2).sum(), error + ((original - rebuilt) ** 2).sum()
    assert energy == pytest.approx(found.modes.energy, rel=1e-6)
    assert error <= found.modes.tail(found.modes.rank) + 1e-10 * energy


@pytest.mark.parametrize("kind", ["global", "bricks"])
@pytest.mark.parametrize("step", [2, 3])
def test_modes_are_those_of_the_frames_at_the_step(kind: str, step: int) -> None:
    """As of a medium that has no other frames; frames between them have an energy of their own."""
    medium = floor(8, swing_m=0.02)
    some = tf.HapticMedium.from_frames([medium[i] for i in range(0, 8, step)], 60.0)
    found, expected = reduce_to_modes(medium, kind, step=step).modes, reduce_to_modes(some, kind).modes
    assert found.energy == expected.energy != reduce_to_modes(medium, kind).modes.energy
    np.testing.assert_array_equal(found.basis, expected.basis)


def test_held_out_frames_are_reported_with_their_size() -> None:
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
    )  # a quarter of the frames, if no number is sufficient


def patchwork() -> tf.HapticMedium:
    """Eight bricks in each of 20 frames, each of six patterns of decreasing size."""
    frames = 20
    rng = np.random.default_rng(2)
    bricks = (rng.normal(size=(frames * 8, 6)) ** 3 * 0.5 ** np.arange(6)) @ rng.normal(size=(6, 1536))
    dense = bricks.reshape(frames, 2, 2, 2, 8, 8, 8, 3).transpose(0, 1, 4, 2, 5, 3, 6, 7)
    grid = tf.Grid((16,) * 3, (STEP_M,) * 3, (0.0,) * 3)
    return tf.HapticMedium.from_array(dense.reshape(frames, *grid.shape, 3).astype(np.float32), grid)


def test_the_largest_coefficients_of_bricks_are_stored_with_their_indices(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    medium, odd = patchwork(), range(1, 20, 2)
    learnt, calls = reduce_to_modes(medium, "bricks", 8, step=2), []
    monkeypatch.setattr(
        snapshots, "reduce_to_modes", lambda *args, step: calls.append((*args[1:], step)) or learnt
    )
    found, every = (held_out(medium, "bricks", decibels) for decibels in (-10.0, -300.0))
    assert calls == [("bricks", 8, 2)] * 2  # at most one mode for twenty bricks
    energy = error = count = 0.0
    for i in odd:
        rows = learnt.coefficients(i)
        rows[np.abs(rows) < found.min_n * (1 - 1e-9)] = 0.0
        count += np.count_nonzero(rows)
        original = medium[i].forces_n.reshape(8, -1).astype(float)
        energy, error = (
            energy + (original**2).sum(),
            error + ((original - learnt.modes.rebuild(rows)) ** 2).sum(),
        )
    assert found.nmse_db == pytest.approx(10 * np.log10(error / energy), abs=1e-3) and found.nmse_db <= -10.0
    assert found.modes == 6 and found.numbers == pytest.approx(count / 80)
    index_bits = 6 * binary_entropy_bits(found.numbers / 6)
    assert found.share_of_coefficients == pytest.approx((found.numbers + index_bits / 32) / 1536)
    assert found.share == pytest.approx(found.share_of_coefficients + 6 / 160)
    assert every.modes == every.numbers == 6 and every.share_of_coefficients == pytest.approx(6 / 1536)


def test_degrees_of_freedom_are_recovered() -> None:
    base = [floor(1)[0].to_dense(), floor(30)[7].to_dense()]
    both = [
        np.linalg.qr(np.stack([b.ravel() for b in base], axis=1))[0][:, k].reshape(base[0].shape)
        for k in (0, 1)
    ]
    frames = [100 * a * both[0] + 90 * b * both[1] for a in (-1, 1) for b in (-1, 1)] * 8
    medium = tf.HapticMedium.from_array(np.array(frames, np.float32), GRID)
    result = freedom(reduce_to_modes(medium, "global"), 0.05)
    assert 1.98 < result.effective < 2.0 and result.modes == 2
    assert result.bits == pytest.approx(1.0, abs=1e-9)  # one fair coin
    support_count = sum(field.support_count for field in medium)
    assert result.step_n == pytest.approx(0.05 * np.sqrt(12 * support_count / (32 * 2)))


# -- unreachable samples ----------------------------------------------------------------------------------


def forces_along(
    medium: tf.HapticMedium, other: tf.HapticMedium, hand: Hand, seed: int, max_different: int | None = None
) -> tuple[int, float]:
    """Number of differing forces along 500 paths of worst-case hands, and the greatest force on them.

    The hands stop once more than `most_different` forces differ.
    """
    medium, other = (tf.HapticMedium.from_frames(list(source), source.rate_hz) for source in (medium, other))
    rng, dt, count = np.random.default_rng(seed), 1e-3, 500
    high = GRID.to_m(np.array(GRID.shape) - 1)
    x = rng.uniform(0, 1, (count, 3)) * [high[0], high[1], 0.012] + [0, 0, high[2] - 0.012]
    v, differ, max_force_n = hand.speed_m_s * np.eye(3)[rng.integers(0, 3, count)], 0, 0.0
    for t in range(700):
        force = medium.sample_n(x, t * dt).astype(float)
        differ += int((force != other.sample_n(x, t * dt)).any(axis=1).sum())
        size = np.linalg.norm(force, axis=1, keepdims=True)
        max_force_n = max(max_force_n, float(size.max()))
        along = v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-9)
        swings = np.where(size > 0, along, [0.0, 0.0, -1.0])  # along the motion: each turn gains energy
        presses = np.where(size > 0, -force / np.maximum(size, 1e-9), [0.0, 0.0, -1.0])
        v = v + dt / hand.mass_kg * (
            force + hand.push_n * np.where(np.arange(count)[:, None] % 2, swings, presses)
        )
        speed = np.linalg.norm(v, axis=1, keepdims=True)
        v = v * np.minimum(1.0, hand.speed_m_s / np.maximum(speed, 1e-9))
        x = np.clip(x + dt * v, 0, high)
        if max_different is not None and differ > max_different:
            break
    return differ, max_force_n


@pytest.mark.parametrize(("frames", "swing_m"), [(1, 0.0), (45, 0.003)])
def test_no_hand_reaches_the_culled_samples_of_a_solid(frames: int, swing_m: float) -> None:
    medium = floor(frames, swing_m)
    reach = reach_of(medium, HAND)
    shell = without_unreachable(medium, reach.samples)
    assert shell[0].support_count < 0.5 * medium[0].support_count and reach.stopped_n > HAND.push_n
    differ, max_force_n = forces_along(medium, shell, HAND, 3)
    assert differ == 0 and max_force_n > 1.0
    skin = np.linalg.norm(medium[0].to_dense(), axis=-1) < 2.0
    assert (
        forces_along(medium, without_unreachable(medium, skin), HAND, 3, max_different=0)[0] > 0
    )  # these hands do enter


def test_a_hand_stronger_than_the_field_reaches_all() -> None:
    medium = floor()
    assert reach_of(medium, Hand(9.0, 0.1, 0.2)).samples.all()
    assert reach_of(medium, Hand(1.0, 0.1, 5.0)).samples.all()
    shallow = np.where(
        floor()[0].to_dense()[..., 2:] > 6, 0, floor()[0].to_dense()
    )  # a shell that is empty inside
    assert reach_of(tf.HapticMedium.from_array(shallow, GRID), HAND).samples.all()
    flat, full = floor()[0].to_dense()[None, :, :1], np.full((1, *GRID.shape, 3), 4.0)
    for forces in (flat, full):  # a single sample along y, and no free sample to start from
        grid = tf.Grid(forces.shape[1:4], GRID.spacing_m, GRID.origin_m)
        assert reach_of(tf.HapticMedium.from_array(forces, grid), HAND).samples.all()


def test_the_strongest_frame_counts_and_frames_are_processed_in_groups(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    source = floor(3, 0.003)
    deep = np.pad(
        source[1].to_dense()[:, :, 6:], [(0, 0), (0, 0), (0, 6), (0, 0)]
    )  # the floor of one frame is lower
    medium = tf.HapticMedium.from_frames(
        [source[0].scaled(0.9), tf.ForceField.from_dense(GRID, deep), source[2]], 60.0
    )
    at_once = reach_of(medium, HAND)
    assert at_once.stopped_n == pytest.approx(0.4 * 8) and not at_once.samples.all()
    monkeypatch.setattr(reach, "_FRAMES_BYTES", 1)
    np.testing.assert_array_equal(reach_of(medium, HAND).samples, at_once.samples)


def test_a_faster_hand_reaches_farther() -> None:
    medium = floor()
    slow, fast = (int(reach_of(medium, Hand(1.0, 0.1, v)).samples.sum()) for v in (0.05, 0.3))
    assert slow < fast


@pytest.mark.parametrize("hand", [HAND, Hand(0.1, 0.5, 0.3), Hand(2.0, 0.02, 0.1)])
def test_a_layer_stops_a_hand_by_the_documented_rule(hand: Hand) -> None:
    layers = _layers(floor(), hand, 8.0)
    assert layers
    for layer in layers:
        double_energy = hand.mass_kg * hand.speed_m_s**2
        min_need_n = (
            hand.push_n
            + double_energy / layer.start_m
            + double_energy / (2 * (layer.depth_m - layer.start_m))
        )
        assert min_need_n <= layer.need_n <= 2 * min_need_n
        flood = _Flood(floor(), layer, hand)  # with exactly 5 % in reserve
        assert flood.turn_nm == pytest.approx(1.05 * double_energy)
        assert flood.need_n == pytest.approx(1.05 * (min_need_n - double_energy / layer.start_m))
    assert (
        len(_layers(floor(), Hand(0.4 * 8.0 / 1.05, 0.01, 0.01), 8.0)) == 1
    )  # nothing in reserve in the weaker layer


START_NODES = np.array([(i, j, 7) for i in (3, 4) for j in (3, 4)])
"""Nodes above a cell whose corners are nodes 3 and 4 of each axis."""


def is_weak(corners: Any, start: Any, step_m: Any, turn_nm: float, friction: float) -> bool:
    """True if forces at the corners of a cell, [2, 2, 2, 3], do not hold back a hand from a start node."""
    edges, weak = np.zeros((2, 8, 8, 8), bool), np.zeros(1, bool)
    edges[(0, *start)] = True
    cells, frames = np.full((1, 3), 3), corners[None].astype(np.float32)
    weak_cells(0, 1, cells, np.ones(1), edges, 2.0, 3, frames, np.array(step_m), 0.0, turn_nm, friction, weak)
    return bool(weak[0])


def min_resistance_nm(corners: Any, start: Any, step_m: Any, friction: float, points: int) -> float:
    """The minimum of -(x - a) . F - mu |(x - a) x F| over points of a cell, N m, with interpolated forces."""
    fractions = np.linspace(0.0, 1.0, points)
    weights = np.stack([1.0 - fractions, fractions])
    forces = np.einsum(
        "ia,jb,kc,ijkn->abcn", weights, weights, weights, corners.astype(np.float32).astype(float)
    )
    x = np.stack(np.meshgrid(fractions, fractions, fractions, indexing="ij"), axis=-1) * step_m
    away = x - (np.array(start) - 3) * step_m
    across = np.linalg.norm(np.cross(away, forces), axis=-1)
    return float((-(away * forces).sum(axis=-1) - friction * across).min())


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_a_strong_cell_holds_between_its_corners(friction: float) -> None:
    rng, step_m, dips, strong = np.random.default_rng(4), (0.002, 0.003, 0.004), 0, 0
    for n in range(200):
        slopes, index = rng.normal(size=2), np.indices((2, 2, 2)) - 0.5
        corners = np.array([0.0, 0.0, 3.0]) + rng.normal(size=(2, 2, 2, 3)) * [0.2, 0.2, 0.05]
        for axis in range(2):
            corners[..., axis] += 2.0 * slopes[axis] * index[axis]
        start = START_NODES[n % 4]
        at_corners, between = (
            min_resistance_nm(corners, start, step_m, friction, points) for points in (2, 9)
        )
        turn_nm = at_corners - (0.003 if friction else 0.0003) * rng.random()
        dips += between < turn_nm
        if not is_weak(corners, start, step_m, turn_nm, friction):
            strong += 1
            assert between >= turn_nm - 1e-9
    assert strong > 20 and (friction or dips > 40)


@pytest.mark.parametrize("start", START_NODES.tolist(), ids=str)
@pytest.mark.parametrize("axis", range(3))
def test_a_linear_force_is_weakest_at_the_corners(axis: int, start: list[int]) -> None:
    corners, step_m = np.zeros((2, 2, 2, 3)), (0.002, 0.003, 0.004)
    corners[..., 2] = 3.0
    corners[..., axis] += np.indices((2, 2, 2))[axis] - 0.5
    at_corners_nm = min_resistance_nm(corners, start, step_m, 0.0, 2)
    assert min_resistance_nm(corners, start, step_m, 0.0, 9) >= at_corners_nm - 1e-9
    assert not is_weak(corners, start, step_m, at_corners_nm - 1e-6, 0.0)
    assert is_weak(corners, start, step_m, at_corners_nm + 1e-6, 0.0)


# -- the command -------------------------------------------------------------------------------------------


def test_the_command_reports_and_writes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    field, log = tmp_path / "floor.npz", tmp_path / "log.csv"
    medium = floor(4)
    tf.write_field(field, medium)
    log.write_text(
        "t_s,x_m,y_m,z_m\n" + "".join(f"{i / 1000},{0.03 + i * 5e-5},0.06,0.088\n" for i in range(100))
    )
    names = [str(tmp_path / name) for name in ("few.touch", "shell.touch")]
    few, shell = names
    hand = ["--push-n", "1", "--mass-kg", "0.1"]
    arguments = ["reduce", str(field), few, "--cull", shell, "--mode", "lossless", *hand, "--json"]
    assert _exit_code(arguments) == 0
    report = json.loads(capsys.readouterr().out)
    assert all(Path(name).stat().st_size for name in names)
    assert report["nmse_db"] < -29 and report["held_out"]["modes"] >= 1 and report["behind_samples"] > 0
    assert any("begins where no force is" in note for note in report["notes"])
    with tf.open_stream(shell) as stream:
        reachable = reach_of(stream.medium, HAND).samples
        assert stream.medium[3].support_count == np.count_nonzero(
            (medium[3].to_dense() != 0).any(-1) & reach_of(medium, HAND).samples
        )
        assert reachable.any()
    picture = tmp_path / "a.png"
    plot = ["--plot", str(picture)] if find_spec("matplotlib") else []
    again = ["reduce", str(field), "--trace", str(log), "--device", "touch", *hand, *plot, "--json"]
    assert _exit_code(again) == 0
    report = json.loads(capsys.readouterr().out)
    assert picture.exists() == bool(plot)
    assert report["never_visited_samples"] > report["behind_samples"]


def test_a_reduction_is_drawn_with_what_is_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib", reason="pictures need the extra report")
    figures: list = []
    monkeypatch.setattr(reduction_pictures, "write_png", lambda figure, path: figures.append(figure))
    tf.write_field(tmp_path / "floor.npz", floor(4))
    done = reduce_medium(tmp_path / "floor.npz", spec=ReductionSpec(push_n=1.0, mass_kg=0.1))
    done.draw(tmp_path / "a.png")
    curve, slice_panel, _ = figures[0].axes
    decibels = curve.lines[0].get_ydata()
    rank = done.figures["rank"]
    assert decibels[0] == 0 and decibels[rank] == pytest.approx(done.figures["nmse_db_beforehand"], abs=1e-6)
    size_n = np.linalg.norm(done.middle_frame.to_dense(), axis=-1)
    left_out = (size_n > 0) & ~done.is_reachable
    counts = [left_out.sum(axis=tuple(n for n in range(3) if n != axis)).max() for axis in range(3)]
    force, grey = slice_panel.images
    drawn = np.ma.filled(grey.get_array().astype(float), 0)
    assert 0 < drawn.sum() in counts, "the slice with the most samples that are left out"
    assert np.nanmax(np.ma.filled(force.get_array(), np.nan)) <= size_n.max()
    assert "grey: left out" in slice_panel.get_title()
    replace(done, is_reachable=np.ones_like(done.is_reachable)).draw(tmp_path / "a.png")
    assert "nothing is left out" in figures[1].axes[1].get_title()


def test_bad_input_is_a_one_line_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    field = tmp_path / "floor.npz"
    tf.write_field(field, floor(2))
    for wrong in (
        ["--modes", "x"],
        ["--rank", "0"],
        ["--push-n", "nan"],
        ["--nmse-db", "3"],
        ["--cull", str(field)],
    ):
        assert _exit_code(["reduce", str(field), *wrong]) == 2
        assert len(capsys.readouterr().err.strip().splitlines()) == 1
    empty = tmp_path / "empty.npz"
    tf.write_field(empty, tf.HapticMedium.from_array(np.zeros((2, *GRID.shape, 3)), GRID))
    assert _exit_code(["reduce", str(empty)]) == 2
    assert "no frame with a force" in capsys.readouterr().err
    assert reduce_medium(field, spec=ReductionSpec(rank=1)).figures["rank"] == 1


def test_text_of_a_hand_states_its_parameters() -> None:
    hand = Hand(push_n=2.5, mass_kg=0.125, speed_m_s=0.3)
    assert hand.text == "a hand of 125 g with its device that pushes with 2.5 N and moves at 0.3 m/s at most"
    assert hand.lunge_nm == pytest.approx(0.125 * 0.3**2)
    for name in ("push_n", "mass_kg", "speed_m_s"):
        with pytest.raises(InvalidArgument, match=f"{name}: found 0"):
            replace(hand, **{name: 0.0})
