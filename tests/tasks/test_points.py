"""Sparse points: Q-DEIM within its bound, variance by an exhaustive search, a rebuilt field, bad input."""

from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

import touchfield as tf
from touchfield.cli.main import _exit_code
from touchfield.errors import InvalidArgument
from touchfield.medium.trace import read_contacts
from touchfield.reduction.kernel_points import Kernel, best_kernels, error_points, variance_points
from touchfield.reduction.modes import ModePoints, Modes, mode_points, pod
from touchfield.sources.recordings.contact_trace import CurlFree, covariances
from touchfield.sources.registry import open_source
from touchfield.tasks.reduction import fewest_points, next_points
from touchfield.viewer import reduction as reduction_pictures

RNG = np.random.default_rng
KERNEL = Kernel(0.2, 1e-3)


def few_modes(rank: int, noise: float = 0.0, seed: int = 1) -> np.ndarray:
    """Snapshots [40, 300] of modes of decreasing size, with noise."""
    rng = RNG(seed)
    shapes = np.linalg.qr(rng.normal(size=(300, rank)))[0].T
    return rng.normal(size=(40, rank)) * 0.7 ** np.arange(rank) @ shapes + noise * rng.normal(size=(40, 300))


# -- points on modes ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("rank", "count"), [(5, 2), (6, 2), (7, 7), (6, 20), (1, 1)])
def test_snapshots_within_the_modes_are_rebuilt_exactly(rank: int, count: int) -> None:
    rows = few_modes(rank)
    selection = mode_points(pod(rows, rank), count)
    assert len(set(selection.points.tolist())) == count
    back = selection.modes.rebuild(selection.coefficients(rows[:, selection.rows].reshape(40, count, 3)))
    assert np.abs(back - rows).max() < 1e-9


@pytest.mark.parametrize("count", [4, 8, 30])
def test_the_error_is_within_the_bound_in_every_frame(count: int) -> None:
    training, test = few_modes(12, 0.01), few_modes(12, 0.05)
    modes = pod(training, 8)
    selection = mode_points(modes, count)
    floor = np.linalg.norm(test - modes.rebuild(modes.coefficients(test)), axis=1)
    error = np.linalg.norm(test - modes.rebuild(selection.coefficients(test[:, selection.rows])), axis=1)
    assert (
        selection.bound >= 1
        and (error <= selection.bound * floor * (1 + 1e-9)).all()
        and (error >= floor).all()
    )


def test_more_and_optimised_points_have_a_smaller_bound() -> None:
    modes = pod(few_modes(12, 0.01), 10)
    bounds = [mode_points(modes, count).bound for count in (4, 8, 16, 32)]
    assert all(a > b for a, b in zip(bounds, bounds[1:]))
    drawn = [ModePoints(modes, RNG(s).choice(100, 16, replace=False)).bound for s in range(20)]
    assert bounds[2] < min(drawn)
    assert mode_points(modes, 100).bound == pytest.approx(1.0)


def test_points_are_weighted_by_the_residual_of_the_modes() -> None:
    rows = few_modes(12, 0.01)
    modes, missed = pod(rows, 6), RNG(7).uniform(0.1, 4, 100)
    selection = mode_points(modes, 20, missed)
    weights = np.repeat(1 / np.sqrt(missed / missed.mean() + 0.1), 3)[selection.rows]
    expected = np.linalg.lstsq(
        weights[:, None] * modes.basis[selection.rows], weights * rows[0, selection.rows], rcond=None
    )[0]
    np.testing.assert_allclose(selection.coefficients(rows[:1, selection.rows])[0], expected, atol=1e-9)


def test_a_point_with_weak_rows_is_not_selected_twice() -> None:
    basis = np.zeros((393, 2))
    basis[[0, 1], [0, 1]] = 1.0, 0.09
    basis[3:, 1] = np.sqrt((1 - 0.09**2) / 390)
    assert len(set(mode_points(Modes(basis, np.ones(2), 2), 2).points.tolist())) == 2


def test_invalid_points_are_refused() -> None:
    modes = pod(few_modes(7), 7)
    for count in (0, 2, 101):
        with pytest.raises(InvalidArgument, match="3 to 100"):
            mode_points(modes, count)
    with pytest.raises(InvalidArgument, match="1 to 6"):
        variance_points(RNG(2).uniform(size=(10, 3)), 7, KERNEL, 4)
    with pytest.raises(InvalidArgument, match="three for each point"):
        mode_points(pod(few_modes(4)[:, :299], 4), 5)


