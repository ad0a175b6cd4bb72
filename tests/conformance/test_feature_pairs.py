"""Every pair of optional features of a stream: three decoders agree, or the pair is refused in one line.

A feature is an option of `encode`, or an operation on a stream. Two features that set the same option to
different values are no pair.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from second import decoder
from test_c import COMPILER, OBJECTS_ATOL_N, Raw, built, run

from touchfield import pipeline
from touchfield.errors import InvalidArgument
from touchfield.medium import PoseTrack
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.physics.body_scene import BodyScene
from touchfield.sources.scene import UP_Z_AXES, Body
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Box, Sphere
from touchfield.tasks import editing

FRAMES = 5
DEFAULT_SPEC = EncodeSpec(nw=3, mapping="crop", representation="voxel")

FEATURES: dict[str, dict[str, Any]] = {
    "vibration": {"vibration": "gain=0.25,frequency=80..240"},
    "objects": {"representation": "object"},
    "array": {"device": "tactile-vest-8x8"},
    "paper": {"coder": "paper"},
    "lossless": {"touch.mode": "lossless"},
    "directions": {"touch.mode": "mask-direction"},
    "nmse": {"touch.mode": "nmse"},
    "exact support": {"touch.support": "exact"},
    "masking": {"touch.masking": 0.2, "touch.masking_radius_m": 0.05},
    "no F_0": {"touch.f0_n": 0.0},
    "fast": {"touch.effort": "fast"},
    "each frame alone": {"touch.interframe": "off"},
    "segments": {"touch.segment_frames": 2},
    "law": {"law": "penalty+proximity"},
    "surface damping": {"surface_damping_n_s_per_m": 2.0},
    "coefficients": {"friction": 0.3, "damping_n_s_per_m": 0.5},
    "gaussian": {"filters": (("gaussian", "3mm"),)},
    "frames": {"frames": (1, 4)},
}

REFUSED_PAIRS = {
    frozenset(pair): message
    for message, pairs in {
        "voxel": [("vibration", "objects"), ("objects", "array"), ("objects", "masking")],
        "works with coder touch, not with paper": [
            ("paper", name)
            for name in ("lossless", "directions", "nmse", "exact support", "masking", "no F_0", "fast")
        ],
        "works with coder touch, not with paper ": [("paper", "each frame alone"), ("paper", "segments")],
        "mode mask only": [("masking", name) for name in ("lossless", "directions", "nmse")],
    }.items()
    for pair in pairs
}
"""Pairs that must not be combined, each with a part of the error message."""

PAIRS = [
    pair
    for pair in itertools.combinations(FEATURES, 2)
    if not FEATURES[pair[0]].keys() & FEATURES[pair[1]].keys() or frozenset(pair) in REFUSED_PAIRS
]


def scene() -> BodyScene:
    """A ball that tumbles and falls next to a block at rest."""
    t = np.arange(FRAMES)
    half = 0.05 * t
    turns = np.stack([np.cos(half), 0 * half, np.sin(half), 0 * half], axis=1)
    ball = Sphere((0.004, 0.0, 0.0), 0.025)
    way = PoseTrack(turns, np.stack([0.02 + 0.001 * t, 0 * half, 0.02 - 0.002 * t], axis=1))
    block = Box((0.0, 0.0, 0.0), (0.03, 0.02, 0.015))
    bodies = [
        Body("ball", AnalyticScene((ball,), "union", UP_Z_AXES), way),
        Body(
            "block",
            AnalyticScene((block,), "union", UP_Z_AXES),
            PoseTrack.constant(FRAMES, (-0.03, 0.0, -0.01)),
        ),
    ]
    return BodyScene(bodies, 50.0)


def spec_of(*names: str) -> EncodeSpec:
    """The options for these features."""
    spec = DEFAULT_SPEC
    for key, value in (item for name in names for item in FEATURES[name].items()):
        outer, _, inner = key.partition(".")
        spec = replace(spec, **{outer: replace(getattr(spec, outer), **{inner: value}) if inner else value})
    return spec


class Decoded(NamedTuple):
    """Forces [frames, x, y, z, 3], and amplitudes and Hz [frames, x, y, z, 2] if there is a vibration."""

    forces: np.ndarray
    vibration: np.ndarray | None


def by_the_package(path: Path) -> Decoded:
    with pipeline.open_file(path) as stream:
        frames = range(len(stream.medium))
        band, forces = stream.medium.vibration, np.stack([stream.medium[i].to_dense() for i in frames])
        both = None if band is None else np.stack([band(i).as_field().to_dense()[..., :2] for i in frames])
    return Decoded(forces, both)


def by_the_reference_decoder(path: Path) -> Decoded:
    found = decoder.decode(path)
    names = "amplitudes_n", "frequencies_hz"
    both = np.stack([found[name] for name in names], axis=-1) if names[0] in found else None
    return Decoded(found["forces_n"], both)


def by_c(program: Path, path: Path, like: Decoded) -> Decoded:
    assert run(program, path, path.with_suffix(".raw")) == (0, "0")
    is_placed = b"\x07\x00objects" in path.read_bytes()
    shape = like.forces.shape[1:4]
    raw, forces, both = Raw(path.with_suffix(".raw").read_bytes(), shape), [], []
    for _ in range(len(like.forces)):
        forces.append(
            raw.numbers("<f4", 3 * int(np.prod(shape))).reshape(*shape, 3) if is_placed else raw.field()
        )
        both.append(raw.field()[..., :2])
    assert raw.at == len(raw.data)
    return Decoded(np.stack(forces), None if like.vibration is None else np.stack(both))


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path | None:
    return built(tmp_path_factory.mktemp("c"), "touch_decode", "-O1") if COMPILER else None


def assert_alike(path: Path, program: Path | None) -> Decoded:
    """Check that all decoders agree; return the package's result."""
    expected = by_the_package(path)
    with pipeline.open_file(path) as stream:
        has_objects, coder = stream.scene is not None, stream.reader.head.coder
    results = [by_the_reference_decoder(path)]
    if program is not None and coder != "paper" and b"\x05\x00paper" not in path.read_bytes():
        results.append(by_c(program, path, expected))
    for found in results:
        if has_objects:
            np.testing.assert_allclose(found.forces, expected.forces, rtol=0, atol=OBJECTS_ATOL_N)
        else:
            np.testing.assert_array_equal(found.forces, expected.forces)
        assert (found.vibration is None) == (expected.vibration is None)
        if expected.vibration is not None:
            np.testing.assert_array_equal(found.vibration, expected.vibration)
    return expected


