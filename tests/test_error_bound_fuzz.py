"""Search for voxels beyond the error bound in hostile fields and scenes of bodies, by `independent_bound`.

``TOUCHFIELD_FUZZ_SEED`` selects another search, ``TOUCHFIELD_FUZZ_SHARE`` a fraction of it (0.1 is a tenth).
A failure names the seed and the case; ``TOUCHFIELD_FUZZ_CASE`` runs that case alone.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest

from independent_bound import (
    Body,
    composed_ratio,
    direction_ratio,
    displacement_m,
    hidden_n,
    mask_ratio,
    same_bits,
    same_support,
)
from object_makers import head_of
from touchfield.codec.objects.encoder import PLACE_TOLERANCE_M, ObjectsEncoder
from touchfield.codec.paper.decoder import PaperDecoder
from touchfield.codec.paper.encoder import PaperEncoder
from touchfield.codec.paper.spec import PaperSpec
from touchfield.codec.segment import MaxError
from touchfield.codec.touch.decoder import TouchDecoder
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.container import TouchReader, TouchWriter
from touchfield.errors import InvalidArgument
from touchfield.medium import ForceField, Grid, HapticMedium, HapticObject, HapticScene, PoseTrack
from touchfield.pipeline.decoded_objects import SceneStream
from touchfield.pipeline.encoding import write_objects

SEED = int(os.environ.get("TOUCHFIELD_FUZZ_SEED", "1"))
FRACTION = float(os.environ.get("TOUCHFIELD_FUZZ_SHARE", "1"))
ALONE = os.environ.get("TOUCHFIELD_FUZZ_CASE")
FIELDS, SCENES = max(1, int(3000 * FRACTION)), max(1, int(200 * FRACTION))
ROUNDING = 1 + 1e-9  # of float64, in a ratio

K = (0.001, 0.0011, 0.01, 0.1, 0.3, 0.7, 0.999)
F0_N = (0.0, 0.0, 1e-30, 1e-9, 1e-3, 0.05, 1.0, 1e3, 1e5)
KINDS = (
    "constant",
    "few values",
    "negative zeros",
    "subnormal",
    "huge",
    "decades",
    "sparse",
    "smooth",
    "checkerboard",
    "threshold",
    "line",
    "one voxel",
    "wall",
    "noise",
    "nothing",
)


def _each(count: int, check: Callable[[np.random.Generator], object], kind: str) -> None:
    """Run the cases of a kind; each depends on the seed and its number only."""
    for case in range(count) if ALONE is None else [int(ALONE)]:
        rng = np.random.default_rng([SEED, len(kind), case])
        try:
            check(rng)
        except BaseException as error:
            error.add_note(f"{kind} {case}: TOUCHFIELD_FUZZ_SEED={SEED} TOUCHFIELD_FUZZ_CASE={case}")
            raise


# -- fields ------------------------------------------------------------------------------------------------


def _shape(rng: np.random.Generator) -> tuple[int, int, int]:
    if rng.random() < 0.1:
        return 1, 1, 1
    max_side = int(rng.choice([2, 5, 9, 20]))
    x, y, z = rng.integers(1, max_side + 1, 3).tolist()
    return x, y, z


def _forces(rng: np.random.Generator, shape: tuple[int, int, int], f0_n: float) -> np.ndarray:
    """Float32 newtons [x, y, z, 3] of a random kind."""
    kind, f = str(rng.choice(KINDS)), np.zeros((*shape, 3))
    full = rng.normal(size=f.shape)
    some = rng.random(shape) < rng.choice([0.02, 0.3, 0.9])
    if kind == "constant":
        f[:] = rng.normal(size=3) * 10.0 ** rng.integers(-6, 5)
    elif kind == "few values":
        f[:] = rng.normal(size=(3, 3))[rng.integers(0, 3, shape)]
    elif kind == "negative zeros":
        f[:] = -0.0
        f[some] = full[some] * rng.choice([0.0, 1.0], 3)
    elif kind == "subnormal":
        f[some] = full[some] * 1e-40
    elif kind == "huge":
        f[some] = full[some] * 10.0 ** rng.uniform(20, 35)
    elif kind == "decades":
        f[some] = full[some] * 10.0 ** rng.uniform(-38, 35, (np.count_nonzero(some), 1))
    elif kind == "sparse":
        f[some] = full[some]
    elif kind == "smooth":
        x, y, z = np.indices(shape)
        f[:] = np.stack([np.sin(x / 5 + full.flat[0]), np.cos(y / 4), 1 + z / 9], axis=-1)
    elif kind == "checkerboard":
        f[np.indices(shape).sum(axis=0) % 2 == 0] = full[0, 0, 0]
    elif kind == "threshold":  # |F| at F_0 and its neighbours among the float32
        size = np.float32(min(max(f0_n, 1e-30), 1e30))
        f[some, int(rng.integers(3))] = size * (1 + 2.0**-23 * rng.integers(-3, 4, np.count_nonzero(some)))
    elif kind == "line":
        f[0, 0] = full[0, 0]
    elif kind == "one voxel":
        f[tuple(rng.integers(0, shape))] = full[0, 0, 0] * 10.0 ** rng.uniform(-10, 10)
    elif kind == "wall":
        depth = np.arange(shape[2]) - shape[2] / 2
        f[..., 2] = np.where(np.abs(depth) < 3, np.sign(depth) * np.abs(depth), 0)
    elif kind == "noise":
        f[:] = full * 0.1
    return f.astype(np.float32)


def _frames(rng: np.random.Generator, shape: tuple[int, int, int], f0_n: float) -> list[np.ndarray]:
    frames = [_forces(rng, shape, f0_n)]
    while rng.random() < 0.5 and len(frames) < 5:
        again = frames[-1].copy()
        way = rng.integers(4)
        if way == 0:
            again = _forces(rng, shape, f0_n)
        elif way == 1:
            again *= np.float32(rng.choice([1.03, 0.5, -1.0]))
        elif way == 2:
            again = np.roll(again, 1, axis=int(rng.integers(3)))
        frames.append(again)
    return frames


def _spec(rng: np.random.Generator) -> TouchSpec:
    spec = TouchSpec(
        k=float(rng.choice(K) if rng.random() < 0.7 else 10 ** rng.uniform(-3, -0.001)),
        f0_n=float(rng.choice(F0_N) if rng.random() < 0.7 else 10 ** rng.uniform(-12, 5)),
        mode=str(rng.choice(["mask", "mask", "mask", "mask-direction", "lossless", "nmse"])),
        direction_jnd_deg=float(rng.choice([0.5, 18.4, 89.0])),
        step_n=float(rng.choice([1e-6, 0.05, 10.0])),
        effort=str(rng.choice(["fast", "default"])),
        support=str(rng.choice(["movable", "movable", "exact"])),
        guess=str(rng.choice(["auto", "auto", "off"])),
        interframe=str(rng.choice(["auto", "auto", "off", "on"])),
    )
    if spec.mode == "mask" and rng.random() < 0.2:
        return replace(spec, masking=float(rng.choice([0.05, 1.0])), masking_radius_m=0.0021)
    return spec


def _check_paper(frames: list[np.ndarray], grid: Grid, rng: np.random.Generator) -> None:
    """Coder paper has no bound: it decodes to finite forces, and states that there is no bound."""
    spec = PaperSpec(k=float(rng.choice([0.05, 0.3])), directions="ico1")
    encoder, fields = PaperEncoder(grid, spec), [ForceField.from_dense(grid, f) for f in frames]
    largest_n = max(float(np.linalg.norm(f.astype(np.float64), axis=-1).max()) for f in frames)
    if largest_n > 1e6:  # no decoder accepts such a level
        with pytest.raises(InvalidArgument):
            encoder.encode_segment(fields)
        return
    if largest_n > 5e5:  # a change between frames may reach such a level
        return
    coded = encoder.encode_segment(fields)
    assert coded.max_error is None
    for field in PaperDecoder(grid, encoder.parameters).frames(coded.body, len(frames)):
        assert np.isfinite(field.forces_n).all()


def _check_worst(worst: MaxError | None, ratio: float) -> None:
    """The ratio stated by a segment is the largest one, rounded up to a whole step."""
    assert worst is not None
    assert ratio / ROUNDING <= worst.ratio <= ratio * ROUNDING + 1 / 65535


def _check_field(rng: np.random.Generator) -> None:
    shape, spec = _shape(rng), _spec(rng)
    grid = Grid(shape, (0.001, 0.002, 0.0015), (0.0, 0.01, -0.02))
    frames = _frames(rng, shape, spec.f0_n)
    draw = rng.random()
    if draw < 0.03:
        _check_refusal(frames, grid, spec, rng)
        return
    if draw < 0.08:
        _check_paper(frames, grid, rng)
        return
    encoder = TouchEncoder(grid, spec)
    fields = [ForceField.from_dense(grid, f) for f in frames]
    more = {}
    if rng.random() < 0.15:
        more["key_frame"] = encoder.key_frame(
            ForceField.from_dense(grid, frames[0] * np.float32(1 + 1e-4)), fields[0]
        )
    if rng.random() < 0.15:  # as in a live stream
        more["longest_n"] = 1.5 * float(
            max(np.linalg.norm(f.astype(np.float64), axis=-1).max() for f in frames)
        )
    coded = encoder.encode_segment(fields, **more)
    decoder = TouchDecoder(grid, encoder.parameters)
    decoded = [field.to_dense() for field in decoder.frames(coded.body, len(frames))]
    decoder.costs(coded.body, len(frames))
    worst = decoder.max_error(coded.body)
    pairs = list(zip(frames, decoded, strict=True))
    if spec.mode == "nmse":
        assert worst is None and coded.max_error is None
        return
    if spec.mode == "lossless":
        assert all((f == d).all() for f, d in pairs) and worst == MaxError(0.0, 0, (0, 0, 0))
        # a field stores no brick of -0.0 alone
        assert all(same_bits(field.to_dense(), d) for field, d in zip(fields, decoded, strict=True))
        return
    if spec.mode == "mask-direction":
        ratio = max(direction_ratio(f, d, spec.k, spec.f0_n, spec.direction_jnd_deg) for f, d in pairs)
        assert ratio <= 1 + 1e-7  # the accuracy of an angle of half a degree
        assert worst is not None and worst.ratio >= ratio - 1e-6
    else:
        neighbours = [
            hidden_n(f, grid.spacing_m, spec.masking, spec.masking_radius_m) if spec.masking else 0.0
            for f in frames
        ]
        ratios = [
            mask_ratio(f, d, spec.k, spec.f0_n, hidden)
            for (f, d), hidden in zip(pairs, neighbours, strict=True)
        ]
        assert max(ratios) <= (1 + 1e-6 if spec.masking else 1)  # the masked part is float32
        if spec.masking:
            assert worst is not None and worst.ratio >= max(ratios) - 1e-6
        else:
            _check_worst(worst, max(ratios))
    if spec.support == "exact":
        assert all(same_support(f, d) for f, d in pairs)


def _check_refusal(frames: list[np.ndarray], grid: Grid, spec: TouchSpec, rng: np.random.Generator) -> None:
    frame = frames[int(rng.integers(len(frames)))]
    frame[tuple(rng.integers(0, frame.shape))] = rng.choice([np.nan, np.inf, -np.inf, 2.0**125])
    with pytest.raises(InvalidArgument):
        TouchEncoder(grid, spec).encode_segment([ForceField.from_dense(grid, f) for f in frames])


@pytest.mark.thorough
def test_no_voxel_of_a_hostile_field_is_beyond_its_bound() -> None:
    _each(FIELDS, _check_field, "field")


# -- scenes of bodies --------------------------------------------------------------------------------------


def _body_forces(rng: np.random.Generator, grid: Grid, force_max_n: float) -> np.ndarray:
    """Float32 newtons of a body: solids and shells with opposite forces within a cell, and hostile fields."""
    kind = str(rng.choice(["solid", "solid", "shell", "noise", "hostile", "thin"]))
    points = np.moveaxis(np.indices(grid.shape), 0, -1) * grid.spacing_m + np.array(grid.origin_m)
    r = np.linalg.norm(points, axis=-1, keepdims=True)
    radius = 0.45 * max(n * h for n, h in zip(grid.shape, grid.spacing_m))
    outward, scale = points / np.maximum(r, 1e-12), force_max_n * 10.0 ** rng.uniform(-4, 1)
    if kind == "solid":
        return (scale * np.clip(1 - r / radius, 0, None) * outward).astype(np.float32)
    if kind == "shell":
        return (scale * np.clip(1 - np.abs(2 * r / radius - 1), 0, None) * outward).astype(np.float32)
    if kind == "thin":  # a sheet that pushes to both sides, so that forces cancel within its cells
        side = np.sign(np.arange(grid.shape[2]) - (grid.shape[2] - 1) / 2)
        f = np.zeros((*grid.shape, 3))
        f[..., 2] = scale * side
        return f.astype(np.float32)
    if kind == "noise":
        some = rng.random(grid.shape) < 0.5
        return (scale * some[..., None] * rng.normal(size=(*grid.shape, 3))).astype(np.float32)
    f = _forces(rng, grid.shape, 0.05)
    return np.clip(f, -1e3 * force_max_n, 1e3 * force_max_n).astype(np.float32)


def _track(rng: np.random.Generator, count: int) -> PoseTrack:
    start = rng.uniform(-0.006, 0.006, 3)
    kind = rng.integers(4)
    if kind == 0:
        return PoseTrack.constant(count, start)
    turns = rng.normal(size=4) + np.cumsum(rng.normal(0, 0.03 if kind < 3 else 2.0, (count, 4)), axis=0)
    ways = np.cumsum(rng.normal(0, 0.0004 if kind < 3 else 0.004, (count, 3)), axis=0)
    if kind == 1:
        turns[:] = turns[0]
    return PoseTrack(turns / np.linalg.norm(turns, axis=1, keepdims=True), start + ways)


def _scene(rng: np.random.Generator) -> HapticScene:
    count, force_max_n = int(rng.integers(1, 6)), float(rng.choice([3.3, 3.3, 1e-3, 1e4]))
    world = Grid(tuple(rng.integers(1, 15, 3).tolist()), (0.001, 0.0013, 0.0009), (-0.006, -0.007, -0.006))
    objects: list[HapticObject] = []
    for n in range(int(rng.integers(1, 5))):
        if objects and rng.random() < 0.25:  # a body that cancels another, at nearly the same position
            other = objects[int(rng.integers(len(objects)))]
            medium = HapticMedium.from_frames([field.scaled(-1.0) for field in other.medium], 200.0)
            track = PoseTrack(
                other.track.quaternions, other.track.positions_m + rng.choice([0.0, 0.0, 1e-7, 3e-4])
            )
            objects.append(HapticObject(f"body {n}", medium, track))
            continue
        shape = tuple(rng.integers(1, 15, 3).tolist())
        grid = Grid(shape, (0.0009,) * 3, tuple(-0.00045 * (s - 1) for s in shape))
        frames = [_body_forces(rng, grid, force_max_n)]
        if rng.random() < 0.25:
            frames += [frames[0] * np.float32(1 + 0.05 * i) for i in range(1, count)]
        medium = HapticMedium.from_frames([ForceField.from_dense(grid, f) for f in frames], 200.0)
        objects.append(HapticObject(f"body {n}", medium, _track(rng, count)))
    damping = float(rng.choice([0.0, 0.0, 0.0, 0.5, 20.0]))
    return HapticScene(world, 200.0, tuple(objects), force_max_n, damping)


def _bodies(scene: HapticScene) -> list[Body]:
    return [
        Body(
            np.stack([field.to_dense() for field in obj.medium]),
            np.array(obj.medium.grid.spacing_m),
            np.array(obj.medium.grid.origin_m),
            obj.track.quaternions,
            obj.track.positions_m,
        )
        for obj in scene.objects
    ]


def _check_scene(rng: np.random.Generator) -> None:
    scene, spec = _scene(rng), _spec(rng)
    mode = "lossless" if rng.random() < 0.1 else "mask"
    spec = replace(spec, mode=mode, masking=0.0, segment_frames=int(rng.integers(1, 4)))
    encoder, file = ObjectsEncoder(scene, spec, spec.f0_n or 0.05), BytesIO()
    refused = ("surface damping", "pose track") if scene.surface_damping_n_s_per_m else ()
    try:
        with TouchWriter(file) as writer:
            head = replace(head_of(scene, encoder), weber_fraction=spec.k, force_threshold_n=spec.f0_n)
            writer.write_head(head)
            write_objects(writer, encoder, len(scene))
    except (
        InvalidArgument
    ) as error:  # a damping too large for the accuracy of coded velocities; always an error
        if not any(text in str(error) for text in refused):
            raise
        return
    file.name = "scene.touch"
    stream = SceneStream(TouchReader(file))
    summary, pairs = stream.summary(), list(zip(_bodies(scene), _bodies(stream.scene), strict=True))
    assert summary["error_bound"] and summary["promise_kept"] is True
    lattice = scene.grid.shape, scene.grid.spacing_m, scene.grid.origin_m
    limits = spec.k, spec.f0_n, scene.force_max_n, scene.surface_damping_n_s_per_m
    ratio = max(composed_ratio(pairs, i, lattice, limits, scene.rate_hz) for i in range(len(scene)))
    assert ratio <= 1
    assert ratio <= summary["worst_mask_ratio"] + 1e-6
    away_m = max(displacement_m(source, decoded, i) for source, decoded in pairs for i in range(len(scene)))
    assert away_m <= PLACE_TOLERANCE_M * ROUNDING


@pytest.mark.thorough
def test_no_voxel_of_composed_bodies_is_beyond_its_bound() -> None:
    _each(SCENES, _check_scene, "scene")
