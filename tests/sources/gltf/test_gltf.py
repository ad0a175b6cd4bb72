"""glTF documents: accessors, samplers, node trees, skins and morph targets, by the formulas of the
standard.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation, Slerp

from gltf_makers import CUBE, CUBE_FACES, Gltf, everything, glb, moving_cube
from touchfield.sources.animation.animated_mesh import KIND
from touchfield.sources.gltf.document import Document
from touchfield.sources.gltf.model import Model, Sampler

TRIANGLE = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]


def at(model: Model, times: list[float], animation: int | None = 0) -> np.ndarray:
    """Vertices at given times, float64 [times, n, 3]."""
    poses = model.poses(None if animation is None else model.animation(animation), np.array(times))
    return np.stack([model.vertices(poses, i) for i in range(len(times))])


def floats(gltf: Gltf, number: int, kind: str, tmp_path: Path) -> np.ndarray:
    return Document(gltf.save(tmp_path / "a.gltf")).array(number, kind)


# -- bytes -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("storage", ["base64", "bin", "glb"])
def test_the_three_storages_of_a_buffer_are_equivalent(storage: str, tmp_path: Path) -> None:
    path = everything().save(tmp_path / f"a.{'glb' if storage == 'glb' else 'gltf'}", storage)
    model, base = Model(path), Model(everything().save(tmp_path / "base.gltf"))
    assert KIND.recognise(path)
    np.testing.assert_array_equal(model.triangles, base.triangles)
    np.testing.assert_array_equal(at(model, [0.03]), at(base, [0.03]))


def test_a_document_is_animated_only_with_an_animation(tmp_path: Path) -> None:
    gltf = moving_cube()
    del gltf.json["animations"]
    assert not KIND.recognise(gltf.save(tmp_path / "still.glb", "glb"))
    (tmp_path / "cut.glb").write_bytes(moving_cube().save(tmp_path / "a.glb", "glb").read_bytes()[:40])
    (tmp_path / "text.gltf").write_text("no JSON")
    (tmp_path / "list.gltf").write_text("[1]")
    (tmp_path / "deep.gltf").write_text("[" * 200_000)
    for name in ("cut.glb", "text.gltf", "list.gltf", "deep.gltf", "absent.gltf"):
        assert KIND.recognise(tmp_path / name) == (name != "absent.gltf")


def test_unknown_chunks_of_a_glb_are_ignored(tmp_path: Path) -> None:
    original = moving_cube().save(tmp_path / "a.glb", "glb").read_bytes()
    extra = original[:12] + original[12:] + b"\x04\0\0\0ABCDwxyz"
    extra = extra[:8] + len(extra).to_bytes(4, "little") + extra[12:]
    (tmp_path / "b.glb").write_bytes(extra)
    assert len(Model(tmp_path / "b.glb").at_rest()) == 36


def test_normalised_integers_are_the_fractions_of_the_standard(tmp_path: Path) -> None:
    for dtype, maximum in (("i1", 127), ("u1", 255), ("<i2", 32767), ("<u2", 65535)):
        gltf = Gltf()
        minimum = -maximum - 1 if dtype.endswith(("i1", "i2")) else 0
        number = gltf.array([minimum, 0, maximum // 3, maximum], dtype, normalized=True)
        expected = [max(minimum / maximum, -1.0), 0, (maximum // 3) / maximum, 1]
        np.testing.assert_array_equal(floats(gltf, number, "SCALAR", tmp_path)[:, 0], expected)
    gltf = Gltf()
    number = gltf.array([-7, 90], "i1")
    np.testing.assert_array_equal(floats(gltf, number, "SCALAR", tmp_path)[:, 0], [-7, 90])


def test_strides_and_offsets_select_the_right_bytes(tmp_path: Path) -> None:
    gltf = Gltf()
    rows = np.arange(5 * 8, dtype="<f4").reshape(5, 8)
    view = gltf.view(b"\0" * 8 + rows.tobytes(), byteStride=32)
    kind = {"componentType": 5126, "type": "VEC3"}
    number = gltf.put("accessors", bufferView=view, byteOffset=8 + 12, count=5, **kind)
    np.testing.assert_array_equal(floats(gltf, number, "VEC3", tmp_path), rows[:, 3:6])


@pytest.mark.parametrize("has_base", [True, False])
def test_sparse_accessors_are_applied(has_base: bool, tmp_path: Path) -> None:
    gltf = Gltf()
    base = np.arange(12, dtype=float).reshape(4, 3) if has_base else np.zeros((4, 3))
    indices = {"bufferView": gltf.view(bytes([0, 3])), "componentType": 5121}
    values = {"bufferView": gltf.view(np.full((2, 3), 7, "<f4").tobytes())}
    sparse = {"count": 2, "indices": indices, "values": values}
    if has_base:
        number = gltf.array(base, sparse=sparse)
    else:
        number = gltf.put("accessors", componentType=5126, type="VEC3", count=4, sparse=sparse)
    base[[0, 3]] = 7
    np.testing.assert_array_equal(floats(gltf, number, "VEC3", tmp_path), base)


# -- time --------------------------------------------------------------------------------------------------

TIMES = st.lists(st.integers(0, 400), min_size=1, max_size=6, unique=True).map(lambda t: np.sort(t) / 37)


@given(TIMES, st.integers(0, 2**32 - 1))
def test_linear_and_step_follow_the_standard_and_clamp(keys: np.ndarray, seed: int) -> None:
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(len(keys), 3))
    times = np.append(rng.uniform(-1, 13, 20), keys)
    linear = Sampler(keys, values).at(times)
    np.testing.assert_allclose(
        linear, np.stack([np.interp(times, keys, v) for v in values.T], axis=1), atol=1e-12
    )
    stepped = [values[max(i - 1, 0)] for i in np.searchsorted(keys, times, side="right")]
    np.testing.assert_array_equal(Sampler(keys, values, "STEP").at(times), stepped)


@given(TIMES.filter(lambda t: len(t) > 1), st.integers(0, 2**32 - 1))
def test_rotations_take_the_shorter_arc_at_even_speed(keys: np.ndarray, seed: int) -> None:
    rng = np.random.default_rng(seed)
    turns = Rotation.random(len(keys), rng=rng)
    signs = rng.choice([-1.0, 1.0], (len(keys), 1))  # q and -q are one rotation
    times = rng.uniform(keys[0], keys[-1], 20)
    found = Sampler(keys, turns.as_quat() * signs, is_rotation=True).at(times)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, atol=1e-12)
    angles = (Rotation.from_quat(found) * Slerp(keys, turns)(times).inv()).magnitude()
    assert angles.max() < 1e-6


@given(st.integers(0, 2**32 - 1))
def test_a_cubic_spline_passes_through_any_cubic(seed: int) -> None:
    rng = np.random.default_rng(seed)
    polynomials = [np.polynomial.Polynomial(rng.normal(size=4)) for _ in range(2)]
    keys = np.cumsum(rng.uniform(0.1, 2, 4))
    values = np.stack([p(keys) for p in polynomials], axis=1)
    slopes = np.stack([p.deriv()(keys) for p in polynomials], axis=1)
    times = rng.uniform(keys[0], keys[-1], 20)
    found = Sampler(keys, values, "CUBICSPLINE", (slopes, slopes)).at(times)
    np.testing.assert_allclose(found, np.stack([p(times) for p in polynomials], axis=1), atol=1e-9)
    clamped = Sampler(keys, values, "CUBICSPLINE", (slopes, slopes)).at(np.array([-9.0, 99.0]))
    np.testing.assert_array_equal(clamped, values[[0, -1]])


@pytest.mark.parametrize(
    ("interpolation", "values", "middle"),
    [
        ("LINEAR", [[0, 0, 0], [4, 2, -6]], [1, 0.5, -1.5]),
        ("STEP", [[0, 0, 0], [4, 2, -6]], [0, 0, 0]),
        # tangent in, value, tangent out of both keys; at s = 1/4 over 2 s the weights of the standard are
        # h00 = 27/32, h10 = 9/64, h01 = 5/32, h11 = -3/64, the tangents times 2 s
        (
            "CUBICSPLINE",
            [[9, 9, 9], [1, 0, 0], [0, 3, 0], [0, 0, 8], [2, 0, 0], [9, 9, 9]],
            [27 / 32 + 2 * 5 / 32, 3 * 2 * 9 / 64, 8 * 2 * -3 / 64],
        ),
    ],
)
def test_a_translated_node_follows_the_standard(
    interpolation: str, values: list, middle: list, tmp_path: Path
) -> None:
    model = Model(moving_cube(values, [1, 3], interpolation).save(tmp_path / "a.gltf"))
    first = values[1] if interpolation == "CUBICSPLINE" else values[0]
    last = values[4] if interpolation == "CUBICSPLINE" else values[1]
    found = at(model, [0, 1, 1.5, 3, 7])
    expected = CUBE[CUBE_FACES.reshape(-1)] + np.array([first, first, middle, last, last])[:, None]
    np.testing.assert_allclose(found, expected, atol=1e-6)


# -- nodes -------------------------------------------------------------------------------------------------


def test_a_tree_of_nodes_multiplies_from_the_root(tmp_path: Path) -> None:
    gltf = Gltf()
    mesh = gltf.mesh(TRIANGLE)
    turn, size = Rotation.from_euler("xyz", [0.3, 0.5, -1.1]), np.array([1.0, 2.0, 0.5])
    gltf.put(
        "nodes", children=[2], translation=[1, 2, 3], rotation=turn.as_quat().tolist(), scale=size.tolist()
    )
    gltf.put("nodes", mesh=mesh)
    columns = [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 5, 0, 0, 1]
    gltf.put("nodes", mesh=mesh, matrix=columns)
    found = at(Model(gltf.save(tmp_path / "a.gltf")), [0], None)[0]
    inner = np.array(TRIANGLE) @ np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]]) + [5, 0, 0]
    expected = [np.array(TRIANGLE, float), turn.apply(inner * size) + np.array([1, 2, 3])]
    np.testing.assert_allclose(found, np.concatenate(expected), atol=1e-12)


def test_only_nodes_of_the_scene_are_read(tmp_path: Path) -> None:
    gltf = Gltf()
    mesh = gltf.mesh(TRIANGLE)
    for i in range(3):
        gltf.put("nodes", mesh=mesh, translation=[i, 0, 0])
    gltf.put("scenes", nodes=[0])
    gltf.put("scenes", nodes=[2])
    gltf.json["scene"] = 1
    np.testing.assert_array_equal(at(Model(gltf.save(tmp_path / "a.gltf")), [0], None)[0, 0], [2, 0, 0])


def test_strips_and_fans_are_split_by_the_standard(tmp_path: Path) -> None:
    points = [[i, i * i, 0] for i in range(5)]
    for mode, expected in ((5, [[0, 1, 2], [1, 3, 2], [2, 3, 4]]), (6, [[1, 2, 0], [2, 3, 0], [3, 4, 0]])):
        gltf = Gltf()
        gltf.put("nodes", mesh=gltf.mesh(points, mode=mode))
        model = Model(gltf.save(tmp_path / "a.gltf"))
        np.testing.assert_array_equal(model.triangles, expected)


def test_mirrored_triangles_are_flipped(tmp_path: Path) -> None:
    gltf = Gltf()
    gltf.put("nodes", mesh=gltf.mesh(TRIANGLE), scale=[-1, 1, 1])
    model = Model(gltf.save(tmp_path / "a.gltf"))
    a, b, c = at(model, [0], None)[0][model.triangles[0]]
    assert np.cross(b - a, c - a)[2] > 0  # the front side is preserved


def test_a_bending_bone_moves_its_vertices(tmp_path: Path) -> None:
    model = Model(everything().save(tmp_path / "a.gltf"))
    found = at(model, [0.1])[0][:12]
    bent = np.array([[1 - y, 1 + x, z] for y in (0, 1, 2) for x in (0, 1) for z in (0, 1)], float)
    at_rest = np.array([[x, y, z] for y in (0, 1, 2) for x in (0, 1) for z in (0, 1)], float)
    np.testing.assert_allclose(found[:4], at_rest[:4], atol=1e-7)
    np.testing.assert_allclose(found[8:], bent[8:], atol=1e-7)
    weight = 127 / 255
    np.testing.assert_allclose(found[4:8], (1 - weight) * at_rest[4:8] + weight * bent[4:8], atol=1e-6)


def test_two_sets_of_joints_count_together_and_the_node_of_a_skin_does_not(tmp_path: Path) -> None:
    gltf = Gltf()
    nodes = [gltf.put("nodes", translation=[float(i), 0, 0]) for i in range(5)]
    sets = {
        "JOINTS_0": gltf.array([[0, 1, 2, 3]] * 3, "<u2"),
        "WEIGHTS_0": gltf.array([[0.2, 0.1, 0.1, 0.1]] * 3),
        "JOINTS_1": gltf.array([[4, 0, 0, 0]] * 3, "u1"),
        "WEIGHTS_1": gltf.array([[0.5, 0, 0, 0]] * 3),
    }
    skin = gltf.put("skins", joints=nodes)
    gltf.put("nodes", mesh=gltf.mesh(TRIANGLE, **sets), skin=skin, translation=[0, 99, 0])
    found = at(Model(gltf.save(tmp_path / "a.gltf")), [0], None)[0]
    np.testing.assert_allclose(found, np.array(TRIANGLE) + np.array([0.1 + 0.2 + 0.3 + 2.0, 0, 0]), atol=1e-6)


def test_a_vertex_without_weights_goes_with_its_first_joint(tmp_path: Path) -> None:
    gltf = Gltf()
    nodes = [gltf.put("nodes", translation=[float(i), 0, 0]) for i in range(2)]
    joints = gltf.array([[1, 0, 0, 0]] * 3, "u1")
    weights = gltf.array([[0, 0, 0, 0], [0, 3, 0, 0], [2, 2, 0, 0]])  # other sums are normalised
    gltf.put(
        "nodes",
        mesh=gltf.mesh(TRIANGLE, JOINTS_0=joints, WEIGHTS_0=weights),
        skin=gltf.put("skins", joints=nodes),
    )
    found = at(Model(gltf.save(tmp_path / "a.gltf")), [0], None)[0]
    np.testing.assert_allclose((found - TRIANGLE)[:, 0], [1, 0, 0.5], atol=1e-12)


def test_morph_targets_are_added_with_their_weights(tmp_path: Path) -> None:
    model = Model(everything().save(tmp_path / "a.gltf"))
    odd = np.zeros((8, 3))
    odd[1], odd[3] = [0, 0, 1], [0, 1, 0]
    rest, mixed = at(model, [0], None)[0][12:20], at(model, [0.075])[0][12:20]
    np.testing.assert_allclose(rest, CUBE + 0.5 * CUBE * 0.5, atol=1e-7)
    np.testing.assert_allclose(mixed, CUBE + 0.5 * (0.5 * CUBE) + 0.5 * -CUBE + 0.5 * odd, atol=1e-6)


def test_a_glb_may_pad_its_bytes(tmp_path: Path) -> None:
    gltf = moving_cube()
    gltf.save(tmp_path / "a.glb", "glb")
    (tmp_path / "b.glb").write_bytes(glb(json.dumps(gltf.json).encode(), bytes(gltf.data) + b"\0\0\0"))
    assert len(Model(tmp_path / "b.glb").at_rest()) == 36
