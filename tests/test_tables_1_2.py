"""Tables 1 and 2 and figures 5 and 6: their arithmetic, and small scenes through the complete experiment."""

from __future__ import annotations

import json
import math
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from reproduction import figure_5, figure_6, table_1, table_2
from reproduction.body_surfaces import polygons
from reproduction.experiment import Inputs
from reproduction.later_frames import consecutive_runs, later_frames
from reproduction.page import plain
from reproduction.perceptual_bits import PerceptualFilter, six_and_twelve, six_bits, three_times_six
from reproduction.printed_tables import PRINTED_1, PRINTED_2, density_needed, identity
from reproduction.progress import Steps
from reproduction.section_5_1 import NOMINAL, READINGS, PaperScene, height_scene
from reproduction.table_1_counts import counts_of

from touchfield.measure.estimators import binary_entropy_bits
from touchfield.medium import ForceField, Grid, PoseTrack
from touchfield.sources.camera import DepthSequence, Intrinsics
from touchfield.sources.mesh.mesh_scene import MeshScene
from touchfield.sources.physics.body_scene import BodyScene
from touchfield.sources.scene import Body
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Box, Capsule, Cylinder, Ellipsoid, Sphere

F_MAX = 3.3
ORIGIN = (0.0, 0.0, 0.0)
CORNERS = np.array([(0, 0, 0), (0.06, 0, 0), (0, 0.06, 0), (0, 0, 0.06)])
FACES = np.array([(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)])


class Wall(DepthSequence):
    """Three frames of a tilted wall that comes nearer, with a hole."""

    name, frame_count, width, height, rate_hz = "wall", 3, 40, 30, 30.0
    intrinsics = Intrinsics(40.0, 40.0, 19.5, 14.5)

    def depth_m(self, frame: int) -> np.ndarray:
        depth = np.tile(np.linspace(1.0, 1.4, self.width, dtype=np.float32), (self.height, 1)) - np.float32(
            0.02 * frame
        )
        depth[5:9, 5:9] = 0
        return depth


def falling() -> BodyScene:
    positions_m = np.linspace((0, 0, 0.3), (0.02, 0.01, 0.2), 8)
    turns = np.tile([math.cos(0.2), math.sin(0.2), 0, 0], (8, 1))
    bodies = [
        Body("ball", AnalyticScene((Sphere(ORIGIN, 0.04),)), PoseTrack.constant(8, (0.2, 0.0, 0.1))),
        Body("box", AnalyticScene((Box(ORIGIN, (0.05, 0.03, 0.04)),)), PoseTrack(turns, positions_m)),
    ]
    return BodyScene(bodies, 1000.0)


@pytest.fixture(scope="module")
def bodies() -> PaperScene:
    return PaperScene("scene1", "two", "Scene 1, two bodies", falling())


@pytest.fixture(scope="module")
def wall() -> PaperScene:
    return PaperScene("scene2", "wall", "Scene 2, a wall", height_scene(Wall()))


# -- the printed figures -----------------------------------------------------------------------------------


def test_the_printed_entropies_are_not_on_the_curve_of_the_identity() -> None:
    needed = [density_needed(*PRINTED_1[key].entropy) for key in ("scene1", "scene2")]  # type: ignore[arg-type]
    needed.append(density_needed(*PRINTED_2["scene2"].entropy))  # type: ignore[arg-type]
    assert needed == [pytest.approx(p, abs=0.005) for p in (0.20, 0.52, 0.32)]
    assert identity(1.8e5 / 8e9, 2.3) == pytest.approx(0.00043, abs=1e-5)
    assert identity(5.5e8 / 8e9, 5.2) == pytest.approx(0.719, abs=1e-3)
    assert identity(21 / 32, 3.1) == pytest.approx(2.96, abs=5e-3)
    assert PRINTED_2["scene2"].entropy[0] < 21 / 32 * 3.1  # type: ignore[operator]


def test_the_required_density_satisfies_the_identity() -> None:
    for voxel_bits, object_bits in ((0.1, 1.0), (1.2, 2.3), (5.0, 5.0), (1.0, 0.0)):
        p = density_needed(voxel_bits, object_bits)
        assert p is not None and identity(p, object_bits) == pytest.approx(voxel_bits, abs=1e-9)
    assert density_needed(5.1, 5.0) is None, "at most log2(1 + 2^5)"


# -- the perceptual filter ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "bits", "span"), [(three_times_six, 18, 503), (six_and_twelve, 18, 547), (six_bits, 6, 547)]
)
def test_the_perceptual_filter_has_its_bits_and_its_span(make: object, bits: int, span: int) -> None:
    q: PerceptualFilter = make(F_MAX)  # type: ignore[operator]
    assert q.bits == bits and q.quantiser.alphabet > 2 ** (bits - 1)
    assert F_MAX / q.force_min_n == pytest.approx(span, rel=2e-3)