# -- points with a kernel without curl ---------------------------------------------------------------------


def variances_after(points: np.ndarray, measured: list[int]) -> np.ndarray:
    """Posterior variance of each point, by its definition."""
    every, rows = covariances(points / KERNEL.length_m), 3 * np.array(measured, int)[:, None] + np.arange(3)
    gram = every[np.ix_(rows.reshape(-1), rows.reshape(-1))] + KERNEL.noise * np.eye(rows.size)
    known = every[rows.reshape(-1)]
    return np.diag(every - known.T @ np.linalg.solve(gram, known)).reshape(-1, 3).sum(axis=1)


@pytest.mark.parametrize("measured", [0, 4, 40])
def test_points_by_variance_equal_an_exhaustive_search(measured: int) -> None:
    points = RNG(2).uniform(size=(60, 3))
    selected, variances = variance_points(points, 15, KERNEL, measured)
    assert len(set(selected.tolist())) == 15 and selected.min() >= measured
    known = list(range(measured))
    for point, variance in zip(selected.tolist(), variances, strict=True):
        assert variance == pytest.approx(variances_after(points, known)[point], abs=1e-9)
        left = {n: variances_after(points, [*known, n]).mean() for n in range(60) if n not in known}
        assert left[point] == pytest.approx(min(left.values()), abs=1e-9)
        known.append(point)


def test_points_by_variance_leave_less_error_than_as_many_at_random_and_at_the_rim() -> None:
    points = RNG(8).uniform(size=(900, 3))
    forces = gradient(points)

    def missed(selected: np.ndarray) -> float:
        field = CurlFree.through(points[selected], forces[selected], 0.4, 1e-3)
        return float(((field.forces_n(points) - forces) ** 2).sum())

    ours = missed(variance_points(points, 30, Kernel(0.4, 1e-3))[0])
    drawn = [missed(RNG(s).choice(900, 30, replace=False)) for s in range(15)]
    rim = np.argsort(np.abs(points - 0.5).max(axis=1))[-30:]
    assert ours < np.median(drawn) and ours < missed(rim)


def gradient(points: np.ndarray) -> np.ndarray:
    """Gradient of sin(9 x) cos(7 y) z."""
    x, y, z = (points * [9.0, 7.0, 1.0]).T
    return np.stack(
        [9 * np.cos(x) * np.cos(y) * z, -7 * np.sin(x) * np.sin(y) * z, np.sin(x) * np.cos(y)], axis=1
    )


def test_a_rebuilt_field_interpolates_its_points() -> None:
    points = RNG(3).uniform(size=(400, 3))
    forces = gradient(points)
    selected = error_points(points, forces, 40, Kernel(0.3, 1e-10))
    field = CurlFree.through(points[selected], forces[selected], 0.3, 1e-10)
    assert np.abs(field.forces_n(points[selected]) - forces[selected]).max() < 1e-5


def test_points_by_error_equal_an_exhaustive_search() -> None:
    points = RNG(6).uniform(size=(24, 3))
    forces, kernel = gradient(points), Kernel(0.3, 0.05)
    selected: list[int] = []
    for _ in range(12):
        missed = {}
        for candidate in set(range(24)) - set(selected):
            some = [*selected, candidate]
            back = CurlFree.through(points[some], forces[some], kernel.length_m, kernel.noise).forces_n(
                points
            )
            missed[candidate] = float(((back - forces) ** 2).sum())
        selected.append(min(missed, key=missed.__getitem__))
    assert error_points(points, forces, 12, kernel).tolist() == selected


def test_no_point_is_selected_twice_even_with_noisy_measurements() -> None:
    points = RNG(5).uniform(size=(60, 3))
    assert len(set(error_points(points, gradient(points), 40, Kernel(0.3, 3.0)).tolist())) == 40


def test_points_by_error_miss_less_than_twice_as_many_at_random() -> None:
    points = RNG(4).uniform(size=(900, 3))
    forces = gradient(points) * np.exp(-30 * ((points - 0.5) ** 2).sum(axis=1))[:, None]  # in a single corner

    def missed(selected: np.ndarray, kernel: Kernel) -> float:
        field = CurlFree.through(points[selected], forces[selected], kernel.length_m, kernel.noise)
        return float(((field.forces_n(points) - forces) ** 2).sum())

    kernel = best_kernels(points, forces, 20)[0]
    ours = missed(error_points(points, forces, 20, kernel), kernel)
    drawn = [missed(RNG(s).choice(900, 40, replace=False), kernel) for s in range(9)]
    assert ours < np.median(drawn)


