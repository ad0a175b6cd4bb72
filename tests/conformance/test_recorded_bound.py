"""The recorded error ratio of a segment is never less than the true one, and equals it to rounding.

The true ratio is computed here in float64 over every sample of every frame, independently of the package,
from the output of three decoders. All errors are in the first, a middle or the last frame.
"""

from __future__ import annotations

import ctypes
import io
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from native_encoder import C, NativeEncoder, build
from second import decoder
from test_c import COMPILER, Raw, built, run

import touchfield as tf
from live_makers import HEAD
from touchfield.codec.touch.body import BodyReader
from touchfield.codec.touch.decoder import TouchDecoder
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.container import TouchWriter
from touchfield.medium import ForceField, Grid

GRID = Grid(
    (17, 9, 7), (0.001, 0.002, 0.0015), (0.0, 0.0, 0.0)
)  # 3, 2 and 1 bricks: axes that are exchanged show
STEP = 1 / 65535
EMPTY = ForceField.empty(GRID)
FRAMES = 4

RULES = {
    "mask": TouchSpec(k=0.1, f0_n=0.05),
    "no F_0": TouchSpec(k=0.02, f0_n=0.0),
    "exact support": TouchSpec(k=0.1, f0_n=0.05, support="exact"),
    "directions": TouchSpec(k=0.1, f0_n=0.05, mode="mask-direction", direction_jnd_deg=18.0),
    "lossless": TouchSpec(mode="lossless"),
}
SLOW = ("mask", "directions", "lossless")
KINDS = ("dense", "full", "huge", "threshold")
OUTLIER_RULES = {
    "full": ("no F_0", "exact support"),
    "huge": ("mask", "no F_0", "exact support", "directions"),  # 60 decades
}
"""Rules that leave outliers, by the kind of forces."""


def field_of(kind: str, seed: int) -> ForceField:
    """Reproducible random forces of a kind."""
    rng = np.random.default_rng(seed)
    normal, sizes = rng.normal(size=(*GRID.shape, 3)), rng.random(GRID.shape)
    if kind == "dense":
        x, y, z = np.indices(GRID.shape)
        return ForceField.from_dense(
            GRID, np.stack([np.sin(x / 5 + seed), np.cos(y / 4), 1 + z / 9], -1).astype(np.float32)
        )
    if kind == "full":
        return ForceField.from_dense(GRID, normal * 10 ** (4 * sizes[..., None] - 3))
    is_supported = rng.random(GRID.shape) < 0.05
    if kind == "huge":
        return ForceField.from_dense(
            GRID, is_supported[..., None] * normal * 10 ** (60 * sizes[..., None] - 30)
        )
    near_f0 = np.float32(0.05) + np.float32(2.0**-28) * rng.integers(-3, 4, GRID.shape)
    forces = np.zeros((*GRID.shape, 3), np.float32)
    forces[..., 2] = is_supported * near_f0
    forces[0, 0, 0] = 2.0
    return ForceField.from_dense(GRID, forces)


def contents(kind: str) -> Iterator[tuple[str, list[ForceField]]]:
    """Frames, with a name that says which of them have errors."""
    field = field_of(kind, 7)
    for name, index in (("first", 0), ("middle", 1), ("last", FRAMES - 1)):
        yield name, [field if i == index else EMPTY for i in range(FRAMES)]
    yield "all", [field_of(kind, seed) for seed in range(FRAMES)]
    yield "alone", [field]


def error_ratios(source: np.ndarray, decoded: np.ndarray, spec: TouchSpec) -> np.ndarray:
    """Error / allowed error, float64 [frames, x, y, z], of forces [frames, x, y, z, 3]
    (docs/format/touch.md).
    """
    force, other = source.astype(np.float64), decoded.astype(np.float64)
    if spec.mode == "lossless":
        return np.where((source.view(np.uint32) == decoded.view(np.uint32)).all(-1), 0.0, np.inf)
    size = np.sqrt((force**2).sum(-1))
    allowed = np.maximum(spec.f0_n, spec.k * size)
    error = np.sqrt(((other - force) ** 2).sum(-1))
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(error > 0, error / allowed, 0.0)
        if spec.mode == "mask-direction":
            jnd = math.radians(spec.direction_jnd_deg)
            radial = np.abs(np.sqrt((other**2).sum(-1)) - size) / allowed
            unit = [v / np.sqrt((v**2).sum(-1, keepdims=True)) for v in (force, other)]
            sine = np.sqrt((np.cross(*unit) ** 2).sum(-1))
            turn = np.arctan2(sine, (unit[0] * unit[1]).sum(-1)) / jnd
            by_parts = np.maximum(radial, np.nan_to_num(turn))
            is_strong = size * math.sin(jnd) > spec.f0_n
            ratio = np.where(error > 0, np.where(is_strong, by_parts, error / spec.f0_n), 0.0)
    if spec.support == "exact":
        ratio = np.where(force.any(-1) != other.any(-1), np.inf, ratio)
    return np.asarray(ratio)


