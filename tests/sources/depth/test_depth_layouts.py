"""Depth sequences on disk: every layout is read back, and every fault is one clear error."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

import depth_makers as make
from touchfield.errors import InvalidArgument, SourceError
from touchfield.sources.camera import DepthCode, Intrinsics
from touchfield.sources.depth.depth_scene import DepthScene
from touchfield.sources.depth.layouts import LAYOUTS as DEPTH_LAYOUTS, Layout
from touchfield.sources.images import pictures
from touchfield.sources.options import SourceOptions
from touchfield.sources.terrain.height_scene import HeightScene

tum, redwood, sun3d, threedmatch, depth_folder, *_ = DEPTH_LAYOUTS
LAYOUTS: list[tuple[Layout, Callable[[Path], Path], SourceOptions]] = [
    (tum, make.write_tum, SourceOptions()),
    (redwood, make.write_redwood, SourceOptions()),
    (sun3d, make.write_sun3d, SourceOptions()),
    (threedmatch, make.write_threedmatch, SourceOptions()),
    (depth_folder, make.write_plain, SourceOptions(depth_scale=1000)),
]

IDS = [module.name for module, _, _ in LAYOUTS]

KINDS = [module.kind for module in (tum, redwood, sun3d, threedmatch, depth_folder)]

CAMERA = SourceOptions(frame="camera")


# -- layouts -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("module", "write", "options"), LAYOUTS, ids=IDS)
def test_a_layout_round_trips(
    tmp_path: Path, module: Layout, write: Callable, options: SourceOptions
) -> None:
    sequence = module.read_sequence(write(tmp_path / "s"), options)
    expected = make.depths_mm(sequence.frame_count) / 1000
    assert sequence.frame_count == (11 if module is depth_folder else make.FRAMES)
    assert (sequence.width, sequence.height) == (make.WIDTH, make.HEIGHT)
    assert sequence.intrinsics == Intrinsics(20, 21, 5.5, 4)
    for i in range(sequence.frame_count):
        depth = sequence.depth_m(i)
        assert depth.dtype == np.float32 and depth.flags.c_contiguous and depth.flags.writeable
        assert np.allclose(depth, expected[i], atol=1e-6)
    if module is depth_folder:
        assert sequence.poses is None
    else:
        assert np.allclose(sequence.poses, make.poses(), atol=1e-6)
        assert not sequence.poses.flags.writeable


@pytest.mark.parametrize(("module", "write", "options"), LAYOUTS, ids=IDS)
def test_each_layout_is_recognised_as_itself(
    tmp_path: Path, module: Layout, write: Callable, options: SourceOptions
) -> None:
    folder = write(tmp_path / "s")
    first = next(m for m in KINDS if m.recognise(folder))
    assert first.name == module.name
    assert not any(m.recognise(tmp_path / "nothing") for m in KINDS)
    other = make.write_png(tmp_path / "e" / "a.png", np.zeros((2, 2), np.uint16))
    assert not any(m.recognise(path) for m in KINDS for path in (other, other.parent))


@pytest.mark.parametrize(("module", "write", "options"), LAYOUTS, ids=IDS)
def test_only_the_requested_frame_is_decoded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: Layout, write: Callable, options: SourceOptions
) -> None:
    decoded: list[Path] = []

    def counting(path: Path) -> np.ndarray:
        decoded.append(path)
        return pictures.read_picture(path)

    sequence = module.read_sequence(write(tmp_path / "s"), options)
    monkeypatch.setattr(sequence.frames, "_read", counting)
    assert decoded == []
    sequence.depth_m(3)
    assert decoded == [sequence.frames.paths[3]]


FAULTS: dict[str, tuple[np.ndarray, str]] = {
    "8 bits": (np.zeros((make.HEIGHT, make.WIDTH), np.uint8), "16-bit"),
    "colour": (np.zeros((make.HEIGHT, make.WIDTH, 3), np.uint8), "RGB"),
    "size": (np.zeros((make.HEIGHT + 1, make.WIDTH), np.uint16), "12 x 10 pixels"),
}


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize(("module", "write", "options"), LAYOUTS, ids=IDS)
def test_a_wrong_picture_is_named_when_opening(
    tmp_path: Path, module: Layout, write: Callable, options: SourceOptions, fault: str
) -> None:
    folder = write(tmp_path / "s")
    victim = sorted(folder.rglob("*.png"))[2]
    values, message = FAULTS[fault]
    make.write_png(victim, values)
    with pytest.raises(SourceError, match=rf"{victim.name}.*{message}"):
        module.read_sequence(folder, options)


@pytest.mark.parametrize(("module", "write", "options"), LAYOUTS, ids=IDS)
def test_a_truncated_or_changed_picture_is_named_when_read(
    tmp_path: Path, module: Layout, write: Callable, options: SourceOptions
) -> None:
    sequence = module.read_sequence(write(tmp_path / "s"), options)
    path = sequence.frames.paths[1]
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(SourceError, match=f"{path.name}.*damaged"):
        sequence.depth_m(1)
    make.write_png(path, np.zeros((3, 3), np.uint16))
    with pytest.raises(SourceError, match=f"{path.name}.*3 x 3"):
        sequence.depth_m(1)
    path.unlink()
    with pytest.raises(SourceError, match=path.name):
        sequence.depth_m(1)
    with pytest.raises(InvalidArgument, match="frame"):
        sequence.depth_m(sequence.frame_count)


@pytest.mark.parametrize(("module", "write", "options"), LAYOUTS, ids=IDS)
def test_a_folder_without_depth_and_a_file_are_refused(
    tmp_path: Path, module: Layout, write: Callable, options: SourceOptions
) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").touch()
    for path in (tmp_path / "empty", tmp_path / "file"):
        with pytest.raises(SourceError, match=path.name):
            module.read_sequence(path, options)


@pytest.mark.parametrize(("module", "write", "options"), LAYOUTS, ids=IDS)
def test_error_of_missing_intrinsics_names_the_option(
    tmp_path: Path, module: Layout, write: Callable, options: SourceOptions
) -> None:
    folder = write(tmp_path / "s")
    for name in ("intrinsics.txt", "../camera-intrinsics.txt"):
        (folder / name).unlink(missing_ok=True)
    with pytest.raises(SourceError, match=r"--intrinsics fx,fy,cx,cy"):
        module.read_sequence(folder, options)


@pytest.mark.parametrize(("module", "write", "options"), LAYOUTS[:4], ids=IDS[:4])
def test_the_camera_frame_needs_no_poses(
    tmp_path: Path, module: Layout, write: Callable, options: SourceOptions
) -> None:
    folder = write(tmp_path / "s")
    for file in (*folder.rglob("*.log"), *folder.rglob("*.pose.txt"), folder / "groundtruth.txt"):
        file.write_text("no pose at all")
    for file in folder.rglob("extrinsics/*.txt"):
        file.write_text("1 2 3")
    with pytest.raises(SourceError):
        module.read_sequence(folder, options)
    sequence = module.read_sequence(folder, CAMERA)
    assert sequence.poses is None and sequence.frame_count == make.FRAMES


def test_values_for_unknown_depth() -> None:
    code = DepthCode(1000)
    assert code(np.array([0, 1, 65534, 65535], np.uint16)).tolist() == [
        0,
        np.float32(0.001),
        np.float32(65.534),
        0,
    ]
    floats = np.array([np.nan, np.inf, -np.inf, -1, 0, 1e300, 2500.0])
    assert code(floats).tolist() == [0, 0, 0, 0, 0, 0, 2.5]
    assert code(np.array([-5, 70000], np.int32)).tolist() == [0, 70]


@given(st.integers(0, 65534))
def test_rotated_bits_of_sun3d_round_trip(depth_mm: int) -> None:
    stored = np.array([(depth_mm << 3 | depth_mm >> 13) & 0xFFFF], np.uint16)
    metres = DepthCode(1000, is_rotated=True)(stored)
    assert metres[0] == np.float32(depth_mm / 1000)


# -- TUM ---------------------------------------------------------------------------------------------------


def test_tum_notes_missing_frames_and_derives_the_rate_from_time_stamps(tmp_path: Path) -> None:
    sequence = tum.read_sequence(make.write_tum(tmp_path / "s"), SourceOptions(rate_hz=7))
    assert sequence.rate_hz == pytest.approx(25, rel=1e-3)
    assert any("5 of the 7 frames" in note for note in sequence.notes)
    listing = tmp_path / "s" / "depth.txt"
    listing.write_text("\n".join(reversed(listing.read_text().splitlines())))
    (tmp_path / "s" / "depth" / "1305031233.580000.png").unlink()  # the third
    fewer = tum.read_sequence(tmp_path / "s", SourceOptions())
    assert fewer.rate_hz == pytest.approx(25, rel=1e-3)
    assert [np.array_equal(fewer.depth_m(i), sequence.depth_m(of)) for i, of in enumerate((0, 1, 3, 4))] == [
        True
    ] * 4


def test_tum_skips_a_frame_without_a_close_pose(tmp_path: Path) -> None:
    folder = make.write_tum(tmp_path / "s")
    lines = (folder / "groundtruth.txt").read_text().splitlines()
    (folder / "groundtruth.txt").write_text("\n".join(lines[:3] + lines[4:]))
    sequence = tum.read_sequence(folder, SourceOptions())
    assert sequence.frame_count == make.FRAMES - 1
    assert np.allclose(sequence.poses, np.delete(make.poses(), 2, 0), atol=1e-6)
    assert np.allclose(sequence.depth_m(2), make.depths_mm()[3] / 1000)
    assert any("1 of 5 frames left out: no pose within 20 ms" in note for note in sequence.notes)


@pytest.mark.parametrize(
    ("name", "fx"),
    [
        ("rgbd_fr1_desk", 517.3),
        ("rgbd_dataset_freiburg2_xyz", 520.9),
        ("fr3", 535.4),
        ("rgbd_bonn_box", 542.822841),
        ("living_room_traj1_frei_png", 481.2),
        ("fr1/fr3", 535.4),
        ("fr1st", None),
    ],
)
def test_tum_cameras_are_identified_by_name(tmp_path: Path, name: str, fx: float | None) -> None:
    folder = tmp_path / name / "run"
    make.write_png(folder / "depth" / "1.5.png", np.full((480, 640), 5000, np.uint16))
    if fx is None:
        with pytest.raises(SourceError, match="--intrinsics"):
            tum.read_sequence(folder, SourceOptions())
    else:
        sequence = tum.read_sequence(folder, SourceOptions())
        assert sequence.intrinsics.fx == fx
        assert any("published" in note for note in sequence.notes) and any(
            "assumed to be static" in n for n in sequence.notes
        )


@pytest.mark.parametrize(
    "line", ["1.0 ../other.png", "1.0 /etc/passwd", "1.0", "x depth/1.png", "inf depth/1.png"]
)
def test_tum_refuses_invalid_lines_of_its_list(tmp_path: Path, line: str) -> None:
    folder = make.write_tum(tmp_path / "s")
    with (folder / "depth.txt").open("a") as stream:
        stream.write(line + "\n")
    with pytest.raises(SourceError, match=r"depth.txt line 11"):
        tum.read_sequence(folder, SourceOptions())


# -- Redwood, SUN3D, 3DMatch, plain folders ----------------------------------------------------------------


def test_redwood_matches_by_number_if_the_trajectory_is_longer(tmp_path: Path) -> None:
    sequence = redwood.read_sequence(make.write_redwood(tmp_path / "a", entries=20, first=8), SourceOptions())
    assert np.allclose(sequence.poses, make.poses(20)[8:13], atol=1e-6)
    short = redwood.read_sequence(make.write_redwood(tmp_path / "b", entries=3), SourceOptions())
    assert short.frame_count == 3 and "2 of 5 frames left out" in short.notes[0]
    with pytest.raises(SourceError, match="no frame with a pose"):
        redwood.read_sequence(make.write_redwood(tmp_path / "c", entries=3, first=50), SourceOptions())


def test_redwood_notes_the_default_camera(tmp_path: Path) -> None:
    make.write_png(tmp_path / "depth" / "00000.png", np.full((480, 640), 1000, np.uint16))
    sequence = redwood.read_sequence(tmp_path, SourceOptions())
    assert sequence.intrinsics == Intrinsics(525, 525, 319.5, 239.5)
    assert any("PrimeSense" in note for note in sequence.notes)


def test_sun3d_matches_by_the_time_of_colour_frames(tmp_path: Path) -> None:
    sequence = sun3d.read_sequence(make.write_sun3d(tmp_path / "s", colour=8), SourceOptions())
    assert np.allclose(sequence.poses, make.poses(), atol=1e-6)
    assert sequence.rate_hz == pytest.approx(1 / 0.033)
    (tmp_path / "s" / "extrinsics" / "20131231235959.txt").write_text("older")
    for i in range(8):  # numbers in the reverse order of time
        file = tmp_path / "s" / "image" / f"{i + 1:07d}-{33000 * i + 4000:012d}.jpg"
        file.rename(file.with_name(f"{100 - i:07d}{file.name[7:]}"))
    make.write_matrix(
        tmp_path / "s" / "extrinsics" / "20140808220511.txt", make.poses(8)[::-1, :3].reshape(-1, 4)
    )
    assert np.allclose(sun3d.read_sequence(tmp_path / "s", SourceOptions()).poses, make.poses(), atol=1e-6)
    (tmp_path / "s" / "image" / "0000093-000000235000.jpg").unlink()
    with pytest.raises(SourceError, match="8 poses for 5 depth and 7 colour frames"):
        sun3d.read_sequence(tmp_path / "s", SourceOptions())


def test_an_option_overrides_the_scale_of_a_file_and_that_of_a_layout(
    tmp_path: Path,
) -> None:
    (tmp_path / "camera.json").write_text('{"fx": 20, "fy": 21, "cx": 5.5, "cy": 4, "depth_scale": 2000}')
    from_file = SourceOptions(intrinsics=str(tmp_path / "camera.json"))
    first, second = make.write_redwood(tmp_path / "a"), make.write_sun3d(tmp_path / "b")
    for module, path, options, units in (
        (redwood, first, from_file, 2000), (redwood, first, replace(from_file, depth_scale=4000), 4000),
        (sun3d, second, from_file, 1000),
    ):  # fmt: skip
        depth = module.read_sequence(path, options).depth_m(0)
        np.testing.assert_allclose(depth, make.depths_mm()[0] / units, rtol=1e-6)
    both = SourceOptions(source_rate_hz=10.0, rate_hz=20.0)
    assert redwood.read_sequence(first, both).rate_hz == 10.0


def test_3dmatch_skips_frames_without_tracking(tmp_path: Path) -> None:
    folder = make.write_threedmatch(tmp_path / "s")
    make.write_matrix(folder / "frame-000001.pose.txt", np.full((4, 4), np.nan))
    (folder / "frame-000003.pose.txt").unlink()
    sequence = threedmatch.read_sequence(folder, SourceOptions())
    assert np.allclose(sequence.poses, make.poses()[[0, 2, 4]], atol=1e-6)
    assert "2 of 5 frames left out" in sequence.notes[0]
    assert any("camera-intrinsics.txt" in note for note in sequence.notes)  # in the parent folder


def test_error_of_a_plain_folder_names_the_missing_options(tmp_path: Path) -> None:
    folder = make.write_plain(tmp_path / "s")
    with pytest.raises(SourceError, match="--depth-scale"):
        depth_folder.read_sequence(folder, SourceOptions())
    for i, pose in enumerate(make.poses(11)):
        make.write_matrix(folder / "pose" / f"{i}.txt", pose)
    sequence = depth_folder.read_sequence(folder, SourceOptions(depth_scale=1000, rate_hz=12))
    assert np.allclose(sequence.poses, make.poses(11), atol=1e-6)
    assert sequence.rate_hz == 12


# -- real sequences ----------------------------------------------------------------------------------------


@pytest.mark.shared
@pytest.mark.parametrize(
    ("module", "name", "warp_mm", "rate_hz"),
    [(tum, "rgbd_tum_fr1_rpy", 10.0, 30.2), (redwood, "rgbd_iclnuim_livingroom1", 2.0, 30.0)],
)
def test_a_real_sequence_is_consistent_over_ten_frames(
    shared_data: Path, module: Layout, name: str, warp_mm: float, rate_hz: float
) -> None:
    """The points of frame 0, projected into frame 10, agree with its depth: poses, scale and camera
    are right.
    """
    folder = shared_data / name
    assert next(m for m in KINDS if m.recognise(folder)).name == module.name
    sequence = module.read_sequence(folder, SourceOptions())
    assert sequence.frame_count == 24
    assert sequence.rate_hz == pytest.approx(rate_hz, abs=0.1)
    assert any("No intrinsics file" in note for note in sequence.notes)
    k, depth, target = sequence.intrinsics, sequence.depth_m(0), sequence.depth_m(10)
    v, u = np.nonzero(depth)
    z = depth[v, u].astype(float)
    points = np.stack([(u - k.cx) * z / k.fx, (v - k.cy) * z / k.fy, z, np.ones_like(z)])
    moved = np.linalg.inv(sequence.poses[10]) @ sequence.poses[0] @ points
    u2 = np.round(moved[0] / moved[2] * k.fx + k.cx).astype(int)
    v2 = np.round(moved[1] / moved[2] * k.fy + k.cy).astype(int)
    inside = (u2 >= 0) & (u2 < sequence.width) & (v2 >= 0) & (v2 < sequence.height)
    measured = target[v2[inside], u2[inside]]
    error = np.abs(measured - moved[2][inside])[measured > 0]
    assert 1000 * np.median(error) < warp_mm


# -- scenes ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("reading", "kind"), [("camera", DepthScene), ("height", HeightScene)])
def test_a_kind_opens_its_sequence_with_the_requested_reading(
    tmp_path: Path, reading: str, kind: type
) -> None:
    folder = make.write_threedmatch(tmp_path / "s")
    opened = threedmatch.kind.open(folder, SourceOptions(frame="camera", reading=reading))
    assert isinstance(opened, kind)
    assert opened.frame_count == make.FRAMES
    assert opened.is_solid == (reading == "height")
