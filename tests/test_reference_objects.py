"""docs/format.md is enough for files of objects too: poses, fields and forces of a decoder that follows it alone."""

from __future__ import annotations

import importlib
import io
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from object_makers import F0_N, head_of, moving_scene, tumbling
from touchfield.codec.objects import ObjectsEncoder
from touchfield.codec.paper.spec import PaperSpec
from touchfield.codec.pose_track import PoseSteps, decode_poses, encode_poses
from touchfield.container import TouchReader, TouchWriter
from touchfield.errors import FormatError
from touchfield.job.object_stream import ObjectStream, write_objects
from touchfield.medium import HapticScene, PoseTrack

CONFORMANCE = Path(__file__).resolve().parents[1] / "conformance"
GOLDEN = sorted((CONFORMANCE / "v0").glob("objects-*.touch"))
SAMPLE_ATOL_N = 2e-6
"""Sums in another order, rounded to f32, of some newtons."""


@pytest.fixture(scope="module")
def reference() -> Any:
    """The reference decoder, which is two scripts beside each other."""
    sys.path.insert(0, str(CONFORMANCE))
    try:
        return importlib.import_module("reference_objects")
    finally:
        sys.path.remove(str(CONFORMANCE))


def written(path: Path, scene: HapticScene, spec: PaperSpec) -> bytes:
    """A file of a scene."""
    encoder = ObjectsEncoder(scene, spec, F0_N)
    with TouchWriter(path) as writer:
        writer.write_head(head_of(scene, encoder, spec), {"source": "a test, größer als nichts"})
        write_objects(writer, encoder, len(scene))
    return path.read_bytes()


def assert_same(reference: Any, data: bytes, expected: dict[str, Any] | None = None) -> None:
    """Numbers of poses and fields are the same; poses and forces to rounding."""
    mine = reference.decode_scene(data)
    with TouchReader(io.BytesIO(data)) as reader:
        stream = ObjectStream(reader)
        scene = stream.scene
        assert mine.surface_damping == scene.surface_damping_n_s_per_m
        for body, one in zip(mine.bodies, scene.objects, strict=True):
            assert body.name == one.name and body.is_deforming != one.is_rigid
            steps = np.rint(one.track.positions_m / body.steps[0])
            np.testing.assert_array_equal(np.array(body.numbers)[:, :3], steps)
            np.testing.assert_array_equal(body.positions_m, one.track.positions_m)
            turned = np.abs((body.quaternions * one.track.quaternions).sum(axis=1))  # of either sign
            np.testing.assert_allclose(turned, 1.0, atol=1e-15, rtol=0)
            assert len(body.forces_n) == len(one.medium)
            for own, field in zip(body.forces_n, one.medium, strict=True):
                np.testing.assert_array_equal(own, field.to_dense())
        forces_n = mine.voxels()
        points = scene.grid.to_m(np.moveaxis(np.indices(scene.grid.shape), 0, -1))
        for frame in range(len(scene)):
            np.testing.assert_allclose(forces_n[frame], scene.sample_n(frame, points), atol=SAMPLE_ATOL_N, rtol=0)
    if expected is not None:
        np.testing.assert_allclose(forces_n, expected["forces_n"], atol=SAMPLE_ATOL_N, rtol=0)


def test_there_are_golden_streams_of_both_kinds() -> None:
    assert [path.stem for path in GOLDEN] == ["objects-deforming", "objects-rigid"]


@pytest.mark.parametrize("stream", GOLDEN, ids=lambda p: p.stem)
def test_golden_streams(reference: Any, stream: Path) -> None:
    with np.load(stream.with_suffix(".npz")) as expected:
        assert_same(reference, stream.read_bytes(), expected)
        largest = np.sqrt((expected["forces_n"] ** 2).sum(axis=-1)).max()
        assert largest == pytest.approx(reference.decode_scene(stream.read_bytes()).head["force_max_n"])  # it clips


@pytest.mark.parametrize("stream", GOLDEN, ids=lambda p: p.stem)
def test_golden_objects(reference: Any, stream: Path) -> None:
    mine = reference.decode_scene(stream.read_bytes())
    with np.load(stream.with_suffix(".objects.npz")) as expected, TouchReader(stream) as reader:
        theirs = ObjectStream(reader).scene.objects
        for i, (body, one) in enumerate(zip(mine.bodies, theirs, strict=True)):
            np.testing.assert_array_equal(body.positions_m, expected["positions_m"][i])
            np.testing.assert_array_equal(np.stack(body.forces_n), expected[f"forces_n_{i}"])
            np.testing.assert_array_equal(np.stack([f.to_dense() for f in one.medium]), expected[f"forces_n_{i}"])
            np.testing.assert_array_equal(one.track.positions_m, expected["positions_m"][i])
            np.testing.assert_allclose(one.track.quaternions, expected["quaternions"][i], atol=1e-15, rtol=0)


