"""The range of depth is always stated, and another unit, encoding or file than assumed is reported."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import depth_makers as make
from touchfield.errors import InvalidArgument, SourceError
from touchfield.sources.depth.depth_check import range_note
from touchfield.sources.images.pictures import list_files
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import open_source

WIDTH, HEIGHT = 40, 30


def slope_mm(far: float = 1.0) -> np.ndarray:
    """Millimetres, uint16 [HEIGHT, WIDTH]: 800 to 1977 of all values, times `far`; one pixel unknown."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    depth = np.round(far * (800 + 17 * u + 17.7 * v)).astype(np.uint16)
    depth[3, 4] = 0
    return depth


def rotated(values: np.ndarray) -> np.ndarray:
    """Bits rotated by 3 to the left, as SUN3D and the Amazon Picking Challenge store them."""
    return ((values << 3) | (values >> 13)).astype(np.uint16)


def write(folder: Path, values: np.ndarray, name: str = "depth/{}.png", frames: int = 2) -> Path:
    for i in range(frames):
        make.write_png(folder / name.format(i), values)
    make.write_intrinsics(folder / "intrinsics.txt")
    return folder


def notes_of(path: Path, **options: object) -> tuple[str, ...]:
    return open_source(path, SourceOptions(**options)).notes


def has(notes: tuple[str, ...], *texts: str) -> bool:
    """Return True if one note has all of these texts."""
    return any(all(text in note for text in texts) for note in notes)


QUESTIONS = ("too far", "too near", "bits", "steps")


def is_questioned(notes: tuple[str, ...]) -> bool:
    return any(text in note for note in notes for text in QUESTIONS)


# -- range and unit ----------------------------------------------------------------------------------------
def test_the_range_is_stated_in_metres(tmp_path: Path) -> None:
    notes = notes_of(write(tmp_path, slope_mm()), depth_scale=1000.0)
    assert "Depth is 0.8 to 1.98 m in 2 frames, median 1.39 m, at 1000 stored units in a metre." in notes
    assert not is_questioned(notes)
    np.save(tmp_path / "depth.npy", slope_mm().astype(np.float32)[None] / 1000)
    notes = notes_of(tmp_path / "depth.npy")
    assert "Depth is 0.8 to 1.98 m, median 1.39 m, at 1 stored units in a metre." in notes
    assert has(notes, "No file states the unit of depth: metres, as floats usually are (--depth-scale)")


def test_depths_at_the_end_of_float32_have_a_median() -> None:
    depth = np.full((1, 2), 3e38, np.float32)
    assert range_note([depth]) == ("Depth is 3e+38 to 3e+38 m, median 3e+38 m.",)


@pytest.mark.parametrize(
    ("far", "scale", "mends"),
    [
        (20.0, 1000.0, ["--depth-scale 10000 (0.1 mm) makes it 2.8 m", "--depth-scale 5000 (as in TUM)"]),
        (1.0, 1.0, ["--depth-scale 1000 (millimetres) makes it 1.4 m"]),
        (0.1, 5000.0, ["too near", "--depth-scale 100 (centimetres) makes it 1.4 m"]),
    ],
)
def test_an_implausible_median_names_the_units_that_would_fit(
    tmp_path: Path, far: float, scale: float, mends: list[str]
) -> None:
    notes = notes_of(write(tmp_path, slope_mm(far)), depth_scale=scale)
    assert has(notes, "A median depth of", *mends), notes
    right = float(mends[-1].split("--depth-scale ")[1].split()[0])
    assert not has(notes_of(tmp_path, depth_scale=right), "A median depth of")


def test_a_unit_that_is_only_assumed_is_questioned_sooner(tmp_path: Path) -> None:
    """14 m may be a street where the user states the unit, and is 1.4 m in 0.1 mm where none is stated."""
    folder = write(tmp_path / "a", slope_mm(10), "frame-{:06d}.depth.png")
    notes = notes_of(folder)
    assert has(notes, "No file states the unit of depth: 1000 to a metre, as in the layout 3dmatch")
    assert has(notes, "A median depth of 13.9 m", "--depth-scale 10000 (0.1 mm) makes it 1.4 m")
    stated = notes_of(folder, depth_scale=1000.0)
    assert not is_questioned(stated) and not has(stated, "No file states")
    assert not is_questioned(notes_of(write(tmp_path / "b", slope_mm(), "frame-{:06d}.depth.png")))