def dense(frames: list[ForceField]) -> np.ndarray:
    return np.stack([frame.to_dense() for frame in frames])


def assert_recorded(body: bytes, parameters: bytes, ratios: np.ndarray, count: int) -> None:
    """Check the recorded ratio, frame and voxel against the true ones."""
    worst = TouchDecoder(GRID, parameters).max_error(body)
    assert worst is not None
    true = ratios.max()
    assert true <= worst.ratio <= true + STEP * (1 + 1e-9) + 1e-9 and worst.ratio <= 1
    x, y, z = worst.voxel
    assert ratios[worst.frame, x, y, z] == pytest.approx(true, rel=1e-9, abs=1e-12)
    assert worst.frame < count


@pytest.mark.parametrize("effort", ["fast", "default"])
@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("kind", KINDS)
def test_recorded_ratio_is_the_true_one(kind: str, rule: str, effort: str) -> None:
    spec = replace(RULES[rule], effort=effort)
    encoder, outlier_count = TouchEncoder(GRID, spec), 0
    for name, frames in contents(kind):
        body = encoder.encode_segment(frames).body
        decoded = list(TouchDecoder(GRID, encoder.parameters).frames(body, len(frames)))
        ratios = error_ratios(dense(frames), dense(decoded), spec)
        assert_recorded(body, encoder.parameters, ratios, len(frames))
        if spec.mode != "lossless" and kind == "dense" and name in ("first", "middle", "last"):
            is_supported = np.array([frame.support_count > 0 for frame in frames])
            # only frames with forces have errors
            assert ratios[is_supported].max() > 0.5 and not ratios[~is_supported].any()
        records = BodyReader(body, GRID, exact=spec.mode == "lossless").records(len(frames))
        outlier_count += sum(bool(record.outliers) for record in records)
    assert (outlier_count > 0) == (rule in OUTLIER_RULES.get(kind, ()))


@pytest.mark.parametrize("effort", ["fast", "default"])
def test_recorded_ratio_excludes_outliers(effort: str) -> None:
    """Outliers have no error: the one they had before must not be recorded."""
    spec = TouchSpec(k=0.1, f0_n=0.0, effort=effort)
    dense_n = np.zeros((*GRID.shape, 3), np.float32)
    # the second is below the step size of the first
    dense_n[2, 3, 4], dense_n[9, 8, 6] = (
        (1e20, 0, 0),
        (1e-20, 0, 0),
    )
    frames = [EMPTY, ForceField.from_dense(GRID, dense_n)]
    encoder = TouchEncoder(GRID, spec)
    body = encoder.encode_segment(frames).body
    assert BodyReader(body, GRID, exact=False).records(2)[1].outliers
    decoded = list(TouchDecoder(GRID, encoder.parameters).frames(body, 2))
    ratios = error_ratios(dense(frames), dense(decoded), spec)
    assert ratios.max() < 0.99
    assert_recorded(body, encoder.parameters, ratios, 2)


WRONG = """
uint32_t touch_wrong_frame = 0;
static const touch_field *touch_wrong(const touch_field *field, uint32_t frame) {
    float *forces = (float *)(uintptr_t)field->forces_n;
    uint64_t count = frame == touch_wrong_frame ? 1536 * (uint64_t)field->bricks : 0;
    for (uint64_t i = 0; i < count; i++) forces[i] *= 1.5f;
    return field;
}
"""
CHECKED = "touch_field_forces(&decoded, field, "
OUTLIER = "touch_put_varint(s, 2 * sample + !bits);"
WRONG_OUTLIER = "uint32_t touch_wrong_position = 0, touch_wrong_force = 0;\n"


@pytest.fixture(scope="module")
def wrong_encoder(tmp_path_factory: pytest.TempPathFactory) -> NativeEncoder:
    """An encoder that decodes one frame wrongly when it checks its body."""
    folder = tmp_path_factory.mktemp("wrong")
    text = (C / "touch_encode.h").read_text()
    section = text.index("/* -- the finished segment")
    assert text.count(CHECKED) == 1
    text = text[:section] + WRONG + text[section:]
    text = text.replace(CHECKED, "touch_field_forces(&decoded, touch_wrong(field, n), ")
    assert text.count(OUTLIER) == 1
    moved = OUTLIER.replace("sample", "(sample ^ touch_wrong_position)")
    text = text.replace(OUTLIER, moved).replace(
        "touch_f32_bits(force[k]), 4)", "touch_f32_bits(force[k]) ^ touch_wrong_force, 4)"
    )
    outliers = text.index("/* The forces of some voxels, as they are")
    text = text[:outliers] + WRONG_OUTLIER + text[outliers:]
    (folder / "touch_encode.h").write_text(text)
    (folder / "wrong.c").write_text('#define TOUCH_ENCODE_IMPLEMENTATION\n#include "touch_encode.h"\n')
    return NativeEncoder(build(folder, "-O1", source=folder / "wrong.c"))


