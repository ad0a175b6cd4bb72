"""The fewest points: Q-DEIM within its bound, greedy variance as it is by definition, a field rebuilt, bad
input.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import touchfield as tf
from touchfield.cli.main import _exit_code
from touchfield.errors import InvalidArgument
from touchfield.medium.trace import read_contacts
from touchfield.reduction.kernel_points import Kernel, best_kernel, error_points, variance_points
from touchfield.reduction.modes import ModePoints, Modes, mode_points, pod
from touchfield.sources.recordings.contact_trace import CurlFree, covariances
from touchfield.sources.registry import open_source
from touchfield.tasks.reduction import fewest_points, next_points

RNG = np.random.default_rng
KERNEL = Kernel(0.2, 1e-3)


def few_modes(rank: int, noise: float = 0.0, seed: int = 1) -> np.ndarray:
    """Snapshots [40, 300] of so many modes, of falling size, and noise."""
    rng = RNG(seed)
    shapes = np.linalg.qr(rng.normal(size=(300, rank)))[0].T
    return rng.normal(size=(40, rank)) * 0.7 ** np.arange(rank) @ shapes + noise * rng.normal(size=(40, 300))


# -- points on modes ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("rank", "count"), [(5, 2), (6, 2), (7, 7), (6, 20), (1, 1)])
def test_what_lies_in_the_modes_is_rebuilt_exactly(rank: int, count: int) -> None:
    rows = few_modes(rank)
    chosen = mode_points(pod(rows, rank), count)
    assert len(set(chosen.points.tolist())) == count
    back = chosen.modes.rebuild(chosen.coefficients(rows[:, chosen.rows].reshape(40, count, 3)))
    assert np.abs(back - rows).max() < 1e-9


@pytest.mark.parametrize("count", [4, 8, 30])
def test_the_error_is_within_the_bound_in_every_frame(count: int) -> None:
    learnt, seen = few_modes(12, 0.01), few_modes(12, 0.05)
    modes = pod(learnt, 8)
    chosen = mode_points(modes, count)
    floor = np.linalg.norm(seen - modes.rebuild(modes.coefficients(seen)), axis=1)
    error = np.linalg.norm(seen - modes.rebuild(chosen.coefficients(seen[:, chosen.rows])), axis=1)
    assert chosen.bound >= 1 and (error <= chosen.bound * floor * (1 + 1e-9)).all() and (error >= floor).all()


def test_more_points_and_chosen_ones_have_a_smaller_bound() -> None:
    modes = pod(few_modes(12, 0.01), 10)
    bounds = [mode_points(modes, count).bound for count in (4, 8, 16, 32)]
    assert all(a > b for a, b in zip(bounds, bounds[1:]))
    drawn = [ModePoints(modes, RNG(s).choice(100, 16, replace=False)).bound for s in range(20)]
    assert bounds[2] < min(drawn)
    assert mode_points(modes, 100).bound == pytest.approx(1.0)


def test_a_point_counts_the_less_the_more_its_modes_miss() -> None:
    rows = few_modes(12, 0.01)
    modes, missed = pod(rows, 6), RNG(7).uniform(0.1, 4, 100)
    chosen = mode_points(modes, 20, missed)
    own = np.repeat(1 / np.sqrt(missed / missed.mean() + 0.1), 3)[chosen.rows]
    expected = np.linalg.lstsq(
        own[:, None] * modes.basis[chosen.rows], own * rows[0, chosen.rows], rcond=None
    )[0]
    np.testing.assert_allclose(chosen.coefficients(rows[:1, chosen.rows])[0], expected, atol=1e-9)


def test_a_point_whose_other_rows_are_weak_is_not_chosen_again() -> None:
    basis = np.zeros((393, 2))
    basis[[0, 1], [0, 1]] = 1.0, 0.09
    basis[3:, 1] = np.sqrt((1 - 0.09**2) / 390)
    assert len(set(mode_points(Modes(basis, np.ones(2), 2), 2).points.tolist())) == 2


def test_points_that_cannot_be_are_refused() -> None:
    modes = pod(few_modes(7), 7)
    for count in (0, 2, 101):
        with pytest.raises(InvalidArgument, match="3 to 100"):
            mode_points(modes, count)
    with pytest.raises(InvalidArgument, match="1 to 6"):
        variance_points(RNG(2).uniform(size=(10, 3)), 7, KERNEL, 4)
    with pytest.raises(InvalidArgument, match="three for each point"):
        mode_points(pod(few_modes(4)[:, :299], 4), 5)


# -- points with a kernel without curl ---------------------------------------------------------------------


@pytest.mark.parametrize("measured", [0, 4, 40])
def test_greedy_variance_is_that_of_the_definition_and_never_grows(measured: int) -> None:
    points = RNG(2).uniform(size=(60, 3))
    chosen, variances = variance_points(points, 15, KERNEL, measured)
    assert (
        len(set(chosen.tolist())) == 15 and chosen.min() >= measured and (np.diff(variances) <= 1e-12).all()
    )
    every = covariances(points / KERNEL.length_m)
    for n in range(15):
        known = [*range(measured), *chosen[:n].tolist()]
        own = (3 * np.array(known, int)[:, None] + np.arange(3)).reshape(-1)
        gram = every[np.ix_(own, own)] + KERNEL.noise * np.eye(len(own))
        after = np.diag(every - every[:, own] @ np.linalg.solve(gram, every[own])).reshape(-1, 3).sum(axis=1)
        assert variances[n] == pytest.approx(after[chosen[n]], abs=1e-9)
        others = np.setdiff1d(np.arange(measured, 60), known)
        assert variances[n] == pytest.approx(after[others].max(), abs=1e-9)


def gradient(points: np.ndarray) -> np.ndarray:
    """Of sin(9 x) cos(7 y) z."""
    x, y, z = (points * [9.0, 7.0, 1.0]).T
    return np.stack(
        [9 * np.cos(x) * np.cos(y) * z, -7 * np.sin(x) * np.sin(y) * z, np.sin(x) * np.cos(y)], axis=1
    )


def test_a_field_goes_through_the_points_it_is_rebuilt_from() -> None:
    points = RNG(3).uniform(size=(400, 3))
    forces = gradient(points)
    chosen = error_points(points, forces, 40, Kernel(0.3, 1e-10))
    field = CurlFree.through(points[chosen], forces[chosen], 0.3, 1e-10)
    assert np.abs(field.forces_n(points[chosen]) - forces[chosen]).max() < 1e-5


def test_points_by_error_are_those_of_every_try() -> None:
    points = RNG(6).uniform(size=(24, 3))
    forces, kernel = gradient(points), Kernel(0.3, 0.05)
    chosen: list[int] = []
    for _ in range(12):
        missed = {}
        for one in set(range(24)) - set(chosen):
            some = [*chosen, one]
            back = CurlFree.through(points[some], forces[some], kernel.length_m, kernel.noise).forces_n(
                points
            )
            missed[one] = float(((back - forces) ** 2).sum())
        chosen.append(min(missed, key=missed.__getitem__))
    assert error_points(points, forces, 12, kernel).tolist() == chosen


def test_no_point_is_chosen_twice_however_little_a_measurement_tells() -> None:
    points = RNG(5).uniform(size=(60, 3))
    assert len(set(error_points(points, gradient(points), 40, Kernel(0.3, 3.0)).tolist())) == 40


def test_points_by_error_miss_less_than_twice_as_many_at_random() -> None:
    points = RNG(4).uniform(size=(900, 3))
    forces = (
        gradient(points) * np.exp(-30 * ((points - 0.5) ** 2).sum(axis=1))[:, None]
    )  # in one corner of all

    def missed(chosen: np.ndarray, kernel: Kernel) -> float:
        field = CurlFree.through(points[chosen], forces[chosen], kernel.length_m, kernel.noise)
        return float(((field.forces_n(points) - forces) ** 2).sum())

    kernel = best_kernel(points, forces, 20)
    ours = missed(error_points(points, forces, 20, kernel), kernel)
    drawn = [missed(RNG(s).choice(900, 40, replace=False), kernel) for s in range(9)]
    assert ours < np.median(drawn)


# -- media, recordings, the command ------------------------------------------------------------------------


@pytest.fixture(scope="module")
def moving(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ball that goes to and fro, 24 frames."""
    grid = tf.Grid.over_box((-0.04,) * 3, (0.04,) * 3, (12, 12, 12))
    at, frames = grid.to_m(np.moveaxis(np.indices(grid.shape), 0, -1)), []
    for phase in np.linspace(0, 2 * np.pi, 24, endpoint=False):
        apart = at - [0.015 * np.sin(phase), 0.01 * np.cos(phase), 0.0]
        frames.append(100 * apart * np.maximum(0.02**2 - (apart**2).sum(axis=-1, keepdims=True), 0) / 0.02**2)
    path = tmp_path_factory.mktemp("moving") / "ball.npz"
    tf.pipeline.write_field(path, tf.HapticMedium.from_array(np.array(frames), grid, 60.0))
    return path