@pytest.mark.parametrize(
    ("maker", "assumed"),
    [
        (make.write_tum, "5000 to a metre, as in the layout tum"),
        (make.write_redwood, "1000 to a metre, as in the layout redwood"),
        (make.write_sun3d, "1000 to a metre, as in the layout sun3d"),
        (make.write_threedmatch, "1000 to a metre, as in the layout 3dmatch"),
    ],
)
def test_a_layout_known_by_its_names_states_what_it_assumes(tmp_path: Path, maker, assumed: str) -> None:
    folder = maker(tmp_path / "s")
    notes = notes_of(folder)
    assert has(notes, "No file states the unit of depth", assumed, "--depth-scale")
    assert has(notes, "Bits of depth are read as rotated by 3") == (maker is make.write_sun3d)
    for file in (folder / "intrinsics.txt", folder.parent / "camera-intrinsics.txt"):
        file.unlink(missing_ok=True)
    with pytest.raises(SourceError, match="no camera intrinsics"):  # 12 x 9 pixels: there is no default
        notes_of(folder)


# -- encoding ----------------------------------------------------------------------------------------------
def test_rotated_bits_are_named_with_the_option(tmp_path: Path) -> None:
    """As in APC's scenes: names as in 3DMatch, rotated bits."""
    folder = write(tmp_path, rotated(slope_mm()), "frame-{:06d}.depth.png")
    assert has(notes_of(folder), "seem rotated by 3", "--depth-encoding rotated", "10000 (APC)")
    notes = notes_of(folder, depth_encoding="rotated")
    assert has(notes, "Depth is 0.8 to 1.98 m") and not is_questioned(notes)
    far = write(tmp_path / "far", rotated(slope_mm(10)), "frame-{:06d}.depth.png")  # 0.1 mm, above 13 bits
    notes = notes_of(far, depth_encoding="rotated", depth_scale=10000.0)
    assert has(notes, "Depth is 0.8 to 1.98 m") and not is_questioned(notes)


def test_bits_that_are_not_rotated_are_named_where_the_layout_assumes_it(tmp_path: Path) -> None:
    folder = write(tmp_path, slope_mm(), "depth/{:07d}-000000000000.png")
    make.write_matrix(folder / "extrinsics" / "1.txt", make.poses(2)[:, :3].reshape(-1, 4))
    assert has(notes_of(folder), "are not rotated", "--depth-encoding plain")
    notes = notes_of(folder, depth_encoding="plain")
    assert has(notes, "Depth is 0.8 to 1.98 m") and not is_questioned(notes)
    assert not has(notes, "Bits of depth are read as rotated")


@pytest.mark.parametrize("factor", [256, 257, 1])
def test_8_bits_saved_as_16_are_named(tmp_path: Path, factor: int) -> None:
    values = (slope_mm() // 8).astype(np.uint16) * np.uint16(factor)
    notes = notes_of(write(tmp_path, values), depth_scale=1000.0)
    assert has(notes, "The values have 8 bits only", f"steps of {factor} mm", "all 16 bits")


@pytest.mark.parametrize("factor", [1, 4, 16])
def test_plain_values_that_use_some_of_their_bits_are_not_questioned(tmp_path: Path, factor: int) -> None:
    notes = notes_of(write(tmp_path, slope_mm() * np.uint16(factor)), depth_scale=1000.0 * factor)
    assert has(notes, "Depth is 0.8 to 1.98 m") and not is_questioned(notes)
    assert not is_questioned(
        notes_of(write(tmp_path / "flat", np.full((30, 40), 800, np.uint16)), depth_scale=1000)
    )


def test_8_bit_pictures_are_refused_with_what_mends_it(tmp_path: Path) -> None:
    v, u = np.mgrid[:120, :160]
    radius = np.hypot(u - 80, v - 60)
    ball = np.where(radius < 40, 120 + 2 * np.sqrt(np.maximum(1600 - radius**2, 0)), 60).astype(np.uint8)
    folder = write(tmp_path, ball)
    with pytest.raises(SourceError, match=r"uint8.*16 bits.*--relative-depth") as refused:
        notes_of(folder, depth_scale=1000.0)
    picture, relative = (str(folder / "depth" / "0.png"),) * 2
    assert f"encode {picture} OUT --relative-depth {relative} --near-m 0.5 --far-m 3" in str(refused.value)
    (folder / "intrinsics.txt").unlink()
    mended = notes_of(Path(picture), relative_depth=relative, near_m=0.5, far_m=3.0)
    assert has(mended, "Depth is 0.5 to 3 m")


def test_rotated_bits_of_floats_are_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "depth.npy", slope_mm().astype(np.float32)[None])
    make.write_intrinsics(tmp_path / "intrinsics.txt")
    with pytest.raises(InvalidArgument, match="--depth-encoding: found rotated bits of float32"):
        notes_of(tmp_path / "depth.npy", depth_encoding="rotated")


