"""Depth sequences as objects: segmentation, identity over time, and completeness."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from touchfield.errors import InvalidArgument, SourceError
from touchfield.medium import Grid
from touchfield.pipeline import encode
from touchfield.pipeline.decoding import open_file
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.camera import DepthSequence, Intrinsics
from touchfield.sources.depth.depth_scene import DepthScene
from touchfield.sources.depth.segmentation import Segmentation, SegmentRule, label_surfaces
from touchfield.sources.laws import LawSpec, profile_of
from touchfield.sources.registry import open_source
from touchfield.sources.scene import Scene
from touchfield.sources.terrain.height_scene import HeightScene

HEIGHT, WIDTH = 60, 80
RULE = "least=0.004"  # 19 pixels
STEP_PER_M = 5e-4

Drawn = Callable[[int], np.ndarray]


class Frames(DepthSequence):
    """A depth sequence in memory."""

    def __init__(self, draw: Drawn, count: int = 1) -> None:
        self.name, self.intrinsics, self.rate_hz = "frames", Intrinsics(80.0, 80.0, 39.5, 29.5), 25.0
        self.frame_count, self.width, self.height = count, WIDTH, HEIGHT
        self.draw = draw

    def depth_m(self, frame: int) -> np.ndarray:
        return self.draw(frame).astype(np.float32)


def wall(*boxes: tuple[int, int, int, float]) -> np.ndarray:
    """A slanted wall at about 2 m with square boxes (row, column, side, depth) before it, and a hole."""
    depth = 2.0 + 0.002 * np.arange(WIDTH) + np.zeros((HEIGHT, 1))
    for row, column, side, z in boxes:
        depth[row : row + side, column : column + side] = z
    depth[:4, :4] = 0
    return depth


def moving(frame: int) -> np.ndarray:
    """Two boxes that cross the picture in opposite directions; the second one is absent in frame 2."""
    second = [] if frame == 2 else [(40, 60 - 3 * frame, 9, 1.5)]
    return wall((10, 5 + 4 * frame, 14, 1.0), *second)


def segmented(draw: Drawn, count: int = 1, rule: str = RULE) -> Segmentation:
    return Segmentation(Frames(draw, count), SegmentRule.parse(rule), STEP_PER_M)


def numbers_of(objects: Segmentation, frame: int) -> np.ndarray:
    """The object of each pixel: 0 is the background, 255 unknown depth."""
    depths = [objects.depth_m(frame, n) for n in range(objects.object_count + 1)]
    return np.where(np.any(depths, axis=0), np.argmax(depths, axis=0), 255)


# -- the rule ----------------------------------------------------------------------------------------------


def test_text_of_the_rule() -> None:
    assert SegmentRule.parse(None) == SegmentRule()
    assert SegmentRule.parse("step=0.1, least=0.015 ,at-most=3") == SegmentRule(0.1, 0.015, 3)
    assert SegmentRule.parse("step=3%,least=1.5%") == SegmentRule(0.03, 0.015)
    assert SegmentRule.parse("least=600px") == SegmentRule(min_pixels=600)
    with pytest.raises(InvalidArgument, match=r"Write 60px or 60%"):
        SegmentRule.parse("least=60")
    for rule in (
        SegmentRule(),
        SegmentRule(0.25, max_objects=254),
        SegmentRule(min_fraction=0.05),
        SegmentRule(min_pixels=7),
    ):
        assert SegmentRule.parse(rule.text) == rule


@pytest.mark.parametrize(
    "text",
    ["", "step", "step=", "step=x", "least=500cm", "least=0px", "least=1.5px", "least=101%",
     "at_most=3", "most=3", "step=0", "step=nan",
     "least=0", "least=1.01", "at-most=0", "at-most=255", "step=0.03,,"],
)  # fmt: skip
def test_an_invalid_rule_is_refused_before_any_frame_is_read(text: str) -> None:
    with pytest.raises(InvalidArgument, match="segment"):
        DepthScene(Frames(lambda _: wall()), segment=text)


# -- a frame -----------------------------------------------------------------------------------------------


def brute_surfaces(depth: np.ndarray, step: float, noise: float) -> list[set[tuple[int, int]]]:
    """Flood fill by the literal rule."""
    remaining, found = set(zip(*np.nonzero(depth > 0))), []
    while remaining:
        todo, part = [remaining.pop()], set()
        while todo:
            v, u = todo.pop()
            part.add((v, u))
            for other in ((v - 1, u), (v + 1, u), (v, u - 1), (v, u + 1)):
                if other in remaining:
                    a, b = float(depth[v, u]), float(depth[other])
                    if abs(a - b) <= max(step * min(a, b), noise * a * b):
                        remaining.remove(other)
                        todo.append(other)
        found.append(part)
    return found


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.02, 0.1]), st.sampled_from([5e-4, 0.05]))
def test_surfaces_equal_those_of_a_flood_fill(seed: int, step: float, noise: float) -> None:
    random = np.random.default_rng(seed)
    depth = random.choice([0, 1.0, 1.05, 1.3, 4.0, 4.15], (7, 9), p=[0.1, 0.3, 0.2, 0.1, 0.2, 0.1]).astype(
        np.float32
    )
    labels, count = label_surfaces(depth, step, noise)
    ours = {frozenset(zip(*np.nonzero(labels == n))) for n in range(1, count + 1)}
    assert ours == {frozenset(part) for part in brute_surfaces(depth, step, noise)}
    assert ((labels == 0) == (depth == 0)).all()


@pytest.mark.parametrize(("step", "noise"), [(0.25, 0.0), (0.0, 0.2)])
def test_a_step_at_the_limit_is_within_a_surface(step: float, noise: float) -> None:
    depth = np.float32([[1.0, 1.25]])
    assert label_surfaces(depth, step, noise)[1] == label_surfaces(depth.T, step, noise)[1] == 1
    assert label_surfaces(np.float32([[1.0, 1.2501]]), step, noise)[1] == 2


def test_sensor_noise_does_not_split_a_distant_wall() -> None:
    distant_wall = np.where(np.arange(WIDTH) % 2 == 0, 8.0, 8.4) + np.zeros(
        (HEIGHT, 1)
    )  # 1/8 - 1/8.4 is 0.006
    assert label_surfaces(distant_wall.astype(np.float32), 0.03, STEP_PER_M)[1] == WIDTH
    assert label_surfaces(distant_wall.astype(np.float32), 0.03, 0.0073)[1] == 1


def test_small_surfaces_and_those_beyond_the_maximum_are_background() -> None:
    draw = lambda _: wall((10, 10, 12, 1.0), (30, 10, 8, 1.0), (30, 40, 4, 1.0))  # noqa: E731
    found = segmented(draw)  # the third has 16 pixels
    assert found.object_count == 3
    assert found.pixels[0].tolist() == [16, 60 * 80 - 16 - 144 - 64 - 16, 144, 64]
    numbers = numbers_of(found, 0)
    assert [numbers[0, 0], numbers[31, 41], numbers[5, 5], numbers[11, 11], numbers[31, 11]] == [
        255,
        0,
        1,
        2,
        3,
    ]
    few = segmented(draw, rule="least=0.004,at-most=2")
    assert few.object_count == 2 and few.pixels[0].tolist() == [16 + 64, 60 * 80 - 16 - 144 - 64 - 16, 144]


# -- over time ---------------------------------------------------------------------------------------------


def test_objects_keep_their_identity_through_motion_and_absence() -> None:
    found = segmented(moving, 8)
    assert found.object_count == 3
    for frame in range(8):
        numbers = numbers_of(found, frame)
        assert (numbers[10:24, 5 + 4 * frame : 19 + 4 * frame] == 2).all()
        is_present = frame != 2
        assert ((numbers == 3).sum(), (numbers == 0).sum()) == (81 * is_present, 0)
    # last visible from column 57 on, it returns at 51 to 59
    assert found.pixels[:, 3].tolist() == [81, 81, 0, 81, 81, 81, 81, 81]


def test_an_object_at_a_new_position_is_a_new_object() -> None:
    boxes = {0: [(10, 10, 9, 1.0)], 1: [], 2: [(10, 40, 9, 1.0)], 3: [], 4: [(12, 12, 9, 1.0)]}
    found = segmented(lambda f: wall(*boxes[f]), 5)
    assert found.pixels[:, 2:].tolist() == [[81, 0], [0, 0], [0, 81], [0, 0], [81, 0]]
    assert segmented(lambda f: wall(*boxes[f]), 5, "least=0.004,at-most=2").object_count == 2

    def alone(
        frame: int,
    ) -> np.ndarray:  # A, B, C, and B again: the latest absent object is remembered
        depth = np.zeros((HEIGHT, WIDTH))
        depth[10:19, (10, 30, 50, 30)[frame] :][:, :9] = 1.0
        return depth

    assert segmented(alone, 4, "at-most=1").pixels[:, 1].tolist() == [0, 81, 0, 81]
    more = [(10, 10, 9, 1.0), (30, 10, 8, 1.0), (30, 40, 7, 1.0)]
    found = segmented(lambda f: wall(*more[: 1 + 2 * f]), 2)  # two new objects get two names
    assert found.pixels[:, 2:].tolist() == [[81, 0, 0], [81, 64, 49]]


def test_the_greatest_overlap_decides() -> None:
    """A box splits: the larger part keeps its name, the other one gets a new one."""
    found = segmented(lambda f: wall((20, 20, 20, 1.0)) if f == 0 else split(), 2)
    assert numbers_of(found, 1)[25, 22] == numbers_of(found, 0)[25, 22] == 2
    assert numbers_of(found, 1)[25, 38] == 3


def split() -> np.ndarray:
    depth = wall((20, 20, 20, 1.0))
    depth[20:40, 33:35] = 2.0
    return depth


def test_every_pixel_belongs_to_one_object() -> None:
    found = segmented(moving, 6)
    for frame in range(6):
        depth = moving(frame).astype(np.float32)
        parts = [found.depth_m(frame, n) for n in range(found.object_count + 1)]
        assert np.array_equal(sum(parts), depth)
        assert [int((part > 0).sum()) for part in parts] == found.pixels[frame].tolist()


# -- bodies ------------------------------------------------------------------------------------------------

GRID = Grid((48, 40, 48), (0.05, 0.05, 0.03), (-1.2, -1.0, 0.8))


def differing_fraction(scene: Scene, frame: int, grid: Grid = GRID, thickness_m: float = 0.06) -> float:
    """Fraction of supported samples at which the scene and the sum of its objects differ."""
    profile = profile_of(LawSpec("penalty", 60.0, 3.3), thickness_m)
    total_field = scene.field(frame, grid, profile)
    total = sum((body.scene.field(frame, grid, profile).to_dense() for body in scene.bodies()), np.float32(0))
    is_supported = total_field.to_dense().any(axis=-1) | total.any(axis=-1)
    assert is_supported.sum() > 300
    return float((np.abs(total_field.to_dense() - total).max(axis=-1) > 1e-5).sum() / is_supported.sum())


def test_the_objects_of_a_camera_sum_to_the_scene() -> None:
    scene = DepthScene(Frames(moving, 4), segment=RULE)
    assert [b.name for b in scene.bodies()] == ["object 1", "object 2", "object 3"]
    assert scene.bodies() is scene.bodies()
    # a step of 3 % is far above the noise: no plane of the scene is fitted across it
    assert max(differing_fraction(scene, frame) for frame in range(4)) == 0


def test_an_absent_object_has_an_empty_field() -> None:
    scene = DepthScene(Frames(moving, 4), segment=RULE)
    last = scene.bodies()[-1]
    profile = profile_of(LawSpec("penalty", 60.0, 3.3), 0.06)
    assert [len(last.scene.field(f, GRID, profile).bricks) > 0 for f in range(4)] == [True, True, False, True]
    assert not last.is_rigid and last.track.is_constant and len(last.track) == 4
    with pytest.raises(InvalidArgument, match="0 to 3"):
        last.scene.field(4, GRID, profile)


def test_the_note_states_that_objects_are_estimated() -> None:
    scene = DepthScene(Frames(moving, 2), segment=RULE)
    before = len(scene.notes)
    scene.bodies()
    scene.bodies()
    assert len(scene.notes) == before + 1
    assert (
        "3 objects (step=0.03,least=0.004,at-most=16)" in scene.notes[-1] and "ill-posed" in scene.notes[-1]
    )


def test_no_depth_is_no_object() -> None:
    with pytest.raises(SourceError, match="no depth in any frame"):
        DepthScene(Frames(lambda _: np.zeros((HEIGHT, WIDTH)), 2)).bodies()


def test_a_height_map_is_a_single_body() -> None:
    scene = HeightScene.from_depth_sequence(Frames(moving, 2))
    assert [b.scene for b in scene.bodies()] == [scene]


def test_a_depth_sequence_round_trips_as_objects(tmp_path: Path) -> None:
    spec = EncodeSpec(nw=4, representation="object", thickness_m=0.02)
    done = encode(DepthScene(Frames(moving, 4), segment=RULE), tmp_path / "o.touch", spec)
    assert done.summary()["objects"] == 3
    with open_file(tmp_path / "o.touch") as opened:
        assert opened.scene is not None
        assert [obj.name for obj in opened.scene.objects] == ["object 1", "object 2", "object 3"]
        assert [obj.field(2).support_count > 0 for obj in opened.scene.objects] == [True, True, False]
        assert opened.medium[1].support_count > 0


# -- real depth --------------------------------------------------------------------------------------------


@pytest.mark.shared
@pytest.mark.parametrize("name", ["rgbd_tum_fr1_rpy", "rgbd_iclnuim_livingroom1"])
def test_objects_of_real_depth_sum_to_the_scene(shared_data: Path, name: str) -> None:
    source = open_source(shared_data / name)
    assert isinstance(source, DepthScene)
    source.sequence.poses, source.sequence.frame_count = None, 3
    scene = DepthScene(source.sequence, segment="least=0.01,at-most=6")
    box = scene.bounds_m()
    grid = Grid.over_box(box[0], box[1], (64, 64, 64))
    assert 2 <= len(scene.bodies()) <= 7
    for frame in (0, 2):
        assert differing_fraction(scene, frame, grid) < 0.01