@pytest.mark.skipif(COMPILER is None, reason="there is no C compiler here")
@pytest.mark.parametrize("index", range(FRAMES))
@pytest.mark.parametrize(
    ("mode", "effort"), [("mask", "default"), ("lossless", "fast"), ("lossless", "default")]
)
def test_body_that_decodes_differently_is_not_written(
    mode: str, effort: str, index: int, wrong_encoder: NativeEncoder
) -> None:
    """The check of the finished body fails for any wrong frame."""
    frames = [field_of("huge", seed) for seed in range(FRAMES)]
    spec = TouchSpec(mode=mode, k=0.02, f0_n=0.0, effort=effort)
    wrong = ctypes.c_uint32.in_dll(wrong_encoder.c, "touch_wrong_frame")
    wrong.value = FRAMES
    body = TouchEncoder(GRID, spec).encode_segment(frames).body
    assert wrong_encoder.segment(GRID, spec, frames) == body
    wrong.value = index
    with pytest.raises(ValueError, match=r"violates the error bound|not decoded as it was"):
        wrong_encoder.segment(GRID, spec, frames)


@pytest.mark.skipif(COMPILER is None, reason="there is no C compiler here")
@pytest.mark.parametrize("kind", ["position", "force"])
def test_outliers_that_are_read_otherwise_are_not_written(kind: str, wrong_encoder: NativeEncoder) -> None:
    """Effort fast decodes no finished body, and reads back its outliers."""
    frames = [field_of("huge", seed) for seed in range(FRAMES)]
    spec = TouchSpec(k=0.02, f0_n=0.0, effort="fast")
    body = TouchEncoder(GRID, spec).encode_segment(frames).body
    assert any(record.outliers for record in BodyReader(body, GRID, exact=False).records(FRAMES))
    wrong = ctypes.c_uint32.in_dll(wrong_encoder.c, f"touch_wrong_{kind}")
    wrong.value = 1
    try:
        with pytest.raises(ValueError, match="an outlier is not read as it was written"):
            wrong_encoder.segment(GRID, spec, frames)
    finally:
        wrong.value = 0
    assert wrong_encoder.segment(GRID, spec, frames) == body


@pytest.mark.parametrize(
    "rule", ["no F_0", *(pytest.param(rule, marks=pytest.mark.thorough) for rule in SLOW)]
)
def test_other_decoders_agree_on_the_ratio(rule: str, tmp_path: Path) -> None:
    """A file of several segments, decoded by the reference decoder and by C."""
    spec = replace(RULES[rule], effort="fast")
    encoder, path = TouchEncoder(GRID, spec), tmp_path / "a.touch"
    segments = [[EMPTY, field_of("full", 1)], [field_of("huge", 2), EMPTY], [field_of("full", 3)]]
    file = io.BytesIO()
    head = replace(HEAD, grid_shape=GRID.shape, spacing_m=GRID.spacing_m, frame_count=5)
    bodies = [encoder.encode_segment(frames).body for frames in segments]
    with TouchWriter(file) as writer:
        writer.write_head(replace(head, coder_parameters=encoder.parameters))
        for first, frames, body in zip((0, 2, 4), segments, bodies, strict=True):
            writer.write_segment(first, len(frames), body)
    path.write_bytes(file.getvalue())
    source = dense([frame for frames in segments for frame in frames])
    for decoded in decoded_by_all(path, tmp_path):
        ratios = error_ratios(source, decoded, spec)
        for first, frames, body in zip((0, 2, 4), segments, bodies, strict=True):
            assert_recorded(body, encoder.parameters, ratios[first : first + len(frames)], len(frames))
    with tf.open_stream(path) as stream:
        assert 0 <= stream.summary()["worst_mask_ratio"] - ratios.max() <= STEP * (1 + 1e-9)


def decoded_by_all(path: Path, folder: Path) -> Iterator[np.ndarray]:
    """Forces [frames, x, y, z, 3] of the reference decoder and, if there is a compiler,
    of `c/touch_decode`.
    """
    yield decoder.decode(path)["forces_n"]
    if COMPILER is not None:
        program = built(folder, "touch_decode", "-O1")
        assert run(program, path, folder / "raw") == (0, "0")
        raw, fields = Raw((folder / "raw").read_bytes(), GRID.shape), []
        for _ in range(5):
            fields.append(raw.field())
            assert not raw.bricks()  # bricks of a vibration
        yield np.stack(fields)
