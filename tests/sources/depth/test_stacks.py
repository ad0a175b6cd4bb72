"""Depth in one file: TIFF of several pages, disparity in .npz, EXR."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import room_makers as room
from stack_makers import BASELINE_M, CAMERA, disparities_px, write_exr, write_tiff
from touchfield.errors import SourceError
from touchfield.sources.camera import Intrinsics
from touchfield.sources.depth.layouts import LAYOUTS
from touchfield.sources.depth.recorders import tiff_stack
from touchfield.sources.depth.recorders.disparity_npz import read_archive
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import kinds, open_source

MM = SourceOptions(depth_scale=1000)
depth_folder = next(layout for layout in LAYOUTS if layout.name == "depth-folder")
depth_map = next(layout for layout in LAYOUTS if layout.name == "depth-map")


def kind_of(path: Path) -> str:
    return next(kind for kind in kinds() if kind.recognise(path)).name


@pytest.mark.parametrize("is_float", [False, True])
def test_pages_of_a_tiff_are_frames(tmp_path: Path, is_float: bool) -> None:
    depths = room.depths_mm()
    frames = [(depth / np.float32(1000)).astype(np.float32) if is_float else depth for depth in depths]
    path = write_tiff(tmp_path / "depth.tif", frames)
    assert kind_of(path) == "depth-tiff"
    sequence = tiff_stack.LAYOUT.read_sequence(path, SourceOptions() if is_float else MM)
    room.assert_room(sequence)
    assert np.allclose(sequence.depth_m(3), depths[3] / 1000, atol=1e-6)  # in any order
    assert np.allclose(sequence.depth_m(1), depths[1] / 1000, atol=1e-6)


def test_pages_that_differ_are_refused(tmp_path: Path) -> None:
    depths = room.depths_mm()
    path = write_tiff(tmp_path / "depth.tif", [depths[0], depths[1], depths[2][:40], depths[3]])
    with pytest.raises(SourceError, match=r"depth\.tif, page 3.*96 x 40.*96 x 72"):
        tiff_stack.LAYOUT.read_sequence(path, MM).depth_m(2)
    eight_bits = write_tiff(tmp_path / "depth8.tif", [np.zeros((72, 96), np.uint8)] * 2)
    with pytest.raises(SourceError, match=r"depth8\.tif.*uint8.*16-bit"):
        open_source(eight_bits, MM)


# -- disparity ---------------------------------------------------------------------------------------------
@pytest.mark.parametrize("names", [("disparity", "K", "baseline_m"), ("disp", "intrinsics", "baseline")])
def test_disparity_of_an_npz_with_its_camera(tmp_path: Path, names: tuple[str, str, str]) -> None:
    fx, fy, cx, cy = room.CAMERA
    k = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]) if names[1] == "K" else np.array(room.CAMERA)
    disparity = disparities_px()[0]
    disparity[3, 4], disparity[5, 6] = 0, np.nan
    path = tmp_path / "stereo.npz"
    np.savez(path, **{names[0]: disparity, names[1]: k, names[2]: BASELINE_M})
    assert kind_of(path) == "disparity-npz"
    sequence = read_archive(path, SourceOptions())
    expected = room.depth_m(room.poses()[0])
    expected[3, 4] = expected[5, 6] = 0
    assert sequence.intrinsics == Intrinsics(*room.CAMERA)
    assert np.allclose(sequence.depth_m(0), expected, rtol=1e-6)


def test_disparity_of_several_frames_with_options(tmp_path: Path) -> None:
    path = tmp_path / "frames.npz"
    np.savez_compressed(path, disparity=(disparities_px() - 2.5).astype(np.float32), doffs=2.5)
    with pytest.raises(SourceError, match=r"frames\.npz.*no camera intrinsics"):
        read_archive(path, SourceOptions(baseline_m=BASELINE_M))
    with pytest.raises(SourceError, match=r"frames\.npz.*no baseline.*--baseline-m"):
        read_archive(path, SourceOptions(intrinsics=CAMERA))
    sequence = read_archive(path, SourceOptions(intrinsics=CAMERA, baseline_m=BASELINE_M))
    assert sequence.frame_count == 4
    for frame, pose in enumerate(room.poses()):
        assert np.allclose(sequence.depth_m(frame), room.depth_m(pose), rtol=1e-5)


@pytest.mark.parametrize("array", [np.zeros(4), np.array(["a"]), np.zeros((0, 4))])
def test_an_npz_without_disparities_is_refused(tmp_path: Path, array: np.ndarray) -> None:
    np.savez(tmp_path / "a.npz", disparity=array)
    with pytest.raises(SourceError, match=r"a\.npz, array disparity"):
        read_archive(tmp_path / "a.npz", SourceOptions(intrinsics=CAMERA, baseline_m=1))


# -- EXR ---------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", ["Z", "V", "ViewLayer.Depth.Z", "any"])
def test_a_folder_of_exr_is_read(tmp_path: Path, name: str) -> None:
    """Metres; 1e10 where the renderer saw no surface."""
    pytest.importorskip("OpenEXR")
    for i, pose in enumerate(room.poses()):
        depth = room.depth_m(pose).astype(np.float32)
        depth[0, :5] = 1e10
        extra = {} if name == "any" else {"A": np.ones_like(depth)}
        write_exr(tmp_path / "depth" / f"{i:04d}.exr", {name: depth, **extra})
    (tmp_path / "intrinsics.txt").write_text(CAMERA)
    np.savetxt(tmp_path / "poses.txt", room.poses().reshape(-1, 16))
    assert kind_of(tmp_path) == "depth-folder"
    sequence = depth_folder.read_sequence(tmp_path, SourceOptions())
    room.assert_room(sequence)
    assert not sequence.depth_m(2)[0, :5].any() and sequence.depth_m(2)[0, 5:].all()


def test_one_exr_picture_of_half_floats(tmp_path: Path) -> None:
    pytest.importorskip("OpenEXR")
    depth = room.depth_m(room.poses()[0]).astype(np.float16)
    path = write_exr(tmp_path / "depth.exr", {"R": depth, "G": depth, "B": depth})
    assert kind_of(path) == "depth-map"
    sequence = depth_map.read_sequence(path, SourceOptions(intrinsics=CAMERA))
    assert np.allclose(sequence.depth_m(0), depth.astype(np.float32))


def test_an_exr_that_is_no_depth_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("OpenEXR")
    grey = np.ones((4, 6), np.float32)
    colour = write_exr(tmp_path / "depth.exr", {"R": grey, "G": 2 * grey, "B": grey})
    with pytest.raises(SourceError, match=r"depth\.exr.*colour.*channel Z"):
        depth_map.read_sequence(colour, SourceOptions(intrinsics="5,5,2,2")).depth_m(0)
    normals = write_exr(tmp_path / "depth_n.exr", {"N.a": grey, "N.b": grey})
    with pytest.raises(SourceError, match=r"depth_n\.exr.*N\.a, N\.b.*channel Z"):
        open_source(normals, SourceOptions(intrinsics="5,5,2,2"))
    whole = (tmp_path / "depth.exr").read_bytes()
    (tmp_path / "cut_depth.exr").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(SourceError, match=r"cut_depth\.exr"):
        depth_map.read_sequence(tmp_path / "cut_depth.exr", SourceOptions(intrinsics="5,5,2,2")).depth_m(0)