# -- media, recordings, the command ------------------------------------------------------------------------


@pytest.fixture(scope="module")
def moving(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ball that moves to and fro, 24 frames."""
    grid = tf.Grid.over_box((-0.04,) * 3, (0.04,) * 3, (12, 12, 12))
    at, frames = grid.to_m(np.moveaxis(np.indices(grid.shape), 0, -1)), []
    for phase in np.linspace(0, 2 * np.pi, 24, endpoint=False):
        offsets_m = at - [0.015 * np.sin(phase), 0.01 * np.cos(phase), 0.0]
        frames.append(
            100 * offsets_m * np.maximum(0.02**2 - (offsets_m**2).sum(axis=-1, keepdims=True), 0) / 0.02**2
        )
    path = tmp_path_factory.mktemp("moving") / "ball.npz"
    tf.pipeline.write_field(path, tf.HapticMedium.from_array(np.array(frames), grid, 60.0))
    return path


@pytest.fixture(scope="module")
def contacts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of 200 contacts with a field of 50 mm in one half of a box."""
    points = RNG(5).uniform(size=(200, 3)) * [0.5, 1, 1]
    path = tmp_path_factory.mktemp("felt") / "felt.csv"
    rows = np.hstack([0.05 * points, gradient(points)])
    np.savetxt(path, rows, delimiter=",", header="x_m,y_m,z_m,fx_n,fy_n,fz_n", comments="")
    return path


def test_a_moving_medium_is_rebuilt_from_its_points(moving: Path, tmp_path: Path) -> None:
    done = fewest_points(moving, 8, tmp_path / "back.npz")
    summary = done.summary()
    assert summary["criterion"] == "modes" and summary["modes"] == 8 and summary["bound"] >= 1
    assert summary["nmse_db"] < summary["floor_db"] + 3  # it may be below, as forces below F_0 are dropped
    original, back = (open_source(path).stored for path in (moving, tmp_path / "back.npz"))
    error = sum(
        float(((b.to_dense() - a.to_dense()) ** 2).sum()) for a, b in zip(original, back, strict=True)
    )
    energy = sum(float((a.to_dense() ** 2).sum()) for a in original)
    assert 10 * np.log10(error / energy) == pytest.approx(summary["nmse_db"], abs=0.01)
    assert fewest_points(moving, 24).summary()["nmse_db"] < -30  # all its modes, except for forces below F_0


def test_a_static_medium_and_a_recording(moving: Path, contacts: Path, tmp_path: Path) -> None:
    static = tmp_path / "still.npz"
    tf.pipeline.write_field(static, open_source(moving).stored[:1])
    few, many = (fewest_points(static, count).summary() for count in (6, 24))
    assert few["criterion"] == "error" and many["nmse_db"] < few["nmse_db"] < 0
    done = fewest_points(contacts, 20, tmp_path / "kept.csv")
    selected, every = read_contacts(tmp_path / "kept.csv"), read_contacts(contacts)
    assert len(selected.forces_n) == 20 and done.summary()["nmse_db"] < -6
    rows = {tuple(row) for row in np.hstack([every.positions_m, every.forces_n]).round(6).tolist()}
    assert all(
        tuple(row) in rows for row in np.hstack([selected.positions_m, selected.forces_n]).round(6).tolist()
    )


def test_the_next_point_is_in_the_least_measured_region(contacts: Path, moving: Path, tmp_path: Path) -> None:
    points = np.stack(np.meshgrid(*[np.linspace(0, 1, 7)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    points = np.array([[1, 1, 1], *points[points[:, 0] < 0.4].tolist()])  # a single point at the far side
    half = tmp_path / "half.csv"
    rows = np.hstack([0.05 * points, gradient(points / 2)])
    np.savetxt(half, rows, delimiter=",", header="x_m,y_m,z_m,fx_n,fy_n,fz_n", comments="")
    summary = next_points(half, 4).summary()
    assert min(row["x_m"] for row in summary["next"]) > 0.025
    largest_n = summary["deviation_nowhere_measured_n"] * (1 + 1e-9)
    assert all(0.1 * largest_n < row["deviation_n"] <= largest_n for row in summary["next"])
    again = next_points(moving, 3, contacts).summary()
    low, high = open_source(moving).stored.grid.box_m
    positions_m = np.array([[row["x_m"], row["y_m"], row["z_m"]] for row in again["next"]])
    assert (positions_m > low).all() and (positions_m < high).all()


def test_points_are_drawn_with_the_field_and_the_rebuilt_field(
    contacts: Path, moving: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("matplotlib", reason="pictures need the extra report")
    figures: list = []
    monkeypatch.setattr(reduction_pictures, "write_png", lambda figure, path: figures.append(figure))
    rebuilt = tmp_path / "rebuilt.npz"
    done = fewest_points(moving, 6, rebuilt)
    done.draw(tmp_path / "a.png")
    field, back, error = (axis for axis in figures[0].axes if axis.get_label() != "<colorbar>")
    medium = open_source(moving).stored
    middle = medium[len(medium) // 2]
    size_n = np.linalg.norm(middle.sample_n(done.positions_m), axis=1)
    stored = open_source(rebuilt).stored[len(medium) // 2]
    rebuilt_n = stored.sample_n(done.positions_m)
    difference = np.linalg.norm(rebuilt_n - middle.sample_n(done.positions_m), axis=1)
    spans = np.ptp(done.positions_m, axis=0)
    across, up = sorted(np.argsort(spans, kind="stable")[1:])
    for panel, values, within in (
        (field, size_n, 1e-5),
        (back, np.linalg.norm(rebuilt_n, axis=1), 0.051),
        (error, difference / np.maximum(0.05, 0.1 * size_n), 1.02),
    ):  # what is below F_0 is not stored
        dots, rings = panel.collections
        np.testing.assert_allclose(
            np.sort(np.asarray(dots.get_array())), np.sort(values), rtol=0, atol=within
        )
        assert (np.diff(dots.get_array()) >= 0).all(), "the largest on top"
        np.testing.assert_allclose(rings.get_offsets(), 1e3 * done.points_m[:, [across, up]])
        assert panel.get_xlabel() == f"{'xyz'[across]} / mm" and panel.get_ylabel() == f"{'xyz'[up]} / mm"
    next_points(contacts, 3).draw(tmp_path / "a.png")
    views = [axis for axis in figures[1].axes if axis.get_label() != "<colorbar>"]
    assert len(views) == 2 and "the next 3 points, after 200 samples" in figures[1].get_suptitle()
    assert {axis.get_title() for axis in views} < {f"seen along {name}" for name in "xyz"}
    assert sorted(views[0].texts[0].get_text().split(", "))[0] == "1"


def test_the_command(
    contacts: Path, moving: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    picture = tmp_path / "a.png"
    plot = ["--plot", str(picture)] if find_spec("matplotlib") else []
    assert _exit_code(["points", "6", str(moving), str(tmp_path / "a.touch"), *plot, "--json"]) == 0
    assert picture.exists() == bool(plot)
    picture.unlink(missing_ok=True)
    summary = json.loads(capsys.readouterr().out)
    assert summary["points"] == 6 and summary["file_bytes"] > 0
    assert _exit_code(["points", "3", str(contacts), "--next"]) == 0
    assert "deviation_n" in capsys.readouterr().out
    wrong = {
        "1 to 1000": ["0", str(contacts)],
        "at most 200": ["201", str(contacts)],
        "OUT.csv": ["5", str(contacts), str(tmp_path / "b.touch")],
        "--measured": ["5", str(moving), "--next"],
        "a recording": ["5", str(contacts), "--modes", "2"],
        "1 to 15": ["5", str(moving), "--modes", "16"],
        "--next": ["5", str(contacts), "--measured", str(contacts)],
        "nothing is rebuilt": ["5", str(contacts), str(tmp_path / "b.csv"), "--next"],
        "to 1000": ["1001", str(contacts), "--next"],
    }
    for message, arguments in wrong.items():
        assert _exit_code(["points", *arguments]) == 2, arguments
        stderr = capsys.readouterr().err.strip()
        assert message in stderr and "\n" not in stderr, stderr
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.touch"]


def test_a_medium_without_force_is_refused(tmp_path: Path) -> None:
    grid = tf.Grid((8, 8, 8), (0.01,) * 3, (0.0,) * 3)
    tf.pipeline.write_field(
        tmp_path / "empty.npz", tf.HapticMedium.from_array(np.zeros((3, 8, 8, 8, 3)), grid)
    )
    with pytest.raises(InvalidArgument, match="no force"):
        fewest_points(tmp_path / "empty.npz", 3)
