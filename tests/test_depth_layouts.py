"""Depth pictures and sequences on disk: every layout read back, every fault one clear error."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image
from scipy.spatial.transform import Rotation

import depth_makers as make
from touchfield.errors import InvalidArgument, MissingExtra, SourceError
from touchfield.sources import intrinsics_file, inverse_depth, pictures, poses
from touchfield.sources.camera import DepthCode, Intrinsics
from touchfield.sources.depth_layouts import LAYOUTS as DEPTH_LAYOUTS
from touchfield.sources.depth_layouts import Layout
from touchfield.sources.depth_scene import DepthScene
from touchfield.sources.height_scene import HeightScene
from touchfield.sources.options import SourceOptions

tum, redwood, sun3d, threedmatch, depth_folder, depth_map, *_ = DEPTH_LAYOUTS

LAYOUTS: list[tuple[Layout, Callable[[Path], Path], SourceOptions]] = [
    (tum, make.write_tum, SourceOptions()),
    (redwood, make.write_redwood, SourceOptions()),
    (sun3d, make.write_sun3d, SourceOptions()),
    (threedmatch, make.write_threedmatch, SourceOptions()),
    (depth_folder, make.write_plain, SourceOptions(depth_scale=1000)),
]
IDS = [module.name for module, _, _ in LAYOUTS]
KINDS = [one.kind for one in (tum, redwood, sun3d, threedmatch, depth_folder)]
KINDS += [inverse_depth.KINDS["disparity"], depth_map.kind]
CAMERA = SourceOptions(frame="camera")


# -- pictures ------------------------------------------------------------------------------------------------------

shapes = hnp.array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=9)


@given(hnp.arrays(st.sampled_from([np.uint8, np.uint16]), shapes), st.sampled_from([".png", ".tif"]))
def test_integer_pictures_come_back(
    tmp_path_factory: pytest.TempPathFactory, values: np.ndarray, suffix: str
) -> None:
    path = tmp_path_factory.mktemp("p") / f"a{suffix}"
    Image.fromarray(values).save(path)
    read = pictures.read_picture(path)
    assert read.dtype == values.dtype
    assert np.array_equal(read, values)


@given(
    hnp.arrays(
        st.sampled_from(["<u2", ">u2", "<f4", ">f8", "<i4", "u1", "<f2"]), shapes, elements=st.integers(0, 99)
    ),
    st.booleans(),
)
def test_npy_pictures_come_back(
    tmp_path_factory: pytest.TempPathFactory, values: np.ndarray, is_fortran: bool
) -> None:
    path = tmp_path_factory.mktemp("p") / "a.npy"
    np.save(path, np.asfortranarray(values) if is_fortran else values)
    read = pictures.read_picture(path)
    assert np.array_equal(read, values)
    assert read.dtype.isnative and read.flags.c_contiguous and read.flags.writeable


def test_float_tiff_comes_back(tmp_path: Path) -> None:
    values = np.linspace(0, 3, 12, dtype=np.float32).reshape(3, 4)
    Image.fromarray(values).save(tmp_path / "a.tiff")
    assert np.array_equal(pictures.read_picture(tmp_path / "a.tiff"), values)
    assert pictures.picture_header(tmp_path / "a.tiff") == pictures.PictureHeader(4, 3, "float32", 1)


@pytest.mark.filterwarnings("ignore:Corrupt EXIF:UserWarning")
@pytest.mark.parametrize("suffix", [".png", ".npy", ".tif"])
def test_a_picture_cut_anywhere_is_a_source_error(tmp_path: Path, suffix: str) -> None:
    whole, cut = tmp_path / f"whole{suffix}", tmp_path / f"cut{suffix}"
    values = np.random.default_rng(1).integers(0, 65535, (6, 7)).astype(np.uint16)
    if suffix == ".npy":
        np.save(whole, values)
    else:
        Image.fromarray(values).save(whole)
    data = whole.read_bytes()
    needed = len(data) - (20 if suffix == ".png" else 0)  # without its checksums and last chunk all pixels are there
    for length in range(needed):
        cut.write_bytes(data[:length])
        with pytest.raises(SourceError, match="cut"):
            pictures.read_picture(cut)


@pytest.mark.filterwarnings("ignore::UserWarning")
@given(st.sampled_from([".png", ".npy", ".tif"]), st.integers(0, 400), st.integers(1, 255))
def test_a_flipped_byte_gives_an_array_or_a_source_error(
    tmp_path_factory: pytest.TempPathFactory, suffix: str, at: int, flip: int
) -> None:
    path = tmp_path_factory.mktemp("p") / f"a{suffix}"
    values = np.arange(42, dtype=np.uint16).reshape(6, 7) * 999
    if suffix == ".npy":
        np.save(path, values)
    else:
        Image.fromarray(values).save(path)
    data = bytearray(path.read_bytes())
    data[at % len(data)] ^= flip
    path.write_bytes(bytes(data))
    with suppress(SourceError):
        assert pictures.read_picture(path).ndim == 2


def _png_of(width: int, height: int) -> bytes:
    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    head = struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)
    body = zlib.compress(bytes(1000))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", body) + chunk(b"IEND", b"")


@pytest.mark.parametrize(
    ("width", "height", "words"), [(60000, 60000, "at most"), (8000, 8000, "in .* bytes"), (0, 5, "at least one")]
)
def test_a_bomb_is_refused_from_its_header(tmp_path: Path, width: int, height: int, words: str) -> None:
    path = tmp_path / "bomb.png"
    path.write_bytes(_png_of(width, height))
    with pytest.raises(SourceError, match=words):
        pictures.read_picture(path)


@pytest.mark.parametrize("dtype", ["O", "<c8", "<U4", [("a", "<f4")]])
def test_an_npy_of_something_else_than_numbers_is_refused(tmp_path: Path, dtype: object) -> None:
    np.save(tmp_path / "a.npy", np.zeros((2, 2), dtype), allow_pickle=True)  # type: ignore[call-overload]
    with pytest.raises(SourceError, match="numbers"):
        pictures.read_picture(tmp_path / "a.npy")


def test_an_npy_that_claims_more_than_it_holds_is_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.zeros((2, 2), np.float64))
    data = (tmp_path / "a.npy").read_bytes().replace(b"(2, 2), }      ", b"(8000, 8000), }")
    assert b"8000" in data
    (tmp_path / "a.npy").write_bytes(data)
    with pytest.raises(SourceError, match=r"8000.* bytes"):
        pictures.read_picture(tmp_path / "a.npy")


# -- poses ---------------------------------------------------------------------------------------------------------

unit = st.floats(-1, 1)


@given(st.tuples(unit, unit, unit, unit).filter(lambda q: np.linalg.norm(q) > 0.1))
def test_quaternions_agree_with_scipy(q: tuple[float, float, float, float]) -> None:
    normal = np.array([q]) / np.linalg.norm(q)
    ours = poses.quaternion_poses(normal, np.zeros((1, 3)), "q")[:, :3, :3]
    assert np.allclose(ours, Rotation.from_quat(normal).as_matrix(), atol=1e-12)


@given(st.tuples(unit, unit, unit), st.integers(0, 2**32 - 1))
def test_a_rounded_rotation_is_made_exact_and_stays_near(turn: tuple[float, float, float], seed: int) -> None:
    exact = Rotation.from_rotvec(turn).as_matrix()
    noise = np.random.default_rng(seed).uniform(-1e-3, 1e-3, (3, 3))
    given_pose = np.column_stack([exact + noise, [1.0, 2.0, 3.0]])[None]
    made = poses.checked_poses(given_pose, "p")[0]
    assert np.allclose(made[:3, :3].T @ made[:3, :3], np.eye(3), atol=1e-12)
    assert np.abs(made[:3, :3] - exact).max() < 3e-3
    assert made[:3, 3].tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize(
    ("matrix", "words"),
    [
        (np.diag([1.1, 1, 1, 1]), "no rotation"),
        (np.diag([1.0, 1, -1, 1]), "mirrors"),
        (np.full((4, 4), np.nan), "not finite"),
        (np.diag([1.0, 1, 1, 2]), "last row"),
        (np.zeros((4, 4)), "last row"),
    ],
)
def test_what_is_no_pose_is_refused_by_its_number(matrix: np.ndarray, words: str) -> None:
    with pytest.raises(SourceError, match=rf"log, pose 1: .*{words}"):
        poses.checked_poses(np.stack([np.eye(4), matrix]), "log")


@given(
    st.lists(st.integers(0, 1000), max_size=20, unique=True), st.lists(st.integers(0, 1000), max_size=20),
    st.integers(0, 60),
)  # fmt: skip
def test_nearest_in_time_is_what_brute_force_finds(times: list[int], wanted: list[int], tolerance: int) -> None:
    known, asked = np.array(sorted(times), float), np.array(wanted, float)
    found = poses.nearest_in_time(known, asked, tolerance)
    for t, i in zip(asked, found):
        best = min(np.abs(known - t), default=np.inf)
        assert (i == -1) if best > tolerance else abs(known[i] - t) == best


@pytest.mark.parametrize("text", ["1 2 3", "1 2 3 4 5 6 7 x", "", "0 0 0 0 0 0 0 0", "nan 0 0 0 0 0 0 1"])
def test_a_bad_groundtruth_is_a_source_error(text: str) -> None:
    with pytest.raises(SourceError, match="truth"):
        poses.parse_poses(text, "truth")


@pytest.mark.parametrize("number", ["-1", "0.5", "nan", "1e300"])
def test_a_log_of_matrices_counts_its_frames_from_zero(number: str) -> None:
    rows = "\n".join(["1 0 0 0", "0 1 0 0", "0 0 1 0", "0 0 0 1"])
    assert poses.parse_poses(f"0 0 1\n{rows}\n", "log").numbers.tolist() == [0]
    with pytest.raises(SourceError, match=r"no frame number|not finite"):
        poses.parse_poses(f"{number} 0 1\n{rows}\n", "log")


@given(st.text(alphabet="0123456789.-+eE \n,#naif", max_size=80))
def test_no_text_of_poses_raises_anything_else(text: str) -> None:
    for parse in (poses.parse_poses, poses.parse_extrinsics):
        with pytest.raises(SourceError):
            parse(text, "where")


# -- intrinsics ----------------------------------------------------------------------------------------------------

FORMS = {
    "one line": "20 21 5.5 4",
    "commas": "20,21,5.5,4",
    "3x3": "20 0 5.5\n0 21 4\n0 0 1\n",
    "4x4": "20 0 5.5 0\n0 21 4 0\n0 0 1 0\n0 0 0 1",
    "commented": "# camera\n20 0 5.5\n0 21 4 # y\n0 0 1",
    "open3d": json.dumps({"width": 12, "height": 9, "intrinsic_matrix": [20, 0, 0, 0, 21, 0, 5.5, 4, 1]}),
    "open3d parameters": json.dumps({"intrinsic": {"intrinsic_matrix": [20, 0, 0, 0, 21, 0, 5.5, 4, 1]}}),
    "named": json.dumps({"fx": 20, "fy": 21, "cx": 5.5, "cy": 4}),
}


@pytest.mark.parametrize("text", FORMS.values(), ids=FORMS)
def test_all_forms_of_intrinsics_are_read(tmp_path: Path, text: str) -> None:
    (tmp_path / "k").write_text(text)
    wanted = Intrinsics(20, 21, 5.5, 4)
    assert intrinsics_file.parse_intrinsics(text, "k", (12, 9)).intrinsics == wanted
    assert intrinsics_file.camera_of("s", str(tmp_path / "k"), (), (12, 9)).intrinsics == wanted


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("20 21 5.5", "3 numbers"),
        ("20 x 5 4", "20 x 5 4"),
        ("-20 21 5 4", "fx = -20"),
        ("20 21 nan 4", "cx = nan"),
        ("20 0 0 0 21 0 5.5 4 1", "no skew"),
        ("20 3 5 0 21 4 0 0 1", "no skew"),
        ('{"intrinsic_matrix": [1, 2]}', "2 numbers"),
        ('{"width": 640, "height": 480, "fx": 1, "fy": 1, "cx": 1, "cy": 1}', "640 x 480"),
        ('{"fx": 1', "JSON"),
        ('{"fx": "a"}', "without numbers"),
    ],
)
def test_bad_intrinsics_name_file_and_fault(text: str, words: str) -> None:
    with pytest.raises(SourceError, match=f"k.txt.*{words}"):
        intrinsics_file.parse_intrinsics(text, "k.txt", (12, 9))


@pytest.mark.parametrize("asked", ["1,2,3", "nothing/there.txt", "1,2,3,x", "0,1,2,3", "", "\0", "a" * 5000])
def test_intrinsics_that_are_neither_numbers_nor_a_file(asked: str) -> None:
    with pytest.raises(InvalidArgument, match="--intrinsics"):
        intrinsics_file.camera_of("s", asked, (), (12, 9))


# -- layouts -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("module", "write", "options"), LAYOUTS, ids=IDS)
def test_a_layout_comes_back(tmp_path: Path, module: Layout, write: Callable, options: SourceOptions) -> None:
    sequence = module.read_sequence(write(tmp_path / "s"), options)
    wanted = make.depths_mm(sequence.frame_count) / 1000
    assert sequence.frame_count == (11 if module is depth_folder else make.FRAMES)
    assert (sequence.width, sequence.height) == (make.WIDTH, make.HEIGHT)
    assert sequence.intrinsics == Intrinsics(20, 21, 5.5, 4)
    for i in range(sequence.frame_count):
        depth = sequence.depth_m(i)
        assert depth.dtype == np.float32 and depth.flags.c_contiguous and depth.flags.writeable
        assert np.allclose(depth, wanted[i], atol=1e-6)
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
def test_only_the_frame_asked_for_is_decoded(
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
    values, words = FAULTS[fault]
    make.write_png(victim, values)
    with pytest.raises(SourceError, match=rf"{victim.name}.*{words}"):
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
def test_missing_intrinsics_are_asked_for(
    tmp_path: Path, module: Layout, write: Callable, options: SourceOptions
) -> None:
    folder = write(tmp_path / "s")
    for name in ("intrinsics.txt", "camera-intrinsics.txt"):
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


def test_values_that_mean_unknown() -> None:
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
def test_suns_rotated_bits_come_back(depth_mm: int) -> None:
    stored = np.array([(depth_mm << 3 | depth_mm >> 13) & 0xFFFF], np.uint16)
    metres = DepthCode(1000, is_rotated=True)(stored)
    assert metres[0] == np.float32(depth_mm / 1000)


# -- TUM -----------------------------------------------------------------------------------------------------------


def test_tum_says_what_is_missing_and_takes_the_rate_from_the_stamps(tmp_path: Path) -> None:
    sequence = tum.read_sequence(make.write_tum(tmp_path / "s"), SourceOptions(rate_hz=7))
    assert sequence.rate_hz == pytest.approx(25, rel=1e-3)
    assert any("5 of the 7 frames" in note for note in sequence.notes)


def test_tum_leaves_out_a_frame_whose_pose_is_too_far_in_time(tmp_path: Path) -> None:
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
    [("rgbd_fr1_desk", 517.3), ("rgbd_dataset_freiburg2_xyz", 520.9), ("fr3", 535.4), ("rgbd_bonn_box", 542.822841),
     ("living_room_traj1_frei_png", 481.2),
     ("fr1st", None)],
)  # fmt: skip
def test_tum_knows_its_cameras_by_name(tmp_path: Path, name: str, fx: float | None) -> None:
    folder = tmp_path / name / "run"
    make.write_png(folder / "depth" / "1.5.png", np.full((480, 640), 5000, np.uint16))
    if fx is None:
        with pytest.raises(SourceError, match="--intrinsics"):
            tum.read_sequence(folder, SourceOptions())
    else:
        sequence = tum.read_sequence(folder, SourceOptions())
        assert sequence.intrinsics.fx == fx
        assert any("published" in note for note in sequence.notes) and any("stand still" in n for n in sequence.notes)


@pytest.mark.parametrize("line", ["1.0 ../other.png", "1.0 /etc/passwd", "1.0", "x depth/1.png", "inf depth/1.png"])
def test_tum_refuses_strange_lines_of_its_list(tmp_path: Path, line: str) -> None:
    folder = make.write_tum(tmp_path / "s")
    with (folder / "depth.txt").open("a") as stream:
        stream.write(line + "\n")
    with pytest.raises(SourceError, match=r"depth.txt line 11"):
        tum.read_sequence(folder, SourceOptions())


# -- Redwood, SUN3D, 3DMatch, plain folders ------------------------------------------------------------------------


def test_redwood_goes_by_the_numbers_where_the_trajectory_lists_more(tmp_path: Path) -> None:
    sequence = redwood.read_sequence(make.write_redwood(tmp_path / "a", entries=20, first=8), SourceOptions())
    assert np.allclose(sequence.poses, make.poses(20)[8:13], atol=1e-6)
    short = redwood.read_sequence(make.write_redwood(tmp_path / "b", entries=3), SourceOptions())
    assert short.frame_count == 3 and "2 of 5 frames left out" in short.notes[0]
    with pytest.raises(SourceError, match="no frame with a pose"):
        redwood.read_sequence(make.write_redwood(tmp_path / "c", entries=3, first=50), SourceOptions())


def test_redwood_says_that_it_takes_the_primesense_default(tmp_path: Path) -> None:
    make.write_png(tmp_path / "depth" / "00000.png", np.full((480, 640), 1000, np.uint16))
    sequence = redwood.read_sequence(tmp_path, SourceOptions())
    assert sequence.intrinsics == Intrinsics(525, 525, 319.5, 239.5)
    assert any("PrimeSense" in note for note in sequence.notes)


def test_sun3d_goes_by_the_colour_frames_and_their_time(tmp_path: Path) -> None:
    sequence = sun3d.read_sequence(make.write_sun3d(tmp_path / "s", colour=8), SourceOptions())
    assert np.allclose(sequence.poses, make.poses(), atol=1e-6)
    assert sequence.rate_hz == pytest.approx(1 / 0.033)
    (tmp_path / "s" / "image" / "0000008-000000235000.jpg").unlink()
    with pytest.raises(SourceError, match="8 poses for 5 depth and 7 colour frames"):
        sun3d.read_sequence(tmp_path / "s", SourceOptions())


def test_3dmatch_leaves_out_lost_frames(tmp_path: Path) -> None:
    folder = make.write_threedmatch(tmp_path / "s")
    make.write_matrix(folder / "seq-01" / "frame-000001.pose.txt", np.full((4, 4), np.nan))
    (folder / "seq-01" / "frame-000003.pose.txt").unlink()
    sequence = threedmatch.read_sequence(folder, SourceOptions())
    assert np.allclose(sequence.poses, make.poses()[[0, 2, 4]], atol=1e-6)
    assert "2 of 5 frames left out" in sequence.notes[0]
    direct = threedmatch.read_sequence(folder / "seq-01", SourceOptions())
    assert direct.intrinsics == sequence.intrinsics


def test_a_plain_folder_says_what_it_needs(tmp_path: Path) -> None:
    folder = make.write_plain(tmp_path / "s")
    with pytest.raises(SourceError, match="--depth-scale"):
        depth_folder.read_sequence(folder, SourceOptions())
    for i, pose in enumerate(make.poses(11)):
        make.write_matrix(folder / "pose" / f"{i}.txt", pose)
    sequence = depth_folder.read_sequence(folder, SourceOptions(depth_scale=1000, rate_hz=12))
    assert np.allclose(sequence.poses, make.poses(11), atol=1e-6)
    assert sequence.rate_hz == 12


# -- one picture ---------------------------------------------------------------------------------------------------


def test_a_depth_map_of_each_kind(tmp_path: Path) -> None:
    mm = make.depths_mm()[0]
    metres = (mm / 1000).astype(np.float32)
    np.save(tmp_path / "depth.npy", metres)
    Image.fromarray(metres).save(tmp_path / "depth.tif")
    make.write_png(tmp_path / "my_depth.png", mm)
    for name, scale in (("depth.npy", None), ("depth.tif", None), ("my_depth.png", 1000.0)):
        options = SourceOptions(intrinsics="20,21,5.5,4", depth_scale=scale)
        assert depth_map.kind.recognise(tmp_path / name)
        sequence = depth_map.read_sequence(tmp_path / name, options)
        assert sequence.frame_count == 1
        assert np.allclose(sequence.depth_m(0), metres)
    assert not depth_map.kind.recognise(make.write_png(tmp_path / "heights.png", mm))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (SourceOptions(intrinsics="20,21,5.5,4"), "--depth-scale"),
        (SourceOptions(depth_scale=1000), "--intrinsics fx,fy,cx,cy"),
    ],
)
def test_a_depth_map_says_what_it_needs(tmp_path: Path, options: SourceOptions, words: str) -> None:
    path = make.write_png(tmp_path / "depth.png", make.depths_mm()[0])
    with pytest.raises(SourceError, match=rf"depth\.png.*{words}"):
        depth_map.read_sequence(path, options)
    with pytest.raises(SourceError, match="depth-folder"):
        depth_map.read_sequence(tmp_path, options)


# -- disparity -----------------------------------------------------------------------------------------------------

RIG = SourceOptions(intrinsics="100,100,5.5,4", baseline_m=0.2, disparity_offset_px=2.0)


def _disparities() -> tuple[np.ndarray, np.ndarray]:
    """Disparities in pixels, and the depths in metres that they mean with `RIG`."""
    disparity_px = np.linspace(2, 40, make.WIDTH * make.HEIGHT).reshape(make.HEIGHT, make.WIDTH).astype(np.float32)
    disparity_px = np.round(disparity_px * 256) / 256
    depth = 100 * 0.2 / (disparity_px + 2.0)
    disparity_px[0, :3], depth[0, :3] = (0, 0, 0), 0
    return disparity_px.astype(np.float32), depth


def test_a_disparity_map_in_each_format(tmp_path: Path) -> None:
    disparity_px, depth = _disparities()
    np.save(tmp_path / "disp.npy", np.where(disparity_px == 0, np.inf, disparity_px))
    np.savez_compressed(
        tmp_path / "disp.npz", other=np.zeros(3), disp=np.where(disparity_px == 0, np.nan, disparity_px)
    )
    make.write_pfm(tmp_path / "disp.pfm", np.where(disparity_px == 0, np.inf, disparity_px))
    make.write_pfm(tmp_path / "disp_big.pfm", disparity_px, ">")
    make.write_png(tmp_path / "disp.png", np.round(disparity_px * 256).astype(np.uint16))
    for name in ("disp.npy", "disp.npz", "disp.pfm", "disp_big.pfm", "disp.png"):
        assert inverse_depth.KINDS["disparity"].recognise(tmp_path / name)
        sequence = inverse_depth.read_disparity(tmp_path / name, RIG)
        read = sequence.depth_m(0)
        assert read.dtype == np.float32 and read.flags.writeable
        assert np.allclose(read, depth, rtol=1e-6)
        assert np.array_equal(read == 0, depth == 0)


def test_middleburys_calibration_beside_the_map_is_used(tmp_path: Path) -> None:
    disparity_px, depth = _disparities()
    path = make.write_pfm(tmp_path / "disp0.pfm", disparity_px)
    calibration = (
        "cam0=[100 0 5.5; 0 100 4; 0 0 1]\ncam1=[100 0 7.5; 0 100 4; 0 0 1]\n"
        "doffs=2\nbaseline=200\nwidth=12\nheight=9\nndisp=60\n"
    )
    (tmp_path / "calib.txt").write_text(calibration)
    sequence = inverse_depth.read_disparity(path, SourceOptions())
    assert sequence.intrinsics == Intrinsics(100, 100, 5.5, 4)
    assert np.allclose(sequence.depth_m(0), depth, rtol=1e-6)
    other = inverse_depth.read_disparity(path.rename(tmp_path / "disp1.pfm"), SourceOptions(baseline_m=0.4))
    assert other.intrinsics.cx == 7.5
    assert np.allclose(other.depth_m(0), 2 * depth, rtol=1e-6)
    for bad in (calibration.replace("width=12", "width=13"), calibration.replace("baseline=200", "baseline=-1"), "x"):
        (tmp_path / "calib.txt").write_text(bad)
        with pytest.raises(SourceError, match=r"calib\.txt"):
            inverse_depth.read_disparity(tmp_path / "disp1.pfm", SourceOptions())


@pytest.mark.parametrize("name", ["disp.npz", "disp.pfm"])
def test_a_disparity_map_cut_anywhere_is_a_source_error(tmp_path: Path, name: str) -> None:
    disparity_px, _ = _disparities()
    if name.endswith("npz"):
        np.savez_compressed(tmp_path / name, disparity_px)
    else:
        make.write_pfm(tmp_path / name, disparity_px)
    data = (tmp_path / name).read_bytes()
    for length in range(0, len(data), 3):
        (tmp_path / name).write_bytes(data[:length])
        with pytest.raises(SourceError, match="disp"):
            inverse_depth.read_disparity(tmp_path / name, RIG)


@given(st.integers(0, 2000), st.integers(1, 255))
def test_a_flipped_byte_of_an_npz_is_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, at: int, flip: int
) -> None:
    path = tmp_path_factory.mktemp("n") / "disp.npz"
    np.savez_compressed(path, np.arange(1, 400, dtype=np.float32).reshape(19, 21))
    data = bytearray(path.read_bytes())
    data[at % len(data)] ^= flip
    path.write_bytes(bytes(data))
    with suppress(SourceError):
        sequence = inverse_depth.read_disparity(path, RIG)
        assert sequence.width * sequence.height <= 399


def test_what_a_disparity_map_needs(tmp_path: Path) -> None:
    disparity_px, _ = _disparities()
    path = make.write_pfm(tmp_path / "disp.pfm", disparity_px)
    with pytest.raises(SourceError, match="--intrinsics fx"):
        inverse_depth.read_disparity(path, SourceOptions(baseline_m=0.2))
    with pytest.raises(SourceError, match="--baseline-m"):
        inverse_depth.read_disparity(path, SourceOptions(intrinsics="1,1,0,0"))
    with pytest.raises(SourceError, match="no disparity above 0"):
        inverse_depth.read_disparity(make.write_pfm(tmp_path / "disp2.pfm", np.full((3, 3), np.inf)), RIG)
    with pytest.raises(SourceError, match="8-bit"):
        inverse_depth.read_disparity(make.write_png(tmp_path / "disp.png", np.zeros((3, 3), np.uint8)), RIG)
    (tmp_path / "disp_rgb.pfm").write_bytes(b"PF\n1 1\n-1\n" + bytes(12))
    with pytest.raises(SourceError, match="grey PFM"):
        inverse_depth.read_disparity(tmp_path / "disp_rgb.pfm", RIG)


def test_a_larger_offset_brings_the_scene_nearer() -> None:
    k = Intrinsics(100, 100, 0, 0)
    d = np.array([-5, 0, 1, 5, 50.0])
    near = inverse_depth.depth_of_disparity(d, inverse_depth.StereoRig(k, 0.2, 3.0))
    far = inverse_depth.depth_of_disparity(d, inverse_depth.StereoRig(k, 0.2))
    behind = inverse_depth.depth_of_disparity(d, inverse_depth.StereoRig(k, 0.2, -5.0))
    assert near[:2].tolist() == far[:2].tolist() == [0, 0]
    assert (near[2:] < far[2:]).all()
    assert behind.tolist() == [0, 0, 0, 0, np.float32(100 * 0.2 / 45)]


def test_the_motorcycle_is_between_two_and_five_metres(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("skimage", reason="scikit-image is an optional extra")
    sequence = inverse_depth.motorcycle_sequence()
    depth = sequence.depth_m(0)
    known = depth[depth > 0]
    assert (sequence.width, sequence.height) == (741, 500)
    assert 2.0 < known.min() < 2.3 and 4.8 < known.max() < 5.2
    assert 0.90 < known.size / depth.size < 0.95

    def absent(name: str) -> ModuleType:
        raise ModuleNotFoundError(name)

    monkeypatch.setattr("touchfield.errors.import_module", absent)
    with pytest.raises(MissingExtra, match=r"touchfield\[motorcycle\]"):
        inverse_depth.motorcycle_sequence()


# -- real sequences ------------------------------------------------------------------------------------------------


@pytest.mark.shared
@pytest.mark.parametrize(
    ("module", "name", "warp_mm", "rate_hz"),
    [(tum, "rgbd_tum_fr1_rpy", 10.0, 30.2), (redwood, "rgbd_iclnuim_livingroom1", 2.0, 30.0)],
)
def test_a_real_sequence_agrees_with_itself_after_ten_frames(
    shared_data: Path, module: Layout, name: str, warp_mm: float, rate_hz: float
) -> None:
    """The points of frame 0, seen from frame 10, lie where frame 10 measures them: poses, scale, camera are right."""
    folder = shared_data / name
    assert next(m for m in KINDS if m.recognise(folder)).name == module.name
    sequence = module.read_sequence(folder, SourceOptions())
    assert sequence.frame_count == 24
    assert sequence.rate_hz == pytest.approx(rate_hz, abs=0.1)
    assert any("No intrinsics file" in note for note in sequence.notes)
    k, depth, seen = sequence.intrinsics, sequence.depth_m(0), sequence.depth_m(10)
    v, u = np.nonzero(depth)
    z = depth[v, u].astype(float)
    points = np.stack([(u - k.cx) * z / k.fx, (v - k.cy) * z / k.fy, z, np.ones_like(z)])
    moved = np.linalg.inv(sequence.poses[10]) @ sequence.poses[0] @ points
    u2 = np.round(moved[0] / moved[2] * k.fx + k.cx).astype(int)
    v2 = np.round(moved[1] / moved[2] * k.fy + k.cy).astype(int)
    inside = (u2 >= 0) & (u2 < sequence.width) & (v2 >= 0) & (v2 < sequence.height)
    measured = seen[v2[inside], u2[inside]]
    error = np.abs(measured - moved[2][inside])[measured > 0]
    assert 1000 * np.median(error) < warp_mm


# -- scenes --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("reading", "kind"), [("camera", DepthScene), ("height", HeightScene)])
def test_a_kind_opens_its_sequence_in_the_reading_asked_for(tmp_path: Path, reading: str, kind: type) -> None:
    folder = make.write_threedmatch(tmp_path / "s")
    opened = threedmatch.kind.open(folder, SourceOptions(frame="camera", reading=reading))
    assert isinstance(opened, kind)
    assert opened.frame_count == make.FRAMES
    assert opened.is_solid == (reading == "height")