def test_the_worst_errors_are_those_of_the_ladders() -> None:
    rng = np.random.default_rng(1)
    direction = rng.standard_normal((20_000, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    size = np.exp(rng.uniform(math.log(0.05), math.log(F_MAX), 20_000))
    forces = (size[:, None] * direction).astype(np.float32)
    twelve, three, six = six_and_twelve(F_MAX), three_times_six(F_MAX), six_bits(F_MAX)
    bound = math.sqrt(0.05**2 + 2 * 1.05 * (1 - math.cos(math.radians(2.19))))
    assert 0.05 < twelve.worst_error(forces, 0.05) <= bound
    assert 0.1 < three.worst_error(forces, 0.05) <= 0.1 + math.sqrt(2) * three.force_min_n / 0.05
    pushes = np.zeros((20_000, 3), np.float32)
    pushes[:, 2] = size
    assert 0.045 < six.worst_error(pushes, 0.05) <= 0.05 + 1e-6


# -- lattices and counts -----------------------------------------------------------------------------------


def test_both_lattices_fill_the_same_box(bodies: PaperScene) -> None:
    for reading in READINGS:
        nominal, omni = (bodies.lattice(reading, is_nominal) for is_nominal in (True, False))
        assert nominal.voxel_count == NOMINAL**3 == 10**12
        assert np.allclose(nominal.box_m, omni.box_m)
        assert np.prod(omni.spacing_m) / np.prod(nominal.spacing_m) == pytest.approx(
            10**12 / 8.08e9, rel=1e-3
        )
    assert np.allclose(bodies.lattice("literal", False).box_m, bodies.scene.bounds_m())
    low, high = bodies.lattice("corrected", False).box_m
    assert np.allclose((high - low) / (0.16, 0.12, 0.07), (high - low)[0] / 0.16), (
        "the aspect of the workspace"
    )


@pytest.mark.parametrize(
    "scene",
    [
        AnalyticScene((Box(ORIGIN, (0.03, 0.02, 0.01)),)), AnalyticScene((Sphere(ORIGIN, 0.03),)),
        AnalyticScene((Capsule(ORIGIN, 0.02, 0.02),)), AnalyticScene((Cylinder(ORIGIN, 0.02, 0.03),)),
        AnalyticScene((Ellipsoid(ORIGIN, (0.03, 0.02, 0.01)),)), MeshScene(CORNERS, FACES),
    ],
    ids=["box", "sphere", "capsule", "cylinder", "ellipsoid", "mesh"],
)  # fmt: skip
def test_a_volume_is_that_of_the_samples_within(scene: AnalyticScene | MeshScene) -> None:
    paper_scene = PaperScene(
        "scene1", "one", "one", BodyScene([Body("one", scene, PoseTrack.constant(2))], 1000.0)
    )
    low, high = scene.bounds_m()
    grid = Grid.over_box(low - 0.0013, high + 0.0017, (90, 90, 90))
    volume = paper_scene.volume_m3()
    assert volume is not None
    assert paper_scene.field(0, grid).support_count == pytest.approx(
        volume / np.prod(grid.spacing_m), rel=0.03
    )
    faces = polygons(scene)
    assert faces is not None
    middle = faces.mean(axis=(0, 1))
    fan = [np.stack([face[0], face[i], face[i + 1]]) for face in faces for i in range(1, len(face) - 1)]
    enclosed = sum(np.linalg.det(triangle - middle) for triangle in fan) / 6
    assert enclosed == pytest.approx(volume, rel=0.06), "anticlockwise from outside, and closed"


def test_a_scene_without_formula_has_no_volume(wall: PaperScene) -> None:
    assert wall.volume_m3() is None and wall.segmented() is not None


def test_counts_agree_with_volumes_and_with_each_other(bodies: PaperScene) -> None:
    filters = (three_times_six(F_MAX), six_and_twelve(F_MAX))
    found = counts_of(bodies, filters, Steps(lambda done, total: None, 5), quick=True)
    assert found.by_volume is not None
    for reading in READINGS:
        for is_nominal, samples in ((True, found.nominal), (False, found.on_device)):
            quantity = samples[reading].count
            assert quantity.interval is not None
            reach = 1.5 * (quantity.interval.high - quantity.interval.low)
            assert abs(quantity.value - found.by_volume[reading, is_nominal]) < reach
            for q in filters:
                h = samples[reading].entropies(q.text)
                p = h.density.value
                assert h.voxel.value == pytest.approx(binary_entropy_bits(p) + p * h.object.value, abs=1e-9)
    assert all(later.frames == 4 and 0 <= later.held_share <= 1 for later in found.later.values())


# -- later frames ------------------------------------------------------------------------------------------


def test_runs_are_of_consecutive_frames() -> None:
    for frames, runs, length in ((2000, 6, 25), (8, 2, 2), (1, 4, 3), (800, 5, 4)):
        found_runs = consecutive_runs(frames, runs, length)
        assert 1 <= len(found_runs) <= runs and found_runs[0][0] == 0 and found_runs[-1][-1] == frames - 1
        assert all(len(run) == min(length + 1, frames) for run in found_runs)
        assert all(a[-1] < b[0] for a, b in zip(found_runs, found_runs[1:]))


def test_static_frames_need_no_bits(wavy_field: ForceField) -> None:
    q = {"Q": six_and_twelve(F_MAX)}
    found = later_frames(lambda i: wavy_field, [range(4)], q, 0.1)
    assert {name for _, name in found} == set(q)
    for result in found.values():
        assert (result.voxel_bits, result.object_bits, result.held_share, result.frames) == (0.0, 0.0, 1.0, 3)


def test_a_slow_drift_is_sent_by_the_corrected_equation_only(wavy_field: ForceField) -> None:
    def drifting(frame: int) -> ForceField:
        return wavy_field.scaled(1.05**frame)

    found = later_frames(drifting, [range(8)], {"Q": three_times_six(F_MAX)}, 0.1)
    assert found["literal", "Q"].held_share == 1.0, "eq. 8 compares with the frame before"
    assert 0.3 < found["corrected", "Q"].held_share < 0.95


def test_the_end_of_a_force_is_sent(wavy_field: ForceField) -> None:
    frames = [wavy_field, ForceField.empty(wavy_field.grid), ForceField.empty(wavy_field.grid)]
    found = later_frames(frames.__getitem__, [range(3)], {"Q": three_times_six(F_MAX)}, 0.1)["corrected", "Q"]
    p = (
        np.count_nonzero(three_times_six(F_MAX).symbols_of(wavy_field.vectors_n()))
        / wavy_field.grid.voxel_count
    )
    assert found.voxel_bits == pytest.approx(binary_entropy_bits(p) / 2, rel=1e-6), (
        "zero, told once; then held"
    )


# -- the pages ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("table", "key"), [(table_1, "bodies"), (table_2, "wall")], ids=["table1", "table2"])
def test_the_table_of_a_small_scene(
    table: ModuleType,
    key: str,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    request: pytest.FixtureRequest,
) -> None:
    scene: PaperScene = request.getfixturevalue(key)
    monkeypatch.setattr(table, "scenes", lambda inputs: [scene])
    progress: list[tuple[int, int]] = []
    found = table.EXPERIMENT.run(
        Inputs(tmp_path, report=lambda done, total: progress.append((done, total)), quick=True)
    )
    json.dumps(plain(found.data), allow_nan=False)
    assert progress[-1][0] == progress[-1][1] and progress == sorted(progress)
    for text in (
        "printed",
        "literal",
        "corrected",
        "why they differ",
        "Perceptual filter",
        "quick",
        scene.title,
    ):
        assert text in found.markdown
    assert len(found.data["scenes"]) == 1 and str(tmp_path) not in found.markdown
    lines = [line for line in found.markdown.splitlines() if line.startswith("|")]
    widths = {line.count("|") - line.count("\\|") - 1 for line in lines}
    assert widths == ({6, 9} if table is table_1 else {6})  # columns of each table


def test_the_figures_are_drawn(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, bodies: PaperScene, wall: PaperScene
) -> None:
    pytest.importorskip("matplotlib")
    from PIL import Image

    monkeypatch.setattr(figure_5, "scene_1", lambda count: bodies)
    monkeypatch.setattr(figure_5, "INSTANTS", (0.0, 1.0))
    monkeypatch.setattr(figure_6, "depth_scenes", lambda inputs: [wall])
    monkeypatch.setattr(figure_6, "_motorcycle_picture", lambda: np.full((30, 40, 3), 90, np.uint8))
    for figure in (figure_5, figure_6):
        found = figure.EXPERIMENT.run(Inputs(tmp_path))
        assert all(f"]({p.name})" in found.markdown for p in found.pictures)
        for picture in found.pictures:
            with Image.open(picture) as image:
                colours = np.asarray(image.convert("RGB")) @ [1 << 16, 1 << 8, 1]
            assert (colours == 0xFFFFFF).mean() < 0.95 and len(np.unique(colours)) > 200


def test_a_body_of_several_shapes_has_no_outline() -> None:
    assert polygons(AnalyticScene((Sphere(ORIGIN, 0.1), Sphere((0.1, 0, 0), 0.1)))) is None
