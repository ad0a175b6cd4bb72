"""Segments of the stages of figure 4, written; `stages` tells what they are and reads them."""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np

from touchfield.arrays import Float64s, Int64s
from touchfield.codec.numbers import LARGEST, encode_numbers
from touchfield.codec.paper.stages import GRAIN, LEVELS, ORDER, is_by_brick, lifted
from touchfield.codec.rate import BitAccount
from touchfield.codec.segment import CodedSegment, FrameKind, FrameStats
from touchfield.codec.support import encode_support
from touchfield.codec.varint import chunk, write_varint
from touchfield.errors import InvalidArgument
from touchfield.medium import ForceField
from touchfield.medium.grid import BRICK

_PASSES = 4
_ROUNDING = 1 / 3  # of the DCT: a coefficient below two thirds of a step is none


def encode_staged(frames: Sequence[ForceField], stage: str, step_n: float) -> CodedSegment:
    """The frames as a segment of a stage, each alone. InvalidArgument if the step is too fine for the forces."""
    parts, stats = [struct.pack("<d", step_n)], []
    for frame in frames:
        support = encode_support(frame.grid, frame.bricks, frame.mask)
        numbers, runs = _numbers(frame, stage, step_n)
        if np.abs(numbers).max(initial=0) > LARGEST:
            raise InvalidArgument("step_n", f"{step_n:g} N", "at least 2^-20 of the largest component")
        code = encode_numbers(numbers)
        data = chunk(support) + (write_varint(runs) if stage == "runs" else b"") + chunk(code)
        bits = BitAccount(8 * len(support), 8 * len(code))
        bits += BitAccount(side=8 * len(data) - bits.total)
        parts.append(data)
        stats.append(FrameStats(FrameKind.INTRA, frame.support_count, frame.support_count, bits))
    return CodedSegment(b"".join(parts), tuple(stats))


def _numbers(frame: ForceField, stage: str, step_n: float) -> tuple[Int64s, int]:
    """The numbers of a frame, int64 [any], and how many runs there are."""
    if is_by_brick(stage):
        filled = _filled(frame) / step_n
        made = _to_wavelet(_points(filled)) if stage == "wavelet" else _to_dct(filled)
        return made.reshape(-1, BRICK**3, 3)[:, ORDER].transpose(2, 1, 0).reshape(-1), 0
    vectors = frame.vectors_n().astype(np.float64) / step_n
    if stage == "adpcm":
        return _adpcm(_points(vectors * GRAIN)), 0
    points = _points(vectors)
    if stage == "dpcm":
        return np.diff(points, axis=0, prepend=np.zeros((1, 3), np.int64)).T.reshape(-1), 0
    begins = np.flatnonzero(np.append(True, (points[1:] != points[:-1]).any(axis=1))[: len(points)])
    lengths = np.diff(begins, append=len(points)) - 1
    return np.concatenate([lengths, points[begins].T.reshape(-1)]), len(begins)


def _points(steps: Float64s) -> Int64s:
    return np.rint(np.clip(steps, -float(1 << 40), float(1 << 40))).astype(np.int64)  # too large is told later


def _adpcm(grains: Int64s) -> Int64s:
    from touchfield.codec.paper.kernels.loops import adpcm

    residuals = np.zeros((3, len(grains)), np.int64)
    for values, out in zip(np.ascontiguousarray(grains.T), residuals, strict=True):
        adpcm(values, out, False)
    return residuals.reshape(-1)


def _filled(frame: ForceField) -> Float64s:
    """Forces [n, 8, 8, 8, 3], those beside the support chosen smooth: the brick's mean, then means of neighbours."""
    held = frame.mask[..., None]
    x = frame.forces_n.astype(np.float64)
    mean = x.sum(axis=(1, 2, 3)) / np.maximum(frame.mask.sum(axis=(1, 2, 3)), 1)[:, None]
    x = np.where(held, x, mean[:, None, None, None, :])
    for _ in range(_PASSES):
        p = np.pad(x, ((0, 0), (1, 1), (1, 1), (1, 1), (0, 0)), mode="edge")
        around = p[:, :-2, 1:-1, 1:-1] + p[:, 2:, 1:-1, 1:-1] + p[:, 1:-1, :-2, 1:-1] + p[:, 1:-1, 2:, 1:-1]
        x = np.where(held, x, (around + p[:, 1:-1, 1:-1, :-2] + p[:, 1:-1, 1:-1, 2:]) / 6)
    return x


def _to_wavelet(points: Int64s) -> Int64s:
    out = points.copy()
    for level in range(LEVELS):
        size = BRICK >> level
        part = out[:, :size, :size, :size]
        for axis in (1, 2, 3):
            part[...] = lifted(part, axis, _split)
    return out


def _split(x: Int64s) -> Int64s:
    even, odd = x[0::2], x[1::2]
    detail = odd - ((even + np.concatenate([even[1:], even[-1:]])) >> 1)
    return np.concatenate([even + ((np.concatenate([detail[:1], detail[:-1]]) + detail + 2) >> 2), detail])


def _to_dct(steps: Float64s) -> Int64s:
    from scipy.fft import dctn

    spectrum = dctn(steps, axes=(1, 2, 3), norm="ortho") if len(steps) else steps
    return np.sign(spectrum).astype(np.int64) * _points(np.floor(np.abs(spectrum) + _ROUNDING))