# -- files -------------------------------------------------------------------------------------------------
def test_text_files_that_are_not_read_are_listed(tmp_path: Path) -> None:
    folder = write(tmp_path, slope_mm())
    make.write_rows(folder / "poses.txt", make.poses(2).reshape(-1, 16))
    assert not has(notes_of(folder, depth_scale=1000.0), "not read")
    (folder / "README.md").write_text("a room")
    (folder / "LICENSE.txt").write_text("free")
    (folder / "cam.info.txt").write_text("1 2 3")
    (folder / "accelerometer.csv").write_text("1,2,3")
    (note,) = [note for note in notes_of(folder, depth_scale=1000.0) if "not read" in note]
    assert note == "Text files in the folder that are not read: accelerometer.csv, cam.info.txt."
    for i in range(9):
        (folder / f"b{i}.yaml").write_text("a: 1")
    (note,) = [note for note in notes_of(folder, depth_scale=1000.0) if "not read" in note]
    assert note.endswith("accelerometer.csv, b0.yaml, b1.yaml, b2.yaml, b3.yaml, b4.yaml and 5 more.")
    in_camera_frame = notes_of(folder, depth_scale=1000.0, frame="camera")
    assert has(in_camera_frame, "not read", "and 6 more")  # poses.txt too


@pytest.mark.parametrize(
    "names",
    [
        ("1700000000.5", "1700000000.533333", "1700000000.56", "1700000000.6", "1700000000.633333"),
        ("0.95", "1.0", "1.05", "1.1", "10.0"),
        ("depth_0.5", "depth_0.75"),
        ("1.8", "1.9", "1.10", "1.11", "2.1"),  # counted in two series
        ("cam1.5", "cam1.10", "cam1.15", "cam2.5"),
        ("frame.9", "frame.10", "frame.100"),
        ("0000001-000000033369", "0000002-000000066738", "0000010-000000333690"),
    ],
)
def test_frames_are_in_the_order_of_their_numbers(tmp_path: Path, names: tuple[str, ...]) -> None:
    for name in reversed(names):
        (tmp_path / f"{name}.png").touch()
    assert tuple(file.stem for file in list_files(tmp_path, r".+\.png")) == names


def test_frames_with_decimal_times_keep_their_own_poses(tmp_path: Path) -> None:
    times = ("1700000000.5", "1700000000.533333", "1700000000.56", "1700000000.6", "1700000000.633333")
    for i, name in enumerate(times):
        make.write_png(tmp_path / "depth" / f"{name}.png", slope_mm() + np.uint16(i))
    make.write_intrinsics(tmp_path / "intrinsics.txt")
    make.write_rows(tmp_path / "poses.txt", make.poses(5).reshape(-1, 16))
    sequence = open_source(tmp_path, SourceOptions(depth_scale=1000.0)).sequence
    assert [round(1000 * float(sequence.depth_m(i)[0, 0])) for i in range(5)] == [800, 801, 802, 803, 804]
    np.testing.assert_allclose(sequence.poses, make.poses(5), atol=1e-8)
