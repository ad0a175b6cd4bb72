"""Notes of a source: their figures, and the assumptions where a file states nothing."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import depth_makers as make
from mesh_makers import cube, together
from touchfield.errors import InvalidArgument, SourceError
from touchfield.sources.camera import DepthSequence, InterpolatedSequence, Intrinsics
from touchfield.sources.depth import layouts
from touchfield.sources.depth.fused_scene import DRIFT_FACTOR, FusedScene, _World
from touchfield.sources.depth.intrinsics_file import camera_of, parse_intrinsics
from touchfield.sources.depth.lens import undistortion
from touchfield.sources.depth.segmentation import SegmentRule, segmented_bodies
from touchfield.sources.mesh.mesh_scene import MeshScene
from touchfield.sources.options import SourceOptions
from touchfield.sources.scene import size_note
from touchfield.sources.terrain.height_files import KIND
from touchfield.sources.terrain.height_map import PICTURE_RELIEF, degree_m
from touchfield.sources.terrain.height_scene import HeightScene

TUM = layouts.LAYOUTS[0]


class Flat(DepthSequence):
    """A plane before a camera with unequal axes; every other pixel of some frames is unknown."""

    name, rate_hz, notes = "flat", 25.0, ("a note",)
    width, height, intrinsics = 12, 8, Intrinsics(10.0, 16.0, 5.0, 4.5)

    def __init__(self, frames: int = 1, depth_m: float = 3.0) -> None:
        self.frame_count, self._depth_m = frames, depth_m

    def depth_m(self, frame: int) -> np.ndarray:
        return np.full((self.height, self.width), self._depth_m, np.float32)


# -- cameras
# --------------------------------------------------------------------------------------------------------


def test_note_of_a_camera_scaled_from_another_resolution() -> None:
    """Pixel centres are at one half there, and at integers here; an aspect ratio may differ by 1 %."""
    camera = parse_intrinsics("1 PINHOLE 2000 1000 400 420 900 480", "a/cameras.txt", (100, 50))
    assert camera.intrinsics == Intrinsics(20, 21, 900 / 20 - 0.5, 480 / 20 - 0.5)
    assert camera.notes == ("cameras.txt is for 2000 x 1000 pixels: scaled to the depth's.",)
    nearly = parse_intrinsics("1 PINHOLE 2000 1009 400 420 900 480", "cameras.txt", (100, 50)).intrinsics
    assert (nearly.fy, nearly.cy) == pytest.approx((420 * 50 / 1009, 480 * 50 / 1009 - 0.5))
    with pytest.raises(
        SourceError, match=r"found a camera of 2000 x 1011 pixels; expected the aspect .*100 x 50"
    ):
        parse_intrinsics("1 PINHOLE 2000 1011 400 420 900 480", "cameras.txt", (100, 50))
    same_size = parse_intrinsics("1 PINHOLE 100 50 20 21 45 24", "cameras.txt", (100, 50))
    assert same_size.intrinsics == Intrinsics(20, 21, 44.5, 23.5) and same_size.notes == ()
    simple = parse_intrinsics("1 SIMPLE_PINHOLE 100 50 20 45 24", "cameras.txt", (100, 50))
    assert simple.intrinsics == Intrinsics(20, 20, 44.5, 23.5)
    with pytest.raises(SourceError, match="found a camera SIMPLE_PINHOLE of 4 numbers"):
        parse_intrinsics("1 SIMPLE_PINHOLE 100 50 20 21 45 24", "cameras.txt", (100, 50))


def test_note_of_a_nerfstudio_camera_states_its_distortion() -> None:
    pytest.importorskip("cv2")
    camera = {"w": 200, "h": 100, "fl_x": 40.0, "fl_y": 42.0, "cx": 90.0, "cy": 48.0, "frames": []}
    plain = parse_intrinsics(json.dumps(camera), "transforms.json", (100, 50))
    assert plain.intrinsics == Intrinsics(20, 21, 44.5, 23.5)
    assert plain.notes == ("transforms.json is for 200 x 100 pixels: scaled to the depth's.",)
    for key in ("k1", "k2", "p1", "p2"):
        bent = parse_intrinsics(json.dumps(camera | {key: 0.01}), "transforms.json", (100, 50))
        assert bent.intrinsics == plain.intrinsics
        assert bent.distortion is not None and bent.distortion.where == "transforms.json"
        _, notes = undistortion(bent.lens, (100, 50))
        assert notes[-1].startswith("The lens distortion in transforms.json (brown: ")
        assert " is undone: it moves pixels by up to " in notes[-1]


def test_note_states_the_file_of_a_camera(tmp_path: Path) -> None:
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "K.txt").write_text("20 0 5.5\n0 -21 4\n0 0 1")
    camera = camera_of("s", None, (tmp_path, tmp_path / "b"), (12, 9))
    assert camera.notes == (
        "The camera is that of K.txt.", "fy is negative: y of the camera and of its poses is turned over."
    )  # fmt: skip
    assert camera.intrinsics == Intrinsics(20, 21, 5.5, 4) and camera.is_mirrored
    (tmp_path / "intrinsics.txt").write_text("30 31 5 4")  # an earlier folder takes precedence
    assert camera_of("s", None, (tmp_path, tmp_path / "b"), (12, 9)).intrinsics.fx == 30
    assert camera_of("s", "40,41,6,5", (tmp_path,), (12, 9)).intrinsics == Intrinsics(40, 41, 6, 5)
    with pytest.raises(SourceError, match="s: found no camera intrinsics"):
        camera_of("s", None, (), (12, 9))


@pytest.mark.parametrize("name", ["fx", "fy", "cx", "cy"])
def test_a_camera_of_no_number_is_refused_by_its_name(name: str) -> None:
    numbers = {"fx": 1e-3, "fy": 2.0, "cx": -7.0, "cy": 0.0}
    assert Intrinsics(**numbers).cx == -7
    for wrong in (np.nan, np.inf, *((0.0, -1.0) if name[0] == "f" else ())):
        with pytest.raises(InvalidArgument, match=f"intrinsics: found {name} = {wrong}"):
            Intrinsics(**(numbers | {name: wrong}))


@pytest.mark.parametrize(
    ("folder", "camera", "numbers"),
    [  # as published by their authors
        ("fr1_desk", "freiburg1", (517.3, 516.5, 318.6, 255.3)),
        ("fr2_xyz", "freiburg2", (520.9, 521.0, 325.1, 249.7)),
        ("freiburg3_office", "freiburg3", (535.4, 539.2, 320.1, 247.6)),
        ("bonn_box", "bonn", (542.822841, 542.576870, 315.593520, 237.756098)),
        ("office_traj2", "icl", (481.2, 480.0, 319.5, 239.5)),
    ],
)
def test_a_published_camera_is_used_and_noted(
    tmp_path: Path, folder: str, camera: str, numbers: tuple[float, ...]
) -> None:
    make.write_png(tmp_path / folder / "depth" / "1.5.png", np.full((480, 640), 5000, np.uint16))
    sequence = TUM.read_sequence(tmp_path / folder, SourceOptions())
    assert sequence.intrinsics == Intrinsics(*numbers)
    text = ", ".join(map(str, numbers))
    assert f"No intrinsics file: the published ones of {camera}, {text}, are used." in sequence.notes


def test_note_counts_missing_pictures_of_a_list(tmp_path: Path) -> None:
    folder = make.write_tum(tmp_path / "tum")
    listing, file_count = (folder / "depth.txt").read_text(), len(list((folder / "depth").iterdir()))
    listed = sum(not line.startswith("#") for line in listing.splitlines() if line.strip())
    (folder / "depth.txt").write_text(listing + "1e6 depth/gone.png\n1e7 depth/lost.png\n")
    sequence = TUM.read_sequence(folder, SourceOptions(frame="camera"))
    assert sequence.frame_count == file_count
    assert f"{file_count} of the {listed + 2} frames in depth.txt are there." in sequence.notes


# -- frames in time
# -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("rate_hz", "keys"), [(100.0, [0, 4, 8, 12]), (25.0, [0, 1, 2, 3]), (10.0, [0, 1])])
def test_key_frames_are_those_nearest_to_the_pictures(rate_hz: float, keys: list[int]) -> None:
    assert list(Flat(4).key_frames()) == [0, 1, 2, 3]
    assert list(InterpolatedSequence(Flat(4), rate_hz).key_frames()) == keys


def test_a_rate_of_too_many_frames_is_refused_with_its_figures() -> None:
    message = r"found 1e\+09 Hz: 1\.6e\+08 frames of 4 at 25 Hz; expected at most \d+ frames"
    with pytest.raises(InvalidArgument, match=message):
        InterpolatedSequence(Flat(4), 1e9)


def test_note_of_an_interpolated_sequence_states_both_rates() -> None:
    quicker = InterpolatedSequence(Flat(4), 100.0, "nearest")
    assert quicker.notes == (
        "a note",
        "4 depth frames at 25 Hz are interpolated in time (nearest) to 16 at 100 Hz; "
        "the last 4 repeat the last picture.",
    )
    assert InterpolatedSequence(Flat(4), 20.0).notes[1].endswith("(linear) to 3 at 20 Hz.")
    assert InterpolatedSequence(Flat(1), 20.0).notes == ("a note",)


# -- heights
# --------------------------------------------------------------------------------------------------------


def test_note_of_depth_as_heights_states_the_distance_of_its_scale() -> None:
    scene = HeightScene.from_depth_sequence(Flat(depth_m=3.25))
    assert scene.notes[0] == "a note" and "pixels are spaced as at 3.25 m" in scene.notes[1]
    low, high = scene.bounds_m()
    np.testing.assert_allclose(low, [-5 / 10 * 3.25, -4.5 / 16 * 3.25, 3.25])
    np.testing.assert_allclose(high, [6 / 10 * 3.25, 2.5 / 16 * 3.25, 3.25])


def test_note_of_a_picture_states_the_assumed_relief(tmp_path: Path) -> None:
    path = tmp_path / "hills.png"
    values = np.arange(4 * 9, dtype=np.uint8).reshape(4, 9) + 20
    Image.fromarray(values).save(path)
    scene = KIND.open(path, SourceOptions(cell_size_m=0.5))
    relief_m = PICTURE_RELIEF * 4 * 0.5  # of the shorter side
    text = f"{relief_m / 35:.4g} m a unit is assumed, a relief of {relief_m:.3g} m"
    assert any(text in note for note in scene.notes)
    assert np.ptp(scene.bounds_m()[:, 2]) == pytest.approx(relief_m)


def test_note_states_degrees_in_metres_east_and_north(tmp_path: Path) -> None:
    path = tmp_path / "ground.npz"
    heights = np.arange(12.0).reshape(3, 4)
    extent = {"xmin": 10.0, "xmax": 10.2, "ymin": 59.9, "ymax": 60.1}
    np.savez(path, z=heights, dx=0.05, dy=0.02, **extent)
    scene = KIND.open(path, SourceOptions())
    along, across = degree_m(60.0)
    east, north = 0.05 * across, 0.02 * along
    assert (
        f"Degrees are taken as metres at latitude 60.00: {east:.4g} m east, {north:.4g} m north."
        in scene.notes
    )
    np.testing.assert_allclose(np.ptp(scene.bounds_m(), axis=0), [3 * east, 2 * north, 11])


# -- meshes
# ---------------------------------------------------------------------------------------------------------


def test_size_note_states_sides_in_order_and_the_unit() -> None:
    assert size_note(np.array([1.0, 2.5, 30.0]), None) == (
        "Coordinates taken as metres: 1 x 2.5 x 30 m; give --unit-m if they are not "
        "(millimetres: 0.001, inches: 0.0254)."
    )
    assert size_note(np.array([1.0, 2.5, 40.0]), None) == (
        "Coordinates taken as metres: 1 x 2.5 x 40 m; give --unit-m if they are not. As millimetres, "
        "--unit-m 0.001, they are 0.001 x 0.0025 x 0.04 m; as inches, 0.0254 x 0.0635 x 1.016 m."
    )
    assert size_note(np.array([1.0, 2.5, 30.0]), 0.01, " in the first frame") == (
        "One unit is 0.01 m: 1 x 2.5 x 30 m in the first frame."
    )


def test_note_states_the_interpretation_of_a_mesh() -> None:
    vertices, faces = cube()
    assert MeshScene(vertices, faces).notes == ("12 triangles, closed: what they enclose is inside.",)
    is_top = (vertices[faces][:, :, 2] == 1).all(axis=1)
    open_ = faces[~is_top]
    (*_, note) = MeshScene(vertices, open_, holes="leave").notes
    assert note == (
        "10 triangles, open with 4 boundary edges: taken as a one-sided shell, the wall behind its faces "
        "(all triangles face consistently)."
    )
    (*_, note) = MeshScene(vertices, open_, holes="leave", shell="two").notes
    assert note == "10 triangles, open with 4 boundary edges: taken as a two-sided shell (as requested)."
    (*_, note) = MeshScene(vertices, open_, holes="leave", shell="one").notes
    assert note.endswith("one-sided shell, the wall behind its faces (as requested).")
    sheet = np.array([[0, 1, 2], [0, 2, 1]])
    (*_, note) = MeshScene(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), sheet).notes
    assert note == (
        "2 triangles, a sheet laid double: taken as a two-sided shell "
        "(every triangle has a twin that faces the other way)."
    )


def test_note_lists_holes_by_size() -> None:
    """Two boxes without a lid: of 2 m, where the lid would be a fifth of the rest, and of 1 m."""

    def lidless(low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
        vertices, faces = cube(low, high)
        return vertices, faces[~(vertices[faces][:, :, 2] == high).all(axis=1)]

    closed = MeshScene(*together(lidless(5.0, 6.0), lidless(0.0, 2.0)), holes="close")
    note_text = (
        f"2 holes closed: {np.hypot(2, 2):.3g} m across (20.00% of its part), {np.hypot(1, 1):.3g} m across"
    )
    assert closed.is_closed and closed.notes[0].startswith(note_text)
    unclosed = MeshScene(*together(lidless(5.0, 6.0), lidless(0.0, 2.0)), holes="leave")
    assert unclosed.notes[0].startswith(
        "2 open outlines left, where the force falls to 0: 2.83 m across (20.00% of its"
    )
    assert unclosed.notes[0].endswith("; --holes close closes them")
    assert "1 hole closed: " in MeshScene(*lidless(0.0, 2.0), holes="close").notes[0]


# -- worlds of depth
# ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("world", "posed", "message"),
    [
        ("fused", True, "The world is fused from all frames (--world fused)"),
        ("causal", True, "The world is fused from what was seen so far (--world causal)"),
        (
            "fused",
            False,
            "The world is fused from all frames (--world fused; no poses, so the camera is assumed to be "
            "static)",
        ),
    ],
)
def test_note_states_the_frames_of_a_fused_world(world: str, posed: bool, message: str) -> None:
    sequence = Flat(3)
    sequence.poses = np.tile(np.eye(4), (3, 1, 1)) if posed else None
    scene = FusedScene(sequence, world)
    assert scene.notes[0] == "a note" and scene.notes[-1].startswith(message)


class Drifting(_World):
    """A world with given residuals, metres a frame."""

    def __init__(self, residuals_m: np.ndarray) -> None:
        self._volume = type("Volume", (), {"residuals_m": residuals_m.tolist()})()  # type: ignore[assignment]

    def _reset(self) -> None:
        raise NotImplementedError

    def update(self, seen: int) -> None:  # type: ignore[override]
        raise NotImplementedError


@pytest.mark.parametrize(
    ("first_mm", "last_mm", "frames", "is_noted"),
    [
        (2.0, DRIFT_FACTOR * 2.0, 8, True),
        (2.0, DRIFT_FACTOR * 2.0 - 0.01, 8, False),
        (0.1, 2.0, 8, True),
        (0.1, 1.99, 8, False),  # below 2 mm the poses are not blamed
        (2.0, 30.0, 7, False),  # too few frames
        (2.0, 30.0, 11, True),
    ],
)
def test_note_of_drift_compares_the_first_and_the_last_quarter(
    first_mm: float, last_mm: float, frames: int, is_noted: bool
) -> None:
    quarter = frames // 4
    residuals_mm = np.full(frames, 9.0)
    residuals_mm[:quarter], residuals_mm[frames - quarter :] = first_mm, last_mm
    notes = Drifting(residuals_mm / 1000).notes()
    assert len(notes) == is_noted
    if is_noted:
        figures = f"{first_mm:.2g} mm in the first quarter of the frames and {last_mm:.2g} mm in the last"
        assert figures in notes[0]


def test_note_states_the_number_of_objects() -> None:
    class Boxes(Flat):
        width, height = 60, 40

        def depth_m(self, frame: int) -> np.ndarray:
            depth = np.full((self.height, self.width), self._depth_m, np.float32)
            depth[5:20, 5:25] = 1.0
            if self.frame_count > 1:
                depth[22:38, 30:50] = 1.5
            return depth

    def parts(sequence: DepthSequence, rule: SegmentRule) -> tuple[list[str], str]:
        bodies, note = segmented_bodies(
            lambda part: HeightScene.from_depth_sequence(part), sequence, rule, 5e-4
        )
        return [body.name for body in bodies], note

    names, note = parts(Boxes(2), SegmentRule(max_objects=2))
    assert names == ["object 1", "object 2", "background"]
    assert note.startswith("Segmented by depth steps into 2 objects and the background (step=0.03,least=")
    assert "at-most=2); what an object is" in note
    names, note = parts(Flat(1), SegmentRule())
    assert names == ["object 1"] and note.startswith("Segmented by depth steps into 1 object (step=")
