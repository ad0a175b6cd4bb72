"""Relative depth next to a picture or a video: its scale, its file names, and faults."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image

from touchfield.errors import InvalidArgument, SourceError
from touchfield.sources.camera import Intrinsics
from touchfield.sources.depth.depth_scene import DepthScene
from touchfield.sources.depth.inverse_depth import (
    KINDS,
    InverseDepth,
    find_map,
    read_relative as read_sequence,
)
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import open_source
from touchfield.sources.terrain.height_scene import HeightScene
from video_makers import write_video

WIDTH, HEIGHT = 40, 30
NOTHING = SourceOptions()
SLOPE = np.add.outer(2 * np.arange(HEIGHT), 5 * np.arange(WIDTH)).astype(np.uint8)
"""A relative depth that grows to the right and downwards, 0 to 253."""


def colours(width: int = WIDTH, height: int = HEIGHT) -> np.ndarray:
    return np.random.default_rng(1).integers(0, 256, (height, width, 3)).astype(np.uint8)


@pytest.fixture
def photo(tmp_path: Path) -> Path:
    Image.fromarray(colours()).save(tmp_path / "room.jpg")
    return tmp_path / "room.jpg"


@pytest.fixture
def mapped(photo: Path) -> Path:
    Image.fromarray(SLOPE).save(photo.with_name("room_depth.png"))
    return photo


def expected_m(values: np.ndarray, near_m: float = 1.0, far_m: float = 2.0) -> np.ndarray:
    """By the definition: 1/z is linear through (smallest, 1/far) and (largest, 1/near)."""
    return 1 / np.interp(values, [values.min(), values.max()], [1 / far_m, 1 / near_m])


# -- values ------------------------------------------------------------------------------------------------


def test_the_largest_value_is_the_minimum_distance(mapped: Path) -> None:
    sequence = read_sequence(mapped, SourceOptions(near_m=0.5, far_m=4.0))
    depth = sequence.depth_m(0)
    assert depth.dtype == np.float32 and depth.flags.c_contiguous and depth.shape == (HEIGHT, WIDTH)
    assert depth[-1, -1] == depth.min() == np.float32(0.5)
    assert depth[0, 0] == depth.max() == np.float32(4.0)
    assert np.allclose(depth, expected_m(SLOPE.astype(float), 0.5, 4.0), rtol=1e-6)
    assert not any("taken as" in note for note in sequence.notes)
    with pytest.raises(InvalidArgument, match="0 to 0"):
        sequence.depth_m(1)


def test_swapped_limits_invert_the_map(mapped: Path) -> None:
    depth = read_sequence(mapped, SourceOptions(near_m=2.0, far_m=1.0)).depth_m(0)
    assert depth[0, 0] == 1.0 and depth[-1, -1] == 2.0


@pytest.mark.parametrize(
    ("near_m", "far_m", "meant"), [(None, None, (1, 2)), (3, None, (3, 6)), (None, 5, (2.5, 5))]
)
def test_default_limits_are_noted(
    mapped: Path, near_m: float | None, far_m: float | None, meant: tuple[float, float]
) -> None:
    sequence = read_sequence(mapped, SourceOptions(near_m=near_m, far_m=far_m))
    depth = sequence.depth_m(0)
    assert (depth.min(), depth.max()) == meant
    assert any(f"taken as {meant[0]:g} m" in note and "--near-m" in note for note in sequence.notes)


@given(
    hnp.arrays(np.float64, 9, elements=st.floats(-1e3, 1e3), unique=True),
    st.floats(0.1, 10),
    st.floats(-100, 100),
)
def test_unit_and_offset_of_the_map_do_not_matter(values: np.ndarray, unit: float, offset: float) -> None:
    """Estimators give 1/z up to a factor and an offset."""
    if np.ptp(values) < 1e-3:
        return
    low, high = values.min(), values.max()
    plain = InverseDepth(low, high, 1.0, 3.0)(values)
    other = InverseDepth(unit * low + offset, unit * high + offset, 1.0, 3.0)(unit * values + offset)
    assert np.allclose(plain, other, rtol=1e-4)
    assert plain.min() == 1.0 and plain.max() == 3.0
    assert (np.argsort(plain, kind="stable") == np.argsort(-values, kind="stable")).all() or np.unique(
        plain
    ).size < 9


def test_floats_may_be_unknown(photo: Path) -> None:
    values = SLOPE.astype(np.float32) - 100
    values[3, 4], values[5, 6] = np.nan, np.inf
    np.save(photo.with_name("room-depth.npy"), values)
    depth = read_sequence(photo, NOTHING).depth_m(0)
    assert depth[3, 4] == 0 and depth[5, 6] == 0 and (depth > 0).sum() == depth.size - 2


def test_sixteen_bits_and_grey_stored_as_rgb(photo: Path) -> None:
    Image.fromarray(SLOPE.astype(np.uint16) * 257).save(photo.with_name("room.depth.png"))
    fine = read_sequence(photo, NOTHING).depth_m(0)
    photo.with_name("room.depth.png").unlink()
    Image.fromarray(np.stack([SLOPE] * 3, -1)).save(photo.with_name("room_depth.png"))
    assert np.allclose(read_sequence(photo, NOTHING).depth_m(0), fine, rtol=1e-6)


# -- file names --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "is_found"),
    [
        ("room_depth.png", True),
        ("room.depth.PNG", True),
        ("room-depth-vitl.npy", True),
        ("Room_Depth_16.tiff", True),
        ("room_depth.mkv", True),
        ("room2_depth.png", False),
        ("room_depths.png", False),
        ("roomdepth.png", False),
        ("room_depth.jpg", False),
        ("xroom_depth.png", False),
    ],
)
def test_the_map_is_recognised_by_its_name(photo: Path, name: str, is_found: bool) -> None:
    assert not KINDS["relative-depth"].recognise(photo)
    photo.with_name(name).write_bytes(b"")
    assert (find_map(photo) is not None) == is_found == KINDS["relative-depth"].recognise(photo)


def test_a_name_is_no_pattern(tmp_path: Path) -> None:
    Image.fromarray(colours()).save(tmp_path / "a(1)+.png")
    Image.fromarray(SLOPE).save(tmp_path / "a(1)+_depth.png")
    assert find_map(tmp_path / "a(1)+.png") == tmp_path / "a(1)+_depth.png"


@pytest.mark.parametrize(("reading", "kind"), [("camera", DepthScene), ("height", HeightScene)])
def test_a_picture_with_its_depth_opens_in_either_reading(mapped: Path, reading: str, kind: type) -> None:
    scene = open_source(mapped, SourceOptions(reading=reading))
    assert isinstance(scene, kind)
    assert any("--reading height" in note for note in scene.notes) == (reading == "camera")


def test_the_map_may_be_in_another_folder(mapped: Path, tmp_path: Path) -> None:
    other = tmp_path / "maps" / "0.png"
    other.parent.mkdir()
    Image.fromarray(255 - SLOPE).save(other)
    for where in (other, other.parent):
        depth = read_sequence(mapped, SourceOptions(relative_depth=str(where))).depth_m(0)
        assert depth[0, 0] == 1.0 and depth[-1, -1] == 2.0
    alone = tmp_path / "alone.png"  # an explicit map defines the kind of the picture
    alone.write_bytes(mapped.read_bytes())
    assert isinstance(open_source(alone, SourceOptions(relative_depth=str(other))), DepthScene)


# -- the camera --------------------------------------------------------------------------------------------


def test_the_default_camera_has_sixty_degrees(mapped: Path) -> None:
    sequence = read_sequence(mapped, NOTHING)
    k = sequence.intrinsics
    half = np.degrees(np.arctan((WIDTH / 2) / k.fx))
    assert half == pytest.approx(30) and k.fx == pytest.approx(k.fy)
    assert (k.cx, k.cy) == pytest.approx(((WIDTH - 1) / 2, (HEIGHT - 1) / 2))
    assert any("60 degrees" in note for note in sequence.notes)


def test_intrinsics_are_those_of_the_picture(photo: Path) -> None:
    """A pixel of a map of half the size covers two by two of the picture, with the same rays."""
    Image.fromarray(SLOPE[::2, ::2]).save(photo.with_name("room_depth.png"))
    sequence = read_sequence(photo, SourceOptions(intrinsics="36,38,21,14"))
    assert (sequence.width, sequence.height) == (WIDTH // 2, HEIGHT // 2)
    k = sequence.intrinsics
    u = np.arange(WIDTH // 2)
    assert np.allclose((u - k.cx) / k.fx, (2 * u + 0.5 - 21) / 36)
    v = np.arange(HEIGHT // 2)
    assert np.allclose((v - k.cy) / k.fy, (2 * v + 0.5 - 14) / 38)
    photo.with_name("intrinsics.json").write_text(json.dumps({"fx": 36, "fy": 38, "cx": 21, "cy": 14}))
    assert read_sequence(photo, NOTHING).intrinsics == k
    assert k != Intrinsics(36, 38, 21, 14)


def test_a_rotated_photograph_fits_its_upright_map(photo: Path) -> None:
    exif = Image.Exif()
    exif[0x0112] = 6  # rotated by a quarter
    Image.fromarray(colours(HEIGHT, WIDTH)).save(photo, exif=exif)
    Image.fromarray(SLOPE).save(photo.with_name("room_depth.png"))
    assert read_sequence(photo, NOTHING).width == WIDTH


# -- videos ------------------------------------------------------------------------------------------------


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    pytest.importorskip("av")
    return write_video(tmp_path / "walk.mkv", np.stack([colours()] * 4), "bgr0", rate=20)


def moving(count: int = 4) -> np.ndarray:
    return np.stack([SLOPE // 2 + 20 * i for i in range(count)]).astype(np.uint8)


@pytest.mark.parametrize("form", ["gray", "gray16le", "folder"])
def test_a_video_with_a_video_or_a_folder_of_maps(clip: Path, form: str) -> None:
    """One scale for all frames: constant values have a constant depth."""
    stored = moving()
    if form == "folder":
        where = clip.parent / "maps"
        where.mkdir()
        for i, values in enumerate(stored):
            Image.fromarray(values).save(where / f"{i}.png")
        options = SourceOptions(relative_depth=str(where))
    else:
        write_video(
            clip.with_name("walk_depth.mkv"), stored * np.uint16(200) if "16" in form else stored, form
        )
        assert KINDS["relative-depth"].recognise(clip)
        options = NOTHING
    sequence = read_sequence(clip, options)
    assert (sequence.frame_count, sequence.rate_hz) == (4, 20.0)
    for i in (0, 3, 1):
        assert np.allclose(sequence.depth_m(i), expected_m(stored.astype(float))[i], rtol=1e-6)
    faster = SourceOptions(relative_depth=options.relative_depth, kind="relative-depth", rate_hz=100)
    assert open_source(clip, faster).frame_count == 20


def test_grey_values_that_went_through_a_lossy_codec(clip: Path) -> None:
    av = pytest.importorskip("av")
    if "libx264" not in av.codecs_available:
        pytest.skip("no libx264")
    grey = np.stack([moving()] * 3, -1)
    write_video(clip.with_name("walk_depth.mp4"), grey, "yuv420p", "libx264", crf="10")
    sequence = read_sequence(clip, NOTHING)
    assert np.allclose(sequence.depth_m(2), expected_m(moving().astype(float))[2], rtol=0.03)
    write_video(clip.with_name("walk_depth.mp4"), np.stack([colours()] * 4), "yuv420p", "libx264", crf="10")
    with pytest.raises(SourceError, match=r"frame 0: found a frame in colour"):
        read_sequence(clip, NOTHING)


def test_as_many_maps_as_frames(clip: Path) -> None:
    write_video(clip.with_name("walk_depth.mkv"), moving(3), "gray")
    with pytest.raises(SourceError, match=r"3 maps; expected 4, one for each frame"):
        read_sequence(clip, NOTHING)


# -- faults ------------------------------------------------------------------------------------------------


def test_unusable_maps_are_refused(photo: Path, tmp_path: Path) -> None:
    where = photo.with_name("room_depth.png")
    for picture, message in (
        (np.full((HEIGHT, WIDTH), 7, np.uint8), "the one value 7"),
        (SLOPE[:, :30], "30 x 30 pixels; expected the shape of room.jpg, 40 x 30"),
        (colours(), "in colour; expected the grey map"),
        (np.dstack([colours(), SLOPE]), "RGBA"),
    ):
        Image.fromarray(picture).save(where)
        with pytest.raises(SourceError, match=message):
            read_sequence(photo, NOTHING)
    Image.fromarray(SLOPE).save(where)
    where.write_bytes(where.read_bytes()[:-40])
    with pytest.raises(SourceError, match="damaged"):
        read_sequence(photo, NOTHING)
    where.unlink()
    np.save(photo.with_name("room_depth.npy"), np.full((HEIGHT, WIDTH), np.nan))
    with pytest.raises(SourceError, match="no range of numbers"):
        read_sequence(photo, NOTHING)


def test_errors_of_missing_maps_name_them(photo: Path, tmp_path: Path) -> None:
    with pytest.raises(SourceError, match=r"no relative depth next to it; expected room_depth.png"):
        read_sequence(photo, NOTHING)
    with pytest.raises(SourceError, match=r"no relative depth .*nowhere"):
        read_sequence(photo, SourceOptions(relative_depth=str(tmp_path / "nowhere")))
    (tmp_path / "empty").mkdir()
    with pytest.raises(SourceError, match="no map"):
        read_sequence(photo, SourceOptions(relative_depth=str(tmp_path / "empty")))
    with pytest.raises(SourceError, match="a folder"):
        read_sequence(tmp_path, NOTHING)
    Image.fromarray(SLOPE).save(photo.with_name("room_depth.png"))
    with pytest.raises(InvalidArgument, match="two distances"):
        read_sequence(photo, SourceOptions(near_m=1, far_m=1))
    photo.write_bytes(b"no picture")
    with pytest.raises(SourceError, match=r"expected PNG, JPEG"):
        read_sequence(photo, NOTHING)


def test_maps_of_different_sizes_in_a_folder(clip: Path) -> None:
    where = clip.parent / "maps"
    where.mkdir()
    for i in range(4):
        Image.fromarray(SLOPE[: HEIGHT - i]).save(where / f"{i}.png")
    with pytest.raises(SourceError, match=r"1\.png: found 40 x 29 pixels"):
        read_sequence(clip, SourceOptions(relative_depth=str(where)))
