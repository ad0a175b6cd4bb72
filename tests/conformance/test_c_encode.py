"""`c/touch_encode.h`: stored bytes, the second decoder, and the error bound, for segments of every kind.

`random_bodies.json` has digests of the bodies that the first encoder, in numba, wrote of the random segments;
`random_parts.json` has those of its supports, whole numbers, vibrations and poses.
"""

from __future__ import annotations

import hashlib
import importlib
import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from encode_content import (
    GOLDEN,
    MODES,
    Segment,
    golden_segments,
    lossless_segment,
    random_frames,
    random_poses,
    random_samples,
    random_segment,
    random_support,
    random_vibration,
)
from native_encoder import COMPILER, C, NativeEncoder, build
from second import make_golden

from touchfield.codec.objects.encoder import ObjectsEncoder, encode_poses, round_poses
from touchfield.codec.objects.layout import SegmentParts
from touchfield.codec.support import encode_numbers, encode_support
from touchfield.codec.touch.body import BodyReader
from touchfield.codec.touch.decoder import TouchDecoder
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.codec.vibration import encode_vibration
from touchfield.medium import ForceField, Grid
from touchfield.medium.medium import VibrationFrame

HERE = Path(__file__).parent
WATCHED = ("-g", "-Og", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
SEEDS = 8

pytestmark = pytest.mark.skipif(COMPILER is None, reason="there is no C compiler here")


@pytest.fixture(scope="module")
def native(tmp_path_factory: pytest.TempPathFactory) -> NativeEncoder:
    """The library, compiled with every warning an error."""
    return NativeEncoder(build(tmp_path_factory.mktemp("c"), "-O2"))


BODIES = json.loads((HERE / "random_bodies.json").read_text())
PARTS = json.loads((HERE / "random_parts.json").read_text())
second_decoder: Any = importlib.import_module("decode_touch")


def digest(*bodies: bytes) -> str:
    """What is stored of bodies."""
    return hashlib.sha256(b"".join(bodies)).hexdigest()[:16]


def segment_arguments(segment: Segment) -> tuple[Grid, TouchSpec, list[ForceField]]:
    """The arguments of `NativeEncoder.segment`."""
    return segment.grid, segment.spec, segment.frames


def encoder_of(segment: Segment) -> TouchEncoder:
    """The encoder of the package for a segment."""
    return TouchEncoder(segment.grid, segment.spec)


@pytest.mark.parametrize("seed", range(SEEDS))
@pytest.mark.parametrize("mode", MODES)
def test_random_fields_without_base_layer(mode: str, seed: int, native: NativeEncoder) -> None:
    body = native.segment(*segment_arguments(random_segment(mode, seed, guess="off")))
    assert digest(body) == BODIES["without base layer"][mode][seed]


@pytest.mark.parametrize("seed", range(SEEDS))
@pytest.mark.parametrize("mode", MODES)
def test_random_fields_with_columns(mode: str, seed: int, native: NativeEncoder) -> None:
    body = native.segment(*segment_arguments(random_segment(mode, seed)))
    assert digest(body) == BODIES["with columns"][mode][seed]


def test_the_random_fields_have_base_layers_of_both_kinds(native: NativeEncoder) -> None:
    """Else the tests above would compare frames without any."""
    kinds = set()
    for mode in MODES:
        for seed in range(SEEDS):
            segment = random_segment(mode, seed)
            body = native.segment(*segment_arguments(segment), has_splines=True)
            records = BodyReader(body, segment.grid, exact=False).records(len(segment.frames))
            kinds |= {record.base_layer[0] for record in records if record.base_layer}
    assert kinds == {0, 1}


@pytest.mark.parametrize("seed", range(SEEDS))
@pytest.mark.parametrize("mode", MODES)
def test_random_fields_with_splines(mode: str, seed: int, native: NativeEncoder) -> None:
    """As the package encodes them: sums of float32, in the fit, depend on the vector instructions."""
    segment = random_segment(mode, seed)
    body = native.segment(*segment_arguments(segment), has_splines=True)
    assert body == encoder_of(segment).encode_segment(segment.frames).body


@pytest.mark.parametrize("seed", range(2 * SEEDS))
def test_lossless(seed: int, native: NativeEncoder) -> None:
    body = native.segment(*segment_arguments(lossless_segment(seed)))
    assert digest(body) == BODIES["lossless"][seed]


@pytest.mark.parametrize("name", GOLDEN)
def test_content_of_golden_files(name: str, native: NativeEncoder) -> None:
    """Golden files themselves were written by an earlier encoder: other bytes, the same format."""
    bodies = [native.segment(*segment_arguments(s), has_splines=True) for s in golden_segments(name)]
    assert [digest(body) for body in bodies] == BODIES["golden content"][name]


def bricks_with_force(field: ForceField) -> dict[tuple[int, ...], bytes]:
    """The forces of bricks, as bytes; -0 equals 0."""
    pairs = zip(field.bricks.tolist(), field.forces_n, strict=True)
    return {tuple(brick): (forces + np.float32(0)).tobytes() for brick, forces in pairs if forces.any()}


SMALL_VOXELS = 4000  # the second decoder takes a second for so many


@pytest.mark.parametrize("mode", [*MODES, "lossless"])
def test_the_second_decoder_reads_random_segments(mode: str) -> None:
    """It agrees with the package's, for the smallest of the random grids."""
    count = 0
    for seed in range(40):
        segment = lossless_segment(seed) if mode == "lossless" else random_segment(mode, seed)
        frames = segment.frames[:2]
        if segment.grid.voxel_count * len(frames) > SMALL_VOXELS or not any(len(f.bricks) for f in frames):
            continue
        encoder = encoder_of(segment)
        body, shape = encoder.encode_segment(frames).body, segment.grid.shape
        again = second_decoder.decode_segment(body, encoder.parameters, shape, len(frames))
        for field, bricks in zip(
            TouchDecoder(segment.grid, encoder.parameters).frames(body, len(frames)), again, strict=True
        ):
            expected = {b: (f + np.float32(0)).tobytes() for b, f in bricks.items() if f.any()}
            assert bricks_with_force(field) == expected, seed
        count += 1
    assert count >= 3


@pytest.mark.parametrize("seed", range(SEEDS))
def test_supports(seed: int, native: NativeEncoder) -> None:
    grid, supports = random_support(seed)
    pairs = list(zip(supports, [None, *supports], strict=False))
    coded = [native.support(grid, own, before) for own, before in pairs]
    assert coded == [encode_support(grid, *own, before) for own, before in pairs]
    assert digest(*coded) == PARTS["supports"][seed]


def test_short_codes_are_padded(native: NativeEncoder) -> None:
    """A byte stands for 16 bricks at most, or for a frame of a vibration."""
    grid = Grid((80, 80, 80), (0.001,) * 3, (0.0,) * 3)
    bricks = np.argwhere(np.ones((10, 10, 10))).astype(np.int32)
    mask = np.ones((1000, 8, 8, 8), bool)
    coded = encode_support(grid, bricks, mask, (bricks, mask))
    assert coded[-1] == 0 and native.support(grid, (bricks, mask), (bricks, mask)) == coded
    frames = [VibrationFrame.empty(grid)] * 100
    coded = encode_vibration(frames)
    assert coded[-1] == 0 and native.vibration(frames) == coded


@pytest.mark.parametrize("seed", range(SEEDS))
def test_whole_numbers(seed: int, native: NativeEncoder) -> None:
    rng = np.random.default_rng(seed)
    numbers = np.rint(rng.standard_normal(200 * seed) * 2.0 ** rng.integers(0, 27, 200 * seed)).astype(
        np.int64
    )
    assert native.numbers(numbers) == encode_numbers(numbers)
    assert digest(native.numbers(numbers)) == PARTS["numbers"][seed]
    with pytest.raises(ValueError, match="beyond 2"):
        native.numbers(np.array([1 << 30]))


@pytest.mark.parametrize("seed", range(SEEDS))
def test_vibration(seed: int, native: NativeEncoder) -> None:
    frames = random_vibration(seed)
    assert native.vibration(frames) == encode_vibration(frames)
    golden = [make_golden.hum(t) for t in range(seed)] or [make_golden.hum(4)]
    assert native.vibration(golden) == encode_vibration(golden)
    assert digest(native.vibration(frames), native.vibration(golden)) == PARTS["vibration"][seed]


def test_amplitudes_of_a_vibration_from_the_lowest_to_the_highest(native: NativeEncoder) -> None:
    grid = Grid((1, 1, 2000), (0.001,) * 3, (0.0,) * 3)
    amplitudes = np.geomspace(1e-7, 9.4e5, 2000).astype(np.float32)
    places = np.argwhere(np.ones(grid.shape)).astype(np.int32)
    frame = VibrationFrame(grid, places, amplitudes, np.linspace(0.1, 10000, 2000, dtype=np.float32))
    assert native.vibration([frame]) == encode_vibration([frame])


@pytest.mark.parametrize("seed", range(3 * SEEDS))
def test_poses(seed: int, native: NativeEncoder) -> None:
    track, steps = random_poses(seed)
    assert native.poses(round_poses(track, steps)) == encode_poses(track, steps)
    assert digest(encode_poses(track, steps)) == PARTS["poses"][seed]


@pytest.mark.parametrize("name", [name for name in make_golden.SCENES if "touch" in name])
def test_golden_bodies(name: str, native: NativeEncoder) -> None:
    scene, spec = make_golden.SCENES[name]
    encoder = ObjectsEncoder(scene, spec, 1 / 64)
    is_deforming = [not body.is_rigid for body in scene.objects]
    for _, _, body in encoder.segments():
        assert native.bodies(SegmentParts.from_bytes(body, is_deforming)) == body


@pytest.mark.parametrize("seed", range(SEEDS))
def test_exact_samples(seed: int, native: NativeEncoder) -> None:
    segment = random_segment("mask", seed, guess="off")
    coder, rng = encoder_of(segment), np.random.default_rng(seed)
    coded = coder.encode_segment(segment.frames)
    samples = [random_samples(frame, rng) for frame in segment.frames]
    samples[0] = samples[0][: len(samples[0]) * (seed % 2)]
    body = coder.with_exact_samples(coded, segment.frames, samples).body
    assert native.with_exact_samples(segment.grid, segment.spec, coded.body, segment.frames, samples) == body
    assert digest(body) == BODIES["exact samples"][seed]
    decoded = TouchDecoder(segment.grid, coder.parameters).frames(body, len(segment.frames))
    for field, original, numbers in zip(decoded, segment.frames, samples, strict=True):
        for own, expected in zip(*(samples_at(f, numbers) for f in (field, original)), strict=True):
            assert own.tobytes() == expected.tobytes()


def samples_at(field: ForceField, numbers: np.ndarray) -> np.ndarray:
    """The forces of samples by their numbers: 512 times that of the brick plus the sample."""
    at: np.ndarray = field.forces_at(numbers >> 9).reshape(-1, 512, 3)[np.arange(len(numbers)), numbers & 511]
    return at


def test_functions_are_short() -> None:
    for name in (
        "touch_model.h",
        "touch_encode.h",
        "python/arguments.h",
        "python/parts.h",
        "python/segments.h",
    ):
        start, lines = 0, (C / name).read_text().splitlines()
        for number, line in enumerate(lines):
            assert len(line) <= 128, f"{name}:{number + 1}"
            if line and line[0].isalpha():
                start = number
            if line == "}":
                assert number - start < 80, f"{name}:{start + 1}"


def test_key_frame(native: NativeEncoder) -> None:
    segment = random_segment("mask", 1, guess="off")
    key_frame = segment.frames[0].scaled(1.0005)
    body = encoder_of(segment).encode_segment(segment.frames, key_frame=key_frame).body
    assert native.segment(segment.grid, segment.spec, segment.frames, key_frame) == body
    assert digest(body) == BODIES["key frame"]


@pytest.mark.parametrize(
    "options", [{"k": 0.1}, {"k": 0.02, "f0_n": 0.0}, {"f0_n": 100.0}, {"mode": "nmse"}], ids=str
)
def test_frames_of_a_static_scene(options: dict[str, Any], native: NativeEncoder) -> None:
    earlier, spec, found = random_frames(1)[0], TouchSpec(**options), set()
    coder = TouchEncoder(earlier.grid, spec)
    for scale in (1.0, 1.0003, 1.0007, 1.0015, 1.003, 1.03, 2.0):
        frame = earlier.scaled(scale)
        is_static = coder.key_frame(frame, earlier) is earlier
        error = np.linalg.norm(frame.forces_n.astype(float) - earlier.forces_n, axis=-1)
        size = np.linalg.norm(frame.forces_n.astype(float), axis=-1)
        allowed = np.maximum(0.02 * spec.f0_n, max(0.02 * spec.k, 0.001) * size)
        assert is_static == (spec.mode != "nmse" and bool((error <= allowed).all()))
        assert native.is_static(spec, frame, earlier) == is_static
        found.add(is_static)
    assert found == ({False} if spec.mode == "nmse" else {True, False})


def test_forces_that_are_not_finite_are_refused(native: NativeEncoder) -> None:
    segment = random_segment("mask", 1, guess="off")
    for value in (np.nan, np.inf, 2e36):
        forces = segment.frames[0].forces_n.copy()
        forces[0, 0, 0, 0, 1] = value
        bad = ForceField(segment.grid, segment.frames[0].bricks, forces)
        for longest_n in (None, 1.0):  # as it is, and as a caller may state it
            with pytest.raises(ValueError, match="6: a force that is not finite, or above"):
                native.segment(segment.grid, segment.spec, [bad], longest_n=longest_n)


def test_bricks_that_do_not_ascend_within_the_grid_are_refused(native: NativeEncoder) -> None:
    segment = lossless_segment(1)
    frame = next(frame for frame in segment.frames if len(frame.bricks) > 1)
    for bricks, message in (
        (frame.bricks[::-1], "bricks that do not ascend"),
        (frame.bricks + np.int32(1 << 10), "a brick beyond the grid"),
        (frame.bricks - np.int32(1 << 10), "a brick beyond the grid"),
    ):
        bad = SimpleNamespace(
            grid=frame.grid, bricks=bricks, forces_n=frame.forces_n, to_dense=frame.to_dense
        )
        with pytest.raises(ValueError, match=f"6: {message}"):
            native.segment(segment.grid, TouchSpec(), [bad])


@pytest.mark.parametrize("force_n", [1.0, -0.0])
@pytest.mark.parametrize("axis", range(3))
def test_forces_beyond_the_grid_are_refused(native: NativeEncoder, axis: int, force_n: float) -> None:
    """Also those of no length but with a bit set, which mode lossless would have to code."""
    shape = tuple(13 if n == axis else 16 for n in range(3))
    grid = Grid(shape, (0.001,) * 3, (0.0,) * 3)
    field = ForceField.from_dense(grid, np.ones((*shape, 3), np.float32))
    forces = field.forces_n.copy()
    beyond = [3, 3, 3]
    for inside, is_refused in ((4, False), (5, True)):
        beyond[axis] = inside
        forces[-1][tuple(beyond)] = force_n if is_refused else 1.0
        changed = ForceField(grid, field.bricks, forces)
        for spec in (TouchSpec(), lossless_segment(1).spec):
            if is_refused:
                with pytest.raises(ValueError, match="6: a force beyond the grid"):
                    native.segment(grid, spec, [changed])
            else:
                assert native.segment(grid, spec, [changed])


def test_supports_out_of_range_are_refused(native: NativeEncoder) -> None:
    grid, bricks = Grid((20, 16, 16), (0.001,) * 3, (0.0,) * 3), np.array([[0, 0, 1], [2, 1, 0]], np.int32)
    corner = np.zeros((2, 8, 8, 8), np.bool_)
    corner[:, 0, 0, 0] = True
    beyond, empty = corner.copy(), corner.copy()
    beyond[1, 4], empty[1] = True, False
    for own, mask, message in (
        (bricks[::-1], corner, "do not ascend"),
        (bricks[[0, 0]], corner, "do not ascend"),
        (bricks + np.int32([1, 0, 0]), corner, "beyond the grid"),
        (bricks - np.int32([1, 0, 0]), corner, "beyond the grid"),
        (bricks, beyond, "samples beyond the grid"),
        (bricks, empty, "a brick without samples"),
    ):
        with pytest.raises(ValueError, match=message):
            native.support(grid, (own, mask))
        if mask is corner:
            with pytest.raises(ValueError, match=message):
                native.support(grid, (bricks, corner), (own, mask))
    assert native.support(grid, (bricks, corner), (bricks, empty))  # a reference may have such a brick


def test_numbers_of_any_size_are_refused_or_coded(native: NativeEncoder) -> None:
    limit = (1 << 30) - 1
    for number in (-(1 << 63), (1 << 63) - 1, limit + 1, -limit - 1):
        with pytest.raises(ValueError, match="beyond 2"):
            native.numbers(np.array([0, number]))
        poses = np.zeros((2, 7), np.int64)
        poses[1, 2] = number
        if abs(number) > 1 << 50:
            with pytest.raises(ValueError, match="beyond 2"):
                native.poses(poses)
    with pytest.raises(ValueError, match="no poses"):
        native.poses(np.zeros((0, 7), np.int64))
    worst = np.tile([limit, 0, -limit, 1, 7, -1], 500)
    assert (native.decode_numbers(native.numbers(worst), len(worst))[1] == worst).all()


def test_vibrations_out_of_range_are_refused(native: NativeEncoder) -> None:
    grid, places = Grid((9, 9, 9), (0.001,) * 3, (0.0,) * 3), np.array([[0, 0, 8], [8, 8, 8]], np.int32)
    ones = np.ones(2, np.float32)
    for positions, amplitude, frequency, message in (
        (places[::-1], 1, 1, "do not ascend"),
        (places + np.int32(1), 1, 1, "beyond the grid"),
        (places - np.int32(1), 1, 1, "beyond the grid"),
        (places, 0, 1, "not positive"),
        (places, np.inf, 1, "not positive"),
        (places, np.nan, 1, "not positive"),
        (places, 1e6, 1, "above 0.9 meganewton"),
        (places, 1, np.nan, "above 10 kHz"),
        (places, 1, 10001, "above 10 kHz"),
        (places, 1, -1, "above 10 kHz"),
    ):
        arrays = np.ascontiguousarray(positions), ones * np.float32(amplitude), ones * np.float32(frequency)
        with pytest.raises(ValueError, match=message):
            native.vibration_arrays(grid, [arrays])


def noise(grid: Grid, seed: int) -> ForceField:
    """Forces of any size everywhere, more of them along one axis: no code takes more bytes."""
    rng = np.random.default_rng(seed)
    forces = rng.uniform(-0.2, [0.2, 0.2, 1], (*grid.shape, 3))
    forces *= np.exp(3 * rng.standard_normal((*grid.shape, 1)))
    return ForceField.from_dense(grid, forces.astype(np.float32))


@pytest.mark.parametrize(
    "options", [{}, {"k": 0.001, "f0_n": 0.0}, {"mode": "nmse"}, {"mode": "lossless"}], ids=str
)
def test_noise_fits_in_the_memory_that_is_announced(options: dict[str, Any], native: NativeEncoder) -> None:
    grid = Grid((48, 48, 48), (0.001,) * 3, (0.0,) * 3)
    frames = [noise(grid, 0), noise(grid, 1)]
    for guess in ("off",) if options.get("mode") == "lossless" else ("auto", "off"):
        segment = Segment(TouchSpec(guess=guess, **options), frames)
        body = native.segment(*segment_arguments(segment), has_splines=True)
        assert body == encoder_of(segment).encode_segment(frames).body
    spec, room = segment.spec, native.room(grid, segment.spec, 216)
    assert room < 216 * 51_000 + (12 << 20 if spec.mode == "lossless" else 4 << 20)
    with pytest.raises(ValueError, match="5: no room"):
        native.segment(grid, spec, frames, work_bytes=int(0.7 * room))


def test_columns_that_reach_far_beyond_a_frame_are_not_taken(native: NativeEncoder) -> None:
    """One tile has a slow ramp; the force of the others falls inwards, as if from a surface far outside."""
    grid = Grid((64, 64, 256), (0.001,) * 3, (0.0,) * 3)
    forces = np.zeros((*grid.shape, 3), np.float32)
    forces[..., -8:, 2] = -np.linspace(0.95, 0.5, 8)
    forces[:8, :8, :, 2] = -np.linspace(0.001, 1, 256)
    frame = ForceField.from_dense(grid, forces)
    body = native.segment(grid, TouchSpec(mode="nmse", step_n=0.01), [frame])
    assert not BodyReader(body, grid, exact=False).records(1)[0].base_layer


def test_too_little_memory_is_reported(native: NativeEncoder) -> None:
    segment = random_segment("mask", 1, guess="off")
    with pytest.raises(ValueError, match="5: no room for a segment"):
        native.segment(segment.grid, segment.spec, segment.frames, out_bytes=100)


def test_no_memory_is_touched_that_is_not_its_own(tmp_path: Path) -> None:
    """The same segments under the address sanitizer, in a process that has its library."""
    probe = tmp_path / "probe.c"
    probe.write_text("int main(void) { return 0; }\n")
    command = [str(COMPILER), *WATCHED, "-o", str(tmp_path / "probe"), str(probe)]
    asan = subprocess.run(
        [str(COMPILER), "-print-file-name=libasan.so"], capture_output=True, text=True, check=False
    )
    if (
        subprocess.run(command, capture_output=True, check=False).returncode
        or not Path(asan.stdout.strip()).is_file()
    ):
        pytest.skip("the compiler has no address sanitizer")
    library = build(tmp_path, *WATCHED, source=HERE / "encode_watched.c")
    env = {**os.environ, "LD_PRELOAD": asan.stdout.strip(), "ASAN_OPTIONS": "detect_leaks=0"}
    command = [sys.executable, str(HERE / "encode_all.py"), str(library)]
    done = subprocess.run(command, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-4000:]