@pytest.mark.parametrize("deforming", [False, True])
@pytest.mark.parametrize("surface_damping", [0.0, 0.75])
def test_streams_of_the_encoder(reference: Any, tmp_path: Path, deforming: bool, surface_damping: float) -> None:
    spec = PaperSpec(segment_frames=3, directions="ico3")
    assert_same(reference, written(tmp_path / "a.touch", moving_scene(5, deforming, surface_damping), spec))


@pytest.mark.parametrize("seed", range(4))
def test_poses_of_any_kind(reference: Any, seed: int) -> None:
    """Large jumps, long stretches of nothing, smooth and rough motion."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 40))
    position = np.cumsum(rng.normal(size=(count, 3)) * 10.0 ** rng.integers(-5, 6, size=(count, 1)), axis=0)
    position[:, seed % 3] = position[0, seed % 3]
    turns = rng.normal(size=(count, 4)) if seed % 2 else tumbling(count, 0.0, 0.1).quaternions
    track = PoseTrack(turns / np.sqrt((turns * turns).sum(axis=1, keepdims=True)), position)
    steps = PoseSteps(2.0**-12, 2.0**-9)
    data = encode_poses(track, steps)
    numbers = np.array(reference.decode_poses(data, count, 512))
    decoded = decode_poses(data, count, steps)
    np.testing.assert_array_equal(numbers[:, :3] * steps.position_m, decoded.positions_m)
    units = numbers[:, 3:] / np.sqrt((numbers[:, 3:] ** 2).sum(axis=1, keepdims=True))
    np.testing.assert_allclose(np.abs((units * decoded.quaternions).sum(axis=1)), 1.0, atol=1e-15, rtol=0)


def test_both_refuse_the_same_poses(reference: Any) -> None:
    """Changed codes: what one decoder refuses the other refuses, and what both take is the same."""
    rng = np.random.default_rng(3)
    steps = PoseSteps(2.0**-14, 2.0**-8)
    codes = [
        encode_poses(track, steps) for track in (tumbling(6, 0.1, 0.3), tumbling(6, 0.0, 0.0), PoseTrack.still(6))
    ]
    taken = refused = 0
    for _ in range(300):
        code = bytearray(codes[rng.integers(len(codes))])
        if code and rng.random() < 0.9:
            code[rng.integers(len(code))] ^= 1 << rng.integers(8)
        changed = bytes(code[: len(code) - (rng.random() < 0.1)]) + bytes(rng.integers(0, 2) * (rng.random() < 0.1))
        try:
            expected = decode_poses(changed, 6, steps).positions_m
        except FormatError:
            refused += 1
            with pytest.raises(ValueError, match=r"\S"):
                reference.decode_poses(changed, 6, 256)
            continue
        taken += 1
        mine = np.array(reference.decode_poses(changed, 6, 256))
        np.testing.assert_array_equal(mine[:, :3] * steps.position_m, expected)
    assert taken > 20 and refused > 20


def test_changed_files_are_refused(reference: Any) -> None:
    data = GOLDEN[0].read_bytes()
    reference.decode_scene(data)
    rng = np.random.default_rng(1)
    for place in rng.choice(len(data), 60, replace=False).tolist():
        damaged = bytearray(data)
        damaged[place] ^= 1 << int(rng.integers(8))
        with pytest.raises(ValueError, match=r"\S"):
            reference.decode_scene(bytes(damaged))
        with pytest.raises(ValueError, match=r"\S"):
            reference.decode_scene(data[:place])


def test_the_command_line_needs_nothing_of_the_package(tmp_path: Path) -> None:
    script, out = CONFORMANCE / "reference_decoder.py", tmp_path / "a.npz"
    blocked = "import sys, runpy; sys.modules['touchfield'] = sys.modules['numba'] = None; "
    place = f"sys.path.insert(0, {str(CONFORMANCE)!r}); sys.argv[1:] = {[str(GOLDEN[0]), str(out)]!r}; "
    code = f"{blocked}{place}runpy.run_path({str(script)!r}, run_name='__main__')"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
    with np.load(out) as saved, np.load(GOLDEN[0].with_suffix(".npz")) as expected:
        np.testing.assert_allclose(saved["forces_n"], expected["forces_n"], atol=SAMPLE_ATOL_N, rtol=0)
        np.testing.assert_array_equal(saved["origin_m"], expected["origin_m"])