def check(names: tuple[str, ...], program: Path | None, folder: Path) -> Path:
    """Encode with some features; check that the file has them and that all decoders agree."""
    path, spec = folder / "pair.touch", spec_of(*names)
    pipeline.encode(scene(), path, spec)
    found = assert_alike(path, program)
    with pipeline.open_file(path) as stream:
        summary, head, reader = stream.summary(), stream.reader.head, stream.reader
        assert len(found.forces) == head.frame_count == (3 if "frames" in names else FRAMES)
        assert found.forces.any() and (found.vibration is not None) == ("vibration" in names)
        assert (stream.scene is not None) == ("objects" in names)
        if "coefficients" in names:
            assert (head.friction, head.damping_n_s_per_m) == (0.3, 0.5)
        if "segments" in names and "objects" not in names:
            assert len(reader.segments) == -(-head.frame_count // 2)
        for name, mode in (("lossless", "lossless"), ("directions", "mask-direction"), ("nmse", "nmse")):
            assert name not in names or summary["mode"] == mode
        assert head.device_type == (2 if "array" in names else 1)
    if "objects" not in names:
        assert_within_bound(names, spec, found)
    return path


def assert_within_bound(names: tuple[str, ...], spec: EncodeSpec, found: Decoded) -> None:
    """Check the mask, or exact equality, of the decoded voxels against the source."""
    prepared = pipeline.prepare(scene(), spec)
    source = np.stack([frame.to_dense() for frame in prepared.medium]).astype(np.float64)
    error, size = (np.linalg.norm(v, axis=-1) for v in (found.forces - source, source))
    if "lossless" in names:
        assert not error.any()
    elif not {"paper", "nmse", "directions", "masking"} & set(names):
        coding = prepared.spec.touch
        assert (error <= np.maximum(coding.f0_n, coding.k * size) * (1 + 1e-9)).all()
    if "exact support" in names:
        np.testing.assert_array_equal(found.forces.any(-1), source.any(-1))


@pytest.mark.parametrize("name", FEATURES)
def test_single_feature(name: str, program: Path | None, tmp_path: Path) -> None:
    check((name,), program, tmp_path)


@pytest.mark.thorough
@pytest.mark.parametrize("pair", PAIRS, ids=" x ".join)
def test_pair_is_decoded_by_all_or_refused(
    pair: tuple[str, str], program: Path | None, tmp_path: Path
) -> None:
    if frozenset(pair) not in REFUSED_PAIRS:
        check(pair, program, tmp_path)
        return
    with pytest.raises(InvalidArgument) as caught:
        pipeline.encode(scene(), tmp_path / "pair.touch", spec_of(*pair))
    assert REFUSED_PAIRS[frozenset(pair)].strip() in str(caught.value) and "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())  # no file is left


OPERATIONS: dict[str, Callable[[Path, Path, EncodeSpec], Any]] = {
    "trim": lambda path, out, spec: pipeline.encode(path, out, replace(spec, frames=(1, 3))),
    "edit": lambda path, out, spec: editing.edit(path, out, operators=["gain:0.5"], spec=spec),
    "splice": lambda path, out, spec: editing.splice([str(path), f"{path}@1:3"], out, spec=spec),
    "rate": lambda path, out, spec: editing.resample_file(path, out, rate_hz=30.0, spec=spec),
    "lattice": lambda path, out, spec: editing.resample_file(path, out, (None, (6, 7, 5), None), spec=spec),
    "coarse": lambda path, out, spec: editing.levels_of_detail(path, out.with_suffix(""), 1, spec=spec),
}


@pytest.mark.thorough
@pytest.mark.parametrize("operation", OPERATIONS)
@pytest.mark.parametrize("name", FEATURES)
def test_operations_on_a_stream_with_a_feature(
    name: str, operation: str, program: Path | None, tmp_path: Path
) -> None:
    path, out = check((name,), program, tmp_path), tmp_path / "out.touch"
    coding = replace(spec_of(*({name} & {"paper", "lossless"})), nw=7, mapping="fit", representation="auto")
    result = OPERATIONS[operation](path, out, coding)
    found = assert_alike(tmp_path / "out" / "level-1.touch" if operation == "coarse" else out, program)
    assert found.forces.any()
    if name == "lossless" and operation == "trim":
        np.testing.assert_array_equal(found.forces, by_the_package(path).forces[1:3])
    # operations that keep the lattice keep the vibration; all others note its removal
    if name == "vibration":
        is_left_out = operation not in ("trim", "edit")
        assert (found.vibration is None) == is_left_out
        assert not is_left_out or any("the vibration is left out" in note for note in result.notes)