@pytest.fixture(scope="module")
def felt(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of 200 contacts with a field of 50 mm in one half of a box."""
    points = RNG(5).uniform(size=(200, 3)) * [0.5, 1, 1]
    path = tmp_path_factory.mktemp("felt") / "felt.csv"
    rows = np.hstack([0.05 * points, gradient(points)])
    np.savetxt(path, rows, delimiter=",", header="x_m,y_m,z_m,fx_n,fy_n,fz_n", comments="")
    return path


def test_a_moving_medium_is_rebuilt_from_its_points(moving: Path, tmp_path: Path) -> None:
    done = fewest_points(moving, 8, tmp_path / "back.npz")
    told = done.summary()
    assert told["criterion"] == "modes" and told["modes"] == 8 and told["bound"] >= 1
    assert told["nmse_db"] < told["floor_db"] + 3  # it may lie below, as what no hand feels is left out
    original, back = (open_source(path).stored for path in (moving, tmp_path / "back.npz"))
    error = sum(
        float(((b.to_dense() - a.to_dense()) ** 2).sum()) for a, b in zip(original, back, strict=True)
    )
    whole = sum(float((a.to_dense() ** 2).sum()) for a in original)
    assert 10 * np.log10(error / whole) == pytest.approx(told["nmse_db"], abs=0.01)
    assert fewest_points(moving, 24).summary()["nmse_db"] < -30  # all its modes, but for what no hand feels


def test_a_medium_that_stands_still_and_a_recording(moving: Path, felt: Path, tmp_path: Path) -> None:
    still = tmp_path / "still.npz"
    tf.pipeline.write_field(still, open_source(moving).stored[:1])
    few, many = (fewest_points(still, count).summary() for count in (6, 24))
    assert few["criterion"] == "error" and many["nmse_db"] < few["nmse_db"] < 0
    done = fewest_points(felt, 20, tmp_path / "kept.csv")
    kept, every = read_contacts(tmp_path / "kept.csv"), read_contacts(felt)
    assert len(kept.forces_n) == 20 and done.summary()["nmse_db"] < -6
    rows = {tuple(row) for row in np.hstack([every.positions_m, every.forces_n]).round(6).tolist()}
    assert all(tuple(row) in rows for row in np.hstack([kept.positions_m, kept.forces_n]).round(6).tolist())


def test_next_is_where_least_was_measured(felt: Path, moving: Path, tmp_path: Path) -> None:
    points = np.stack(np.meshgrid(*[np.linspace(0, 1, 7)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    points = np.array([[1, 1, 1], *points[points[:, 0] < 0.4].tolist()])  # one alone at the far side
    half = tmp_path / "half.csv"
    rows = np.hstack([0.05 * points, gradient(points / 2)])
    np.savetxt(half, rows, delimiter=",", header="x_m,y_m,z_m,fx_n,fy_n,fz_n", comments="")
    told = next_points(half, 4).summary()
    assert min(row["x_m"] for row in told["next"]) > 0.025
    spread = [row["deviation_n"] for row in told["next"]]
    assert spread == sorted(spread, reverse=True) and spread[0] <= told["deviation_nowhere_measured_n"] * (
        1 + 1e-9
    )
    again = next_points(moving, 3, felt).summary()
    low, high = open_source(moving).stored.grid.box_m
    places = np.array([[row["x_m"], row["y_m"], row["z_m"]] for row in again["next"]])
    assert (places > low).all() and (places < high).all()


def test_the_command(felt: Path, moving: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert _exit_code(["points", "6", str(moving), str(tmp_path / "a.touch"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["points"] == 6 and told["file_bytes"] > 0
    assert _exit_code(["points", "3", str(felt), "--next"]) == 0
    assert "deviation_n" in capsys.readouterr().out
    wrong = {
        "1 to 1000": ["0", str(felt)],
        "at most 200": ["201", str(felt)],
        "OUT.csv": ["5", str(felt), str(tmp_path / "b.touch")],
        "--measured": ["5", str(moving), "--next"],
        "a recording": ["5", str(felt), "--modes", "2"],
        "1 to 15": ["5", str(moving), "--modes", "16"],
        "--next": ["5", str(felt), "--measured", str(felt)],
        "nothing is rebuilt": ["5", str(felt), str(tmp_path / "b.csv"), "--next"],
        "to 1000": ["1001", str(felt), "--next"],
    }
    for words, given in wrong.items():
        assert _exit_code(["points", *given]) == 2, given
        said = capsys.readouterr().err.strip()
        assert words in said and "\n" not in said, said
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.touch"]


def test_no_force_is_told(tmp_path: Path) -> None:
    grid = tf.Grid((8, 8, 8), (0.01,) * 3, (0.0,) * 3)
    tf.pipeline.write_field(
        tmp_path / "empty.npz", tf.HapticMedium.from_array(np.zeros((3, 8, 8, 8, 3)), grid)
    )
    with pytest.raises(InvalidArgument, match="no force"):
        fewest_points(tmp_path / "empty.npz", 3)
