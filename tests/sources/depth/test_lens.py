"""Lens distortion in every form of camera file: read, undone, or named as not undone."""

from __future__ import annotations

import contextlib
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

import room_makers as room
from touchfield.errors import InvalidArgument, SourceError
from touchfield.sources.camera import Intrinsics
from touchfield.sources.depth.capture import CapturedSequence, GrowingFolder
from touchfield.sources.depth.intrinsics_file import camera_of, parse_intrinsics
from touchfield.sources.depth.inverse_depth import read_disparity
from touchfield.sources.depth.layouts import LAYOUTS
from touchfield.sources.depth.lens import Lens, Resampling, distortion_of, undistortion
from touchfield.sources.options import SourceOptions

depth_folder = next(layout for layout in LAYOUTS if layout.name == "depth-folder")
MM = SourceOptions(depth_scale=1000)
FX, FY, CX, CY = room.CAMERA
SIZE = {"width": room.WIDTH, "height": room.HEIGHT}
K = [FX, 0, CX, 0, FY, CY, 0, 0, 1]
D = (-0.3, 0.1, 0.002, -0.001)
D5 = (*D, -0.02)
FISHEYE = (0.05, -0.02, 0.003, -0.001)


def opencv_matrix(name: str, rows: int, values: list[float]) -> str:
    columns, text = len(values) // rows, ", ".join(map(repr, values))
    half = text.index(",", len(text) // 2) + 1  # OpenCV breaks long lists
    head = f"{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n"
    return f"{head}   data: [ {text[:half]}\n       {text[half:]} ]\n"


COLMAP_SIZE = f"{room.WIDTH} {room.HEIGHT}"
COLMAP_K = f"{FX} {FY} {CX + 0.5} {CY + 0.5}"
FORMS: dict[str, tuple[str, str, tuple[float, ...]]] = {
    "ros json": (
        "camera_info.json",
        json.dumps({**SIZE, "distortion_model": "plumb_bob", "D": [*D5], "K": K}),
        D5,
    ),
    "ros2 json": (
        "camera_info.json",
        json.dumps({**SIZE, "distortion_model": "rational_polynomial", "d": [*D5, 0, 0, 0], "k": K}),
        D5,
    ),
    "ros yaml": (
        "camera_info.yaml",
        f"image_width: {room.WIDTH}\nimage_height: {room.HEIGHT}\ncamera_name: depth\ncamera_matrix:\n"
        f"  rows: 3\n  cols: 3\n  data: {K}\ndistortion_model: plumb_bob\ndistortion_coefficients:\n"
        f"  rows: 1\n  cols: 5\n  data: {[*D5]}\n",
        D5,
    ),
    "ros topic echo": (
        "camera_info.yaml",
        f"header:\n  frame_id: depth\nheight: {room.HEIGHT}\nwidth: {room.WIDTH}\n"
        "distortion_model: plumb_bob\nd:\n" + "".join(f"- {v}\n" for v in D5)
        + "k:\n" + "".join(f"- {v}\n" for v in K) + "---\n",
        D5,
    ),
    "opencv yaml": (
        "calibration.yml",
        "%YAML:1.0\n---\n" + opencv_matrix("camera_matrix", 3, K)
        + opencv_matrix("distortion_coefficients", 1, [*D5]),
        D5,
    ),
    "kalibr": (
        "camchain.yaml",
        f"cam0:\n  camera_model: pinhole\n  distortion_coeffs: {[*D]}\n  distortion_model: radtan\n"
        f"  intrinsics: {[FX, FY, CX, CY]}\n  resolution: [{room.WIDTH}, {room.HEIGHT}]\n",
        D,
    ),
    "orb-slam": (
        "camera.yaml",
        f"%YAML:1.0\n# camera\nCamera.fx: {FX}\nCamera.fy: {FY}\nCamera.cx: {CX}\nCamera.cy: {CY}\n"
        f"Camera.k1: {D5[0]}\nCamera.k2: {D5[1]}\nCamera.p1: {D5[2]}\nCamera.p2: {D5[3]}\n"
        f"Camera.k3: {D5[4]}\n"
        "DepthMapFactor: 1000.0\n",
        D5,
    ),
    "opencv json": (
        "calibration.json",
        json.dumps({"camera_matrix": np.reshape(K, (3, 3)).tolist(), "dist_coeffs": [[*D5]]}),
        D5,
    ),
    "realsense": (
        "intrinsics.json",
        json.dumps({**SIZE, "fx": FX, "fy": FY, "ppx": CX, "ppy": CY, "coeffs": [*D5],
                    "model": "distortion.brown_conrady"}),
        D5,
    ),
    "nerfstudio": (
        "transforms.json",
        json.dumps({"w": room.WIDTH, "h": room.HEIGHT, "fl_x": FX, "fl_y": FY, "cx": CX + 0.5, "cy": CY + 0.5,
                    "k1": D[0], "k2": D[1], "p1": D[2], "p2": D[3], "camera_model": "OPENCV", "frames": []}),
        D,
    ),
    "colmap": ("cameras.txt", f"1 OPENCV {COLMAP_SIZE} {COLMAP_K} {' '.join(map(str, D))}", D),
    "after four numbers": ("intrinsics.txt", " ".join(map(str, (*room.CAMERA, *D5))), D5),
    "after a matrix": (
        "K.txt", f"{FX} 0 {CX}\n0 {FY} {CY}\n0 0 1\n{' '.join(map(str, D5))}\n", D5,
    ),
    "fisheye json": (
        "camera_info.json",
        json.dumps({**SIZE, "distortion_model": "equidistant", "D": [*FISHEYE], "K": K}),
        FISHEYE,
    ),
    "fisheye colmap": (
        "cameras.txt", f"1 OPENCV_FISHEYE {COLMAP_SIZE} {COLMAP_K} {' '.join(map(str, FISHEYE))}", FISHEYE,
    ),
    "fisheye nerfstudio": (
        "transforms.json",
        json.dumps({"w": room.WIDTH, "h": room.HEIGHT, "fl_x": FX, "fl_y": FY, "cx": CX + 0.5, "cy": CY + 0.5,
                    "camera_model": "OPENCV_FISHEYE", "frames": [],
                    **{f"k{i + 1}": value for i, value in enumerate(FISHEYE)}}),
        FISHEYE,
    ),
}  # fmt: skip


def write_room(folder: Path, name: str, text: str, distort: room.Distort) -> Path:
    for i, values in enumerate(room.depths_mm(distort=distort)):
        room.write_png(folder / "depth" / f"{i:03d}.png", values)
    (folder / name).write_text(text)
    np.savetxt(folder / "poses.txt", room.poses().reshape(-1, 16))
    return folder


@pytest.mark.parametrize("form", FORMS)
def test_distortion_of_every_form_is_undone(tmp_path: Path, form: str) -> None:
    """Undistorted, the walls are flat and where they are; as stored they are centimetres off."""
    pytest.importorskip("cv2")
    name, text, coefficients = FORMS[form]
    distort = (room.fisheye if form.startswith("fisheye") else room.brown)(*coefficients)
    sequence = depth_folder.read_sequence(write_room(tmp_path, name, text, distort), MM)
    room.assert_room(sequence, known=0.9)
    assert sequence.intrinsics == Intrinsics(*room.CAMERA)
    assert any(f"distortion in {name}" in note and "is undone" in note for note in sequence.notes)
    stored = sequence.source
    off = [np.quantile(room.distances_to_walls_m(stored, frame), 0.95) for frame in range(4)]
    assert min(off) > 0.01  # so that the assertion above can fail


def test_distortion_of_realsense_is_undone_by_the_inverse_polynomial(tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    to_undistorted = room.brown(*D5)  # from distorted to undistorted points

    def distort(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return room.undistorted(x, y, to_undistorted)

    values = {**SIZE, "fx": FX, "fy": FY, "ppx": CX, "ppy": CY, "coeffs": [*D5]}
    text = json.dumps({**values, "model": "inverse_brown_conrady"})
    # a picture of this camera: the ray of a pixel is the polynomial at the pixel
    v, u = np.mgrid[0 : room.HEIGHT, 0 : room.WIDTH]
    ray_x, ray_y = to_undistorted((u - CX) / FX, (v - CY) / FY)
    for i, pose in enumerate(room.poses()):
        rays = np.stack([ray_x, ray_y, np.ones_like(ray_x)], axis=-1) @ pose[:3, :3].T
        depth = room.along_rays_m(rays, pose[:3, 3])
        room.write_png(tmp_path / "depth" / f"{i}.png", np.rint(1000 * depth).astype(np.uint16))
    (tmp_path / "intrinsics.json").write_text(text)
    np.savetxt(tmp_path / "poses.txt", room.poses().reshape(-1, 16))
    sequence = depth_folder.read_sequence(tmp_path, MM)
    room.assert_room(sequence, known=0.6)
    assert np.quantile(room.distances_to_walls_m(sequence.source, 0), 0.95) > 0.01


def test_distortion_without_opencv_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    name, text, coefficients = FORMS["ros json"]
    sequence = depth_folder.read_sequence(write_room(tmp_path, name, text, room.brown(*coefficients)), MM)
    assert any("is not undone" in note and 'touchfield[camera]"' in note for note in sequence.notes)
    assert np.array_equal(
        sequence.depth_m(0), room.depths_mm(distort=room.brown(*coefficients))[0] / np.float32(1000)
    )


def test_distortion_of_an_unknown_model_is_named() -> None:
    distortion = distortion_of((0.9,), "camera.yaml", "double_sphere")
    resampling, notes = undistortion(Lens(Intrinsics(*room.CAMERA), distortion), (96, 72))
    assert resampling is None
    assert "double_sphere of 1 coefficients" in notes[0] and "is not undone; this model" in notes[0]


@pytest.mark.parametrize("model", ["", "plumb_bob", "none", "distortion.none", "equidistant"])
def test_no_distortion_leaves_no_note(model: str) -> None:
    assert distortion_of((0, 0, 0, 0, 0), "k", model) is None
    assert distortion_of((0.1, 0, 0, 0), "k", "distortion.none") is None


def test_a_distortion_that_is_no_number_is_refused() -> None:
    with pytest.raises(SourceError, match=r"k.json.*finite"):
        parse_intrinsics('{"fx": 1, "fy": 1, "cx": 1, "cy": 1, "D": [NaN, 0, 0, 0]}', "k.json")
    with pytest.raises(SourceError, match=r"k.json.*numbers"):
        parse_intrinsics('{"fx": 1, "fy": 1, "cx": 1, "cy": 1, "D": ["a", 0, 0, 0]}', "k.json")
    with pytest.raises(SourceError, match="list without its end"):
        parse_intrinsics("fx: 1\nD: [1, 2\n", "k.yaml")


def test_distortion_is_taken_from_the_option() -> None:
    camera = camera_of("s", "80,82,46.5,36,-0.3,0.1,0.002,-0.001", (), (96, 72))
    assert camera.distortion is not None and camera.distortion.coefficients == D
    with pytest.raises(InvalidArgument, match="--intrinsics"):
        camera_of("s", "80,82,46.5,36,-0.3", (), (96, 72))


def test_edges_are_not_interpolated() -> None:
    """A step from 1 m to 2 m keeps its two depths; on a plane the inverse depth is interpolated exactly."""
    v, u = np.mgrid[0:20, 0:30].astype(np.float32)
    step = np.where(u < 14, 1, 2).astype(np.float32)
    shifted = Resampling(u + np.float32(0.4), v, 50.0)
    assert set(np.unique(shifted(step))) == {1.0, 2.0}
    plane = (1 / (0.5 + 0.01 * u + 0.004 * v)).astype(np.float32)
    expected = 1 / (0.5 + 0.01 * (u + 0.4) + 0.004 * v)
    assert np.allclose(shifted(plane)[:, :-1], expected[:, :-1], rtol=1e-6)
    plane[5, 7] = 0
    assert shifted(plane)[5, 7] == 0 and shifted(plane)[5, 6] > 0


@given(st.text(alphabet="abk:[],-. \n0123456789!%#", max_size=80))
def test_any_text_is_a_camera_or_refused(text: str) -> None:
    for head in ("", "fx: 1\n", "K: [1, 0, 1, 0, 1, 1, 0, 0, 1]\nD: "):
        with contextlib.suppress(SourceError):
            parse_intrinsics(head + text, "k.yaml")


def test_a_watched_folder_is_undistorted(tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    name, text, coefficients = FORMS["ros json"]
    folder = write_room(tmp_path, name, text, room.brown(*coefficients))
    for file in sorted((folder / "depth").iterdir()):
        file.rename(folder / file.name)
    options = SourceOptions(depth_scale=1000)
    captured = CapturedSequence(GrowingFolder(folder), options, (folder,))
    flat, pose = captured.depth_m(0), room.poses()[-1]
    captured.close()
    assert any("is undone" in note for note in captured.notes)
    expected, is_known = room.depth_m(pose), flat > 0
    assert is_known.mean() > 0.9
    assert np.quantile(np.abs(flat - expected)[is_known], 0.95) < 0.008
    stored = room.depth_m(pose, distort=room.brown(*coefficients))
    assert np.quantile(np.abs(stored - expected), 0.95) > 0.05


def test_distortion_is_not_undone_in_disparity(tmp_path: Path) -> None:
    """Matching needs rectified pictures: a distortion beside the map is that of the pictures taken."""
    disparity = (room.CAMERA[0] * 0.1 / room.depth_m(room.poses()[0])).astype(np.float32)
    np.save(tmp_path / "disp.npy", disparity)
    (tmp_path / "camera_info.json").write_text(FORMS["ros json"][1])
    sequence = read_disparity(tmp_path / "disp.npy", SourceOptions(baseline_m=0.1))
    assert any("is not undone: a disparity map" in note for note in sequence.notes)
    assert np.allclose(sequence.depth_m(0), room.depth_m(room.poses()[0]), rtol=1e-5)
