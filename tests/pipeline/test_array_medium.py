"""A stream on an array of actuators: its drives, and their positions on the panel."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from touchfield import pipeline
from touchfield.devices import Device, device
from touchfield.errors import InvalidArgument
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.medium.medium import VibrationFrame
from touchfield.pipeline.array_medium import array_drives, is_top_first
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.scene import CAMERA_AXES, UP_Y_AXES, UP_Z_AXES
from touchfield.sources.stored import StoredScene
from touchfield.sources.tiny_scenes import tiny_scenes
from touchfield.tasks.play import PlaySpec, play

VEST = device("tactsuit-x40")


def stream(medium: HapticMedium, device_type: int = 2, force_max_n: float = 2.0) -> Any:
    """The part of an open stream that `array_medium` uses."""
    head = SimpleNamespace(device_type=device_type, force_max_n=force_max_n)
    return SimpleNamespace(medium=medium, reader=SimpleNamespace(head=head))


def on_lattice(
    profile: Device, forces_n: dict[tuple[int, int], float], axes: str = UP_Y_AXES
) -> HapticMedium:
    """One frame on the lattice of an array: samples (column, j) and their forces along z."""
    x, y, z = profile.workspace_m
    grid = Grid.over_box((-x / 2, -y / 2, -z / 2), (x / 2, y / 2, z / 2), profile.lattice)
    vectors = np.array([[0.0, 0.0, f] for f in forces_n.values()]).reshape(-1, 3)
    field = ForceField.from_support(grid, [[i, j, 0] for i, j in forces_n], vectors)
    return HapticMedium.from_frames([field], 20.0, axes)


def with_band(medium: HapticMedium, values: dict[tuple[int, int, int], tuple[float, float]]) -> HapticMedium:
    """The medium with a band: sample -> (amplitude, frequency)."""
    keys = sorted(values)
    positions = np.array(keys, np.int32).reshape(-1, 3)
    amplitudes, frequencies = (np.array([values[k][n] for k in keys], np.float32) for n in (0, 1))
    frame = VibrationFrame(medium.grid, positions, amplitudes, frequencies)
    return replace(medium, vibration=lambda i: frame)


def test_row_0_is_the_top_whichever_way_y_points() -> None:
    assert [is_top_first(a) for a in (CAMERA_AXES, UP_Y_AXES, UP_Z_AXES, "x, y, z", "", "Down")] == [
        True
    ] + 5 * [False]
    for axes, row in ((UP_Y_AXES, 4), (UP_Z_AXES, 4), (CAMERA_AXES, 0)):
        drives = array_drives(stream(on_lattice(VEST, {(1, 0): 1.0}, axes)), VEST).drives(0)
        assert drives.shape == (2, 5, 4) and drives.dtype == np.float32
        assert np.argwhere(drives).tolist() == [[0, row, 1]] and drives.max() == 0.5


def test_a_stream_of_the_same_array_goes_through_as_it_is() -> None:
    medium = on_lattice(VEST, {(0, 0): 1.0, (3, 4): -5.0})
    frames = array_drives(stream(medium), VEST, "back")
    assert frames.medium is medium and frames.force_max_n == 2.0
    assert (frames.rate_hz, len(frames), frames.device) == (20.0, 1, VEST)
    drives = frames.drives(0)
    assert (
        drives[0].max() == 0.0 and drives[1, 4, 0] == 0.5 and drives[1, 0, 3] == 1.0
    )  # the sign does not matter
    assert frames.frequencies(0) is None


class FakePlayer:
    """A finished player of an array, in which a twentieth of the frames were late."""

    error, notes = None, ("as it was shown",)

    def __init__(self, drives: Any, selected: Any, **times: float) -> None:
        self.profile_name, self.times = selected.profile.name, times
        PLAYERS.append(self)

    def __enter__(self) -> FakePlayer:
        return self

    def __exit__(self, *error: object) -> None:
        pass

    def wait_started(self, seconds: float) -> bool:
        return True

    def wait(self, seconds: float) -> bool:
        return True

    def statistics(self) -> dict[str, Any]:
        return {"sent": 100, "stalled": 5}


PLAYERS: list[FakePlayer] = []


def test_an_array_is_played_with_the_requested_options(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("touchfield.tasks.play.ArrayPlayer", FakePlayer)
    path, notes = tmp_path / "vest.touch", list[str]()
    pipeline.encode(on_lattice(VEST, {(1, 0): 1.0}), path, EncodeSpec(device=VEST.name))
    times = {"loop": True, "speed": 2.0, "start_s": 0.5}
    for profile in (None, "tshirt-32x32"):
        spec = PlaySpec("osc:127.0.0.1:9", profile=profile, **times)  # type: ignore[arg-type]
        played = play(path, spec, on_note=notes.append)
        assert played.statistics["stalled_share"] == 0.05 and played.is_starved
        assert PLAYERS[-1].times == times | {"wait_s": 30.0, "on_note": notes.append, "is_blended": True}
        assert played.notes == FakePlayer.notes
        assert PLAYERS[-1].profile_name == played.statistics["profile"] == (profile or VEST.name)
        assert [f"made for {VEST.name}, and is shown on {profile}" in note for note in notes] == [
            True
        ] * bool(profile)
    for wrong in ({"offline": True}, {"trace": path}, {"trajectory": path}, {"is_logged": True}):
        with pytest.raises(InvalidArgument, match="with a point device"):
            play(path, PlaySpec("osc:127.0.0.1:9", **wrong))  # type: ignore[arg-type]


@pytest.mark.parametrize("pool", ["max", "mean"])
def test_pooling_along_the_depth_equals_pooling_of_single_points(pool: str) -> None:
    from touchfield.filters.kernels.forces import pool_depth

    random = np.random.default_rng(3)
    forces = random.normal(size=(19, 12, 21, 3)) * (random.random((19, 12, 21, 1)) < 0.1)
    forces[8:16, :, 8:16] = 0.0
    stored = ForceField.from_dense(Grid((19, 12, 21), (0.01, 0.02, 0.015), (0.1, -0.2, 0.05)), forces)
    lattice = Grid((37, 41, 60), (0.006, 0.007, 0.0061), (0.08, -0.23, 0.0))
    points = np.stack(np.meshgrid(*(lattice.axis_m(n) for n in range(3)), indexing="ij"), axis=-1)
    size = np.linalg.norm(stored.sample_n(points).astype(np.float64), axis=-1)
    greatest, mean, first, last = pool_depth(stored, lattice)
    if pool == "max":
        np.testing.assert_allclose(greatest, size.max(axis=2), rtol=1e-6, atol=1e-9)
    else:
        np.testing.assert_allclose(
            mean, size.sum(axis=2) / np.maximum((size > 0).sum(axis=2), 1), rtol=1e-6, atol=1e-9
        )
    numbers = np.where(size > 0, np.arange(1, 61), 0)
    assert np.array_equal(last, numbers.max(axis=2))
    assert np.array_equal(first, np.where(last > 0, np.where(size > 0, numbers, 61).min(axis=2), 0))
    assert not pool_depth(ForceField.empty(stored.grid), lattice).any()


def test_no_drive_exceeds_1_even_for_a_tiny_f_max() -> None:
    medium = on_lattice(VEST, {(0, 0): 3e38, (1, 1): 1e-40})
    for force_max_n in (1e-300, 1e-3, 1e300):
        drives = array_drives(stream(medium, force_max_n=force_max_n), VEST).drives(0)
        assert np.isfinite(drives).all() and 0.0 <= drives.min() <= drives.max() <= 1.0


def test_unknown_panels_are_refused() -> None:
    with pytest.raises(InvalidArgument, match=r"panel: found 'left' of tactsuit-x40; expected front or back"):
        array_drives(stream(on_lattice(VEST, {})), VEST, "left")
    shirt = device("tshirt-32x32")
    with pytest.raises(InvalidArgument, match=r"expected front$"):
        array_drives(stream(on_lattice(shirt, {})), shirt, "back")
    with pytest.raises(InvalidArgument, match="a point"):
        array_drives(stream(on_lattice(VEST, {})), device("phantom-omni"))


def test_the_greater_of_force_and_vibration_drives_an_actuator() -> None:
    medium = with_band(
        on_lattice(VEST, {(0, 4): 1.0, (1, 4): 0.5}),
        {(1, 4, 0): (1.5, 80.0), (0, 4, 0): (0.5, 120.0), (3, 4, 0): (0.25, 250.0)},
    )
    frames = array_drives(stream(medium), VEST)
    frequencies = frames.frequencies(0)
    assert frames.drives(0)[0, 0].tolist() == [0.5, 0.75, 0.0, 0.125]
    assert frequencies is not None and frequencies[0, 0].tolist() == [120.0, 80.0, 0.0, 250.0]
    assert not frequencies[0, 1:].any() and not frequencies[1].any()


def test_an_array_of_another_size_is_pooled_as_by_the_encoder(tmp_path: Path) -> None:
    shirt = device("tshirt-32x32")
    medium = on_lattice(shirt, {(i, j): 3.0 for i in range(4, 12) for j in range(20, 28)})
    array = array_drives(stream(medium, force_max_n=3.3), VEST)
    expected = pipeline.prepare(StoredScene(medium), EncodeSpec(device=VEST.name)).medium
    assert array.force_max_n == VEST.force_max_n and array.medium.grid == expected.grid
    assert array.medium[0] == expected[0]
    drives = array.drives(0)
    assert np.unravel_index(drives.argmax(), drives.shape) == (0, 1, 0)  # above the middle, on the left
    assert drives[0, 3:].max() == 0.0 and drives[0, 1, 0] > 0.3


def test_voxel_and_object_streams_reach_the_actuators(tmp_path: Path) -> None:
    for number in (2, 5):
        path = tmp_path / f"{number}.touch"
        pipeline.encode(tiny_scenes()[number], path, EncodeSpec(nw=5))
        with pipeline.open_file(path) as opened:
            frames = array_drives(opened, VEST)
            drives = frames.drives(0)
            assert len(frames) == opened.reader.head.frame_count
        assert drives[0].max() > 0.05 and drives[1].max() == 0.0 and drives.max() <= 1.0


def test_a_stream_for_the_array_returns_the_drives_of_its_encoder(tmp_path: Path) -> None:
    path = tmp_path / "vest.touch"
    pipeline.encode(tiny_scenes()[0], path, EncodeSpec(device=VEST.name))
    with pipeline.open_file(path) as opened:
        drives = array_drives(opened, VEST).drives(0)
        dense = opened.medium[0].to_dense()[:, :, 0]
    size = np.linalg.norm(dense, axis=-1).T / VEST.force_max_n  # of a camera: y down, row 0 is the top
    assert drives[0].max() > 0.1 and np.abs(drives[0] - size).max() < 1e-6


@given(
    st.integers(1, 40),
    st.integers(1, 40),
    st.lists(
        st.tuples(st.integers(0, 39), st.integers(0, 39), st.floats(0.1, 3.0), st.floats(20, 400)),
        min_size=1,
        max_size=6,
    ),
)
def test_a_band_of_another_lattice_reaches_the_actuators_over_it(nx: int, ny: int, samples: list) -> None:
    grid = Grid((nx, ny, 2), (0.01, 0.01, 0.01), (0.3, -0.2, 0.0))
    bare = HapticMedium.from_frames([ForceField.empty(grid)], 50.0, CAMERA_AXES)
    values = {(i % nx, j % ny, k % 2): (a, f) for k, (i, j, a, f) in enumerate(samples)}
    frames = array_drives(stream(with_band(bare, values), 1, 3.3), VEST)
    drives, frequencies = frames.drives(0)[0], frames.frequencies(0)
    assert frequencies is not None and (frequencies[0] > 0).tolist() == (drives > 0).tolist()
    strongest = max(np.float32(a) for a, _ in values.values())
    full = np.float32(float(strongest) / VEST.force_max_n)
    at_hz = {np.float32(f) for a, f in values.values() if np.float32(a) == strongest}  # ties are arbitrary
    assert drives.max() == full and at_hz & set(frequencies[0][drives == full])  # nothing is lost or added
    extent = max(nx / 4, ny / 5)  # samples per actuator, with the aspect ratio
    for (i, j, _), (a, _) in values.items():
        column = 1.5 + (i - (nx - 1) / 2) / extent
        row = 2.0 + (j - (ny - 1) / 2) / extent
        nearby = drives[
            max(0, round(row - 0.5)) : round(row + 0.5) + 1,
            max(0, round(column - 0.5)) : round(column + 0.5) + 1,
        ]
        assert nearby.max() >= np.float32(a / VEST.force_max_n) * (1 - 1e-6)


def actuators_of(centre: float, half: float, count: int, slack: float) -> set[int]:
    """Actuators along an axis whose area contains the centre of a cell, or whose centre is in the cell."""
    return {n for n in range(count) if abs(n - centre) <= 0.5 + slack or abs(n - centre) <= half + slack}


@given(
    st.tuples(st.integers(1, 12), st.integers(1, 12)),
    st.tuples(st.sampled_from([0.01, 0.02, 0.035]), st.sampled_from([0.01, 0.02, 0.035])),
    st.lists(st.tuples(st.integers(0, 11), st.integers(0, 11), st.floats(0.1, 3.0)), min_size=1, max_size=6),
)
def test_an_actuator_has_the_strongest_vibration_over_it(
    shape: tuple[int, int], spacing_m: tuple[float, float], samples: list
) -> None:
    """Compared with all pairs of samples and actuators; a sample on a border may count or not."""
    grid = Grid((*shape, 1), (*spacing_m, 0.01), (0.3, -0.2, 0.0))
    bare = HapticMedium.from_frames([ForceField.empty(grid)], 50.0, CAMERA_AXES)
    values = {(i % shape[0], j % shape[1], 0): (a, 100.0) for i, j, a in samples}
    drives = array_drives(stream(with_band(bare, values), 1, 3.3), VEST).drives(0)[0]
    pitch_m = max(n * s / of for n, s, of in zip(shape, spacing_m, (4, 5), strict=True))
    bounds = []
    for slack in (-1e-6, 1e-6):
        expected = np.zeros((5, 4))
        for sample, (amplitude_n, _) in values.items():
            columns, rows = (
                actuators_of(
                    (of - 1) / 2 + (sample[axis] - (shape[axis] - 1) / 2) * spacing_m[axis] / pitch_m,
                    spacing_m[axis] / pitch_m / 2,
                    of,
                    slack,
                )
                for axis, of in enumerate((4, 5))
            )
            for row in rows:
                for column in columns:
                    expected[row, column] = max(expected[row, column], amplitude_n / VEST.force_max_n)
        bounds.append(np.minimum(expected, 1.0))
    assert (bounds[0] * (1 - 1e-6) <= drives).all() and (drives <= bounds[1] * (1 + 1e-6)).all()
