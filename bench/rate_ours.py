"""The package's own coders as `rate.py` measures them, and the search for bytes at an equal error."""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from time import perf_counter
from typing import Any

from touchfield.codec.objects import ObjectsEncoder
from touchfield.codec.paper import PaperDecoder, PaperEncoder
from touchfield.codec.paper_spec import PaperSpec
from touchfield.codec.touch.decoder import TouchDecoder
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.measure.fidelity import FidelityMeter
from touchfield.medium import ForceField, HapticScene
from touchfield.parallel import worker_count

K, F0_N = 0.1, 0.05
RECORD_BYTES = 96
"""Of a record's frame, lattice and lengths, rounded up."""


@dataclass(frozen=True)
class Coded:
    """What a coder made of some frames: all bytes that the decoder needs, and how far it is off."""

    bytes: int
    nmse_db: float
    beyond: int
    """Voxels whose error is beyond max(F_0, k |F|)."""
    worst: float
    """The largest error in units of the mask."""
    frame_bits: tuple[int, ...]
    inter: tuple[bool, ...]


def paper(frames: list[ForceField], **asked: Any) -> Coded:
    """Coder `paper` as the comparisons take it: n_q 6, 258 directions, no deadband."""
    spec = PaperSpec(**{"nq": 6, "directions": "octa3", "deadband": "none", **asked})
    return _coded(PaperEncoder(frames[0].grid, spec), PaperDecoder, frames)


def touch(frames: list[ForceField], **asked: Any) -> Coded:
    """Coder `touch`, one segment."""
    return _coded(TouchEncoder(frames[0].grid, TouchSpec(**{"k": K, "f0_n": F0_N, **asked})), TouchDecoder, frames)


def _coded(encoder: Any, decoder: Any, frames: list[ForceField]) -> Coded:
    segment = encoder.encode_segment(frames)
    meter = FidelityMeter(K, F0_N)
    made = decoder(frames[0].grid, encoder.parameters).frames(segment.body, len(frames))
    for frame, back in zip(frames, made, strict=True):
        meter.add(frame, back)
    nmse_db = meter.nmse_db
    return Coded(
        len(encoder.parameters) + len(segment.body),
        -300.0 if nmse_db is None else nmse_db,
        meter.mask_violations,
        meter.worst_mask_ratio,
        tuple(f.bits.total for f in segment.frames),
        tuple(f.kind.name != "INTRA" for f in segment.frames),
    )


def speed(frames: list[ForceField], effort: str, runs: int = 2) -> dict[str, float]:
    """Frames a second of the promise, segments of `frames` in a thread for each core; the best of `runs`."""
    encoder = TouchEncoder(frames[0].grid, TouchSpec(k=K, f0_n=F0_N, effort=effort))
    decoder = TouchDecoder(frames[0].grid, encoder.parameters)
    segments = worker_count()
    body = encoder.encode_segment(frames).body

    def rate(job: Callable[[int], object]) -> float:
        times = []
        for _ in range(runs):
            began = perf_counter()
            with ThreadPoolExecutor(segments) as pool:
                list(pool.map(job, range(segments)))
            times.append(perf_counter() - began)
        return segments * len(frames) / min(times)

    return {
        "encode_frames_s": rate(lambda _: encoder.encode_segment(frames)),
        "decode_frames_s": rate(lambda _: list(decoder.frames(body, len(frames)))),
        "bytes_a_frame": len(body) / len(frames),
    }


def object_bytes(scene: HapticScene) -> dict[str, int]:
    """Bytes of a scene as objects with pose tracks, fields by each coder, by what is promised of them."""
    specs: dict[str, PaperSpec | TouchSpec] = {
        "objects, fields by coder paper": PaperSpec(nq=6, directions="octa3", deadband="none"),
        "objects, fields by coder touch at the promise": TouchSpec(k=K, f0_n=F0_N, effort="max"),
    }
    found = {}
    for name, spec in specs.items():
        encoder = ObjectsEncoder(scene, spec, F0_N)
        objects = [
            len(one.name) + len(one.field_parameters) + len(one.pose_steps) + len(one.field) + RECORD_BYTES
            for one in encoder.objects()
        ]
        segments = [len(encoder.encode_segment(*edges)) + RECORD_BYTES for edges in encoder.segments()]
        found[name] = sum(objects) + sum(segments)
    return found


# -- an equal error -------------------------------------------------------------------------------------------


def at_error(
    code: Callable[[float], tuple[float, float]], target_db: float, start: float, *, trials: int = 7
) -> float:
    """Bytes at an NMSE of `target_db`.

    Parameters
    ----------
    code : callable
        ``code(step) -> (bytes, nmse_db)``; a coarser step gives a larger error, about 20 dB for each factor of 10.
    start : float
        The first step.

    Returns
    -------
    float
        Interpolated between the nearest trials on both sides, log bytes against dB; NaN if the target lies beyond
        all of them.
    """
    tried: dict[float, tuple[float, float]] = {}
    step = start
    for _ in range(trials):
        tried[step] = code(step)
        below = [s for s, (_, db) in tried.items() if db <= target_db]
        above = [s for s, (_, db) in tried.items() if db > target_db]
        if min(abs(db - target_db) for _, db in tried.values()) < 0.01:
            break
        if not below or not above:
            edge = max(below) if below else min(above)
            step = edge * 10 ** ((target_db - tried[edge][1]) / 20)
            step *= 1.02 if below else 1 / 1.02  # just past it, so that the next is between
            continue
        low, high = max(below), min(above)
        if tried[high][1] - tried[low][1] < 0.25 or high / low < 1.01:
            break
        share = (target_db - tried[low][1]) / (tried[high][1] - tried[low][1])
        step = low * (high / low) ** min(0.9, max(0.1, share))
    return interpolated(list(tried.values()), target_db)


def interpolated(points: list[tuple[float, float]], target_db: float) -> float:
    """Bytes at `target_db` by the nearest of (bytes, dB) on both sides; NaN beyond them."""
    below = max((p for p in points if p[1] <= target_db), key=lambda p: p[1], default=None)
    above = min((p for p in points if p[1] > target_db), key=lambda p: p[1], default=None)
    if below is not None and (above is None or below[1] > target_db - 0.01):
        return below[0] if below[1] > target_db - 0.01 else math.nan
    if above is not None and above[1] < target_db + 0.01:
        return above[0]
    if below is None or above is None:
        return math.nan
    share = (target_db - below[1]) / (above[1] - below[1])
    return float(math.exp(math.log(below[0]) * (1 - share) + math.log(above[0]) * share))


def touch_at_error(frames: list[ForceField], target_db: float, effort: str, **asked: Any) -> float:
    """Bytes of coder `touch` in mode nmse at an NMSE."""
    energy = sum(float((f.forces_n.astype(float) ** 2).sum()) for f in frames)
    count = sum(f.support_count for f in frames)
    start = math.sqrt(4 * energy / max(count, 1) * 10 ** (target_db / 10))  # error of step^2 / 12 a component

    def code(step_n: float) -> tuple[float, float]:
        made = touch(frames, mode="nmse", step_n=step_n, effort=effort, **asked)
        return made.bytes, made.nmse_db

    return at_error(code, target_db, start)
