"""Walls that are too thin for the lattice are thickened, and reported; nothing else changes."""

from __future__ import annotations

import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gltf_makers import Gltf
from touchfield.errors import InvalidArgument
from touchfield.medium import PoseTrack
from touchfield.pipeline import encode, prepare
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.mesh.mesh_scene import MeshScene
from touchfield.sources.options import SourceOptions
from touchfield.sources.physics.body_scene import BodyScene
from touchfield.sources.scene import Body, Scene
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Box, Capsule, Cylinder, Ellipsoid, Shape, Sphere, rotation_matrix
from touchfield.sources.thin_walls import MIN_SAMPLES

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "render"))
from proxy_makers import Held, ramp_n

ORIGIN, HALF_M = (0.0, 0.0, 0.0), 0.0005
SPEC = EncodeSpec(nw=6, mapping="1")


def plate(axis: int, half_m: float = HALF_M, rotation_deg: tuple[float, float, float] = ORIGIN) -> Box:
    half = [0.03, 0.03, 0.03]
    half[axis] = half_m
    return Box(ORIGIN, (half[0], half[1], half[2]), rotation_deg)


def mesh_of(box: Box) -> tuple[np.ndarray, np.ndarray]:
    """The vertices and triangles of a box."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [(a, b, c) for a, b, c, _ in quads] + [(a, c, d) for a, _, c, d in quads]
    return signs * box.half_extents_m @ box.axes.T + box.center_m, np.array(triangles)


def thin_note(scene: Scene | Path, spec: EncodeSpec = SPEC) -> str:
    return next((note for note in prepare(scene, spec).notes if note.startswith("Too thin")), "")


def passes(scene: Scene, normal: np.ndarray, spec: EncodeSpec) -> bool:
    """True if a hand that presses with 3 N comes to the other side."""
    field = prepare(scene, spec).medium[0]
    for sign in (1.0, -1.0):
        try:
            rig = Held(field)
        except AssertionError:
            return True  # no wall
        _, forces, proxy = rig.pushed(sign * 0.008 * normal, ramp_n(-sign * normal), 0.8)
        if (sign * proxy @ normal).min() <= 0 or abs(float(forces[-1] @ normal) - sign * 3.0) > 0.3:
            return True
    return False


@pytest.mark.parametrize("is_mesh", [False, True])
@pytest.mark.parametrize(
    ("axis", "rotation_deg"), [(0, ORIGIN), (1, ORIGIN), (2, ORIGIN), (1, (30.0, 0.0, 0.0))]
)
def test_a_plate_of_1_mm_holds_the_hand_along_any_axis(
    axis: int, rotation_deg: tuple[float, float, float], is_mesh: bool
) -> None:
    box = plate(axis, rotation_deg=rotation_deg)
    scene = MeshScene(*mesh_of(box)) if is_mesh else AnalyticScene([box])
    normal = rotation_matrix(rotation_deg)[:, axis]
    assert passes(scene, normal, EncodeSpec(nw=6, mapping="1", thin="keep"))
    assert not passes(scene, normal, SPEC)


def test_the_note_states_the_object_both_thicknesses_and_the_option() -> None:
    scene, spacing_m = AnalyticScene([Sphere((0, 0, 0.05), 0.02), plate(1)]), prepare(plate_scene(), SPEC)
    needed_mm = 1e3 * (MIN_SAMPLES * spacing_m.medium.grid.spacing_m[1] + 2 * 0.05 / 500)
    note = thin_note(scene)
    assert f"box 2 of 1 mm is now {needed_mm:.3g} mm thick" in note and "--thin keep" in note
    kept = thin_note(scene, EncodeSpec(nw=6, mapping="1", thin="keep"))
    assert f"box 2 of 1 mm ({needed_mm:.3g} mm would hold)" in kept and "may pass" in kept
    assert thin_note(scene, EncodeSpec(nw=6, mapping="1", law="magnetic")) == ""
    assert thin_note(scene, EncodeSpec(device="tshirt-32x32")) == ""


def plate_scene() -> AnalyticScene:
    return AnalyticScene([plate(1)])


@pytest.mark.parametrize(
    ("shape", "is_thin"),
    [
        (Ellipsoid(ORIGIN, (0.03, 0.02, 0.0004)), True),
        (Cylinder(ORIGIN, 0.02, 0.0004), True),
        (Cylinder(ORIGIN, 0.0004, 0.02), True),
        (Capsule(ORIGIN, 0.0004, 0.02, (20.0, 30.0, 0.0)), True),
        (Cylinder(ORIGIN, 0.02, 0.004), False),
        (Sphere(ORIGIN, 0.0005), False),  # a grain is no wall
        (Box(ORIGIN, (0.0005, 0.0005, 0.0005)), False),
    ],
)
def test_plates_and_rods_are_thickened_and_grains_are_not(shape: Shape, is_thin: bool) -> None:
    far = Sphere((0.05, 0.05, 0.0), 0.01)
    assert bool(thin_note(AnalyticScene([shape, far]))) is is_thin


def test_a_sheet_on_a_block_is_no_thin_wall() -> None:
    block = Box((0.0, 0.0, -0.01), (0.03, 0.03, 0.01))
    sheet = Box((0.0, 0.0, 0.0005), (0.02, 0.02, 0.0005))
    assert thin_note(AnalyticScene([block, sheet])) == ""
    overhanging = Box((0.02, 0.0, 0.0005), (0.02, 0.02, 0.0005))
    assert "box 2" in thin_note(AnalyticScene([block, overhanging]))


def test_a_fin_of_a_mesh_grows_and_its_block_does_not() -> None:
    parts = [
        mesh_of(Box((0, 0, -0.01), (0.02, 0.02, 0.01))),
        mesh_of(Box((0, 0, 0.005), (0.015, 0.0004, 0.015))),
    ]
    vertices = np.concatenate([vertices for vertices, _ in parts])
    scene = prepare(MeshScene(vertices, np.concatenate([parts[0][1], parts[1][1] + 8])), SPEC).source
    assert isinstance(scene, MeshScene)
    grown = scene.surface.vertices_m
    assert np.allclose(grown[:8], vertices[:8], atol=1e-8)
    expected = vertices[8:].copy()
    expected[:, 1] *= (MIN_SAMPLES * 0.001875 + 0.0002) / 0.0008
    assert np.allclose(grown[8:], expected, atol=1e-5)


def test_acute_edges_and_touching_parts_are_no_thin_walls() -> None:
    corners = 0.04 * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    faces = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
    assert thin_note(MeshScene(corners, faces)) == ""
    low, high = Box((0, 0, -0.0005), (0.03, 0.03, 0.0005)), Box((0, 0, 0.01), (0.03, 0.03, 0.01))
    (a, triangles), (b, others) = mesh_of(low), mesh_of(high)
    stacked = MeshScene(np.concatenate([a, b]), np.concatenate([triangles, others + 8]))
    assert thin_note(stacked) == ""


def test_an_open_mesh_is_no_solid() -> None:
    vertices, triangles = mesh_of(plate(1))
    assert thin_note(MeshScene(vertices, triangles[:-2], holes="leave")) == ""


@pytest.mark.parametrize("representation", ["voxel", "object"])
def test_bodies_are_thickened_by_their_own_lattice(representation: str) -> None:
    turns = np.array([[np.cos(a), 0.0, 0.0, np.sin(a)] for a in (0.0, 0.3)])
    turning = Body("vane", AnalyticScene([plate(0)]), PoseTrack(turns, np.zeros((2, 3))))
    block = Body("block", AnalyticScene([Box((0, 0, -0.03), (0.03, 0.03, 0.01))]), PoseTrack.constant(2))
    spec = EncodeSpec(nw=6, mapping="1", representation=representation)
    note = thin_note(BodyScene([turning, block], 30.0), spec)
    spacing_mm = {"voxel": 2.5, "object": 0.75 * np.cbrt(2.5 * 1.875 * 1.09375)}[representation]
    found = re.search(r"vane of 1 mm is now ([\d.]+) mm", note)
    assert found is not None and "block" not in note
    assert float(found[1]) == pytest.approx(MIN_SAMPLES * spacing_mm + 0.2, abs=0.01)


def test_a_file_states_what_was_done_and_others_do_not_change(tmp_path: Path) -> None:
    written = {}
    for name, shape in (("thin", plate(1)), ("thick", plate(1, 0.01))):
        for thin in ("thicken", "keep"):
            path = tmp_path / f"{name}-{thin}.touch"
            spec = EncodeSpec(
                nw=5, mapping="1", thin=thin, allow_empty=True
            )  # a plate that is kept is between samples
            encoded = encode(AnalyticScene([shape]), path, spec)
            written[name, thin] = path.read_bytes(), encoded.prepared
    assert written["thick", "thicken"][0] == written["thick", "keep"][0]
    assert b'"thin"' not in written["thick", "thicken"][0]
    assert written["thin", "thicken"][0] != written["thin", "keep"][0]
    assert written["thin", "thicken"][1].is_thickened and not written["thin", "keep"][1].is_thickened


def test_the_spec_of_a_file_from_before_leaves_walls_as_they_were() -> None:
    assert EncodeSpec.from_json(EncodeSpec(thin="keep").to_json()).thin == "keep"
    assert EncodeSpec.from_json(EncodeSpec().to_json()).thin == "thicken"
    assert '"thin"' not in EncodeSpec(thin="keep").to_json()
    with pytest.raises(InvalidArgument, match="thin"):
        EncodeSpec(thin="thick")


@pytest.mark.parametrize("representation", ["voxel", "object"])
def test_an_animated_plate_is_thickened_in_all_frames(tmp_path: Path, representation: str) -> None:
    vertices, triangles = mesh_of(plate(2, 0.0002))
    gltf = Gltf()
    node = gltf.put("nodes", mesh=gltf.mesh(vertices, triangles))
    gltf.animate(node, "translation", [0, 1], [[0, 0, 0], [0, 0, 0.01]])
    path = gltf.save(tmp_path / "plate.gltf")
    spec = EncodeSpec(
        nw=6, mapping="1", representation=representation, frames=(0, 30), source=SourceOptions(rate_hz=30.0)
    )
    thick, kept = prepare(path, spec), prepare(path, replace(spec, thin="keep"))
    name, spacing_m = {"voxel": ("plate.gltf", 0.0025), "object": ("part 1", 0.75 * 0.00109375)}[
        representation
    ]
    found = re.search(rf"{name} of 0.4 mm is now ([\d.]+) mm", thin_note(path, spec))
    assert found is not None and float(found[1]) == pytest.approx(
        1e3 * MIN_SAMPLES * spacing_m + 0.2, abs=0.01
    )
    for frame in (0, 29):
        fields = [np.abs(prepared.medium[frame].to_dense()[..., 2]).max() for prepared in (thick, kept)]
        assert fields[0] > 0.05 and fields[1] < 0.02  # N
