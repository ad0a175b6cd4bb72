"""Runs the package's coders for `rate.py`, and searches for the bytes that each takes at equal error."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rate_fields import box
from rate_symbols import F0_N, K
from touchfield import EncodeSpec, encode, prepare
from touchfield.codec import PaperSpec
from touchfield.codec.paper.decoder import PaperDecoder
from touchfield.codec.paper.encoder import PaperEncoder
from touchfield.codec.touch.decoder import TouchDecoder
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.measure.fidelity import FidelityMeter
from touchfield.medium import ForceField

PAPER = PaperSpec(nq=6, directions="octa3", deadband="none")
"""Coder `paper` in the comparisons; octa3 has 258 directions."""
CORES = 2
"""Cores that the measurement of speed uses."""


@dataclass(frozen=True)
class Coded:
    """Result of a coder: all bytes that the decoder needs, and the error."""

    bytes: int
    later_bits: int
    """Bits of all frames but the first."""
    nmse_db: float
    beyond: int
    """Number of voxels whose error exceeds max(F_0, k |F|)."""
    worst: float
    """Largest error in units of the mask."""


def paper(frames: list[ForceField], **options: Any) -> Coded:
    """Code frames with coder `paper` in one segment."""
    return _coded(PaperEncoder(frames[0].grid, replace(PAPER, **options)), PaperDecoder, frames)


def touch(frames: list[ForceField], **options: Any) -> Coded:
    """Code frames with coder `touch` in one segment."""
    return _coded(
        TouchEncoder(frames[0].grid, TouchSpec(**{"k": K, "f0_n": F0_N, **options})), TouchDecoder, frames
    )


def _coded(encoder: Any, decoder: Any, frames: list[ForceField]) -> Coded:
    segment, meter = encoder.encode_segment(frames), FidelityMeter(K, F0_N)
    decoded = decoder(frames[0].grid, encoder.parameters).frames(segment.body, len(frames))
    for frame, back in zip(frames, decoded, strict=True):
        meter.add(frame, back)
    return Coded(
        len(encoder.parameters) + len(segment.body),
        sum(f.bits.total for f in segment.frames[1:]),
        -300.0 if meter.nmse_db is None else meter.nmse_db,
        meter.mask_violations,
        meter.worst_mask_ratio,
    )


def paper_symbols(frames: list[ForceField]) -> tuple[NDArray[np.int32], int]:
    """Return the symbols of coder `paper` for frames coded alone.

    Returns
    -------
    symbols : int32 [frame, x, y, z, 2]
        Within the bounding box of the frames: amplitude level, from 1 on, and number of the direction; both 0
        where there is no force.
    table_bytes : int
        Bytes of the table of amplitude levels, float32.
    """
    encoder = PaperEncoder(frames[0].grid, replace(PAPER, interframe="none"))
    body = encoder.encode_segment(frames).body
    decoded = list(PaperDecoder(frames[0].grid, encoder.parameters).frames(body, len(frames)))
    forces = np.stack([f.to_dense()[box(decoded)] for f in decoded]).astype(np.float64)
    size = np.linalg.norm(forces, axis=-1)
    supported = size > 0
    # levels and directions have the precision of float32 and are farther apart than these steps
    level = np.unique(np.rint(2000 * np.log(size[supported])), return_inverse=True)[1].reshape(-1)
    unit = np.rint(20 * forces[supported] / size[supported][:, None] + 0.337)
    symbols = np.zeros((*supported.shape, 2), np.int32)
    symbols[supported] = np.stack(
        [level + 1, np.unique(unit, axis=0, return_inverse=True)[1].reshape(-1)], axis=-1
    )
    return symbols, 4 * int(symbols[..., 0].max())


def object_bytes(nw: int) -> dict[str, float]:
    """Return bytes of 2000 frames of falling bodies, as voxels and as objects.

    The voxels are coded by coder `paper`; their bytes are extrapolated from eight frames in each 250.
    """
    medium = prepare("sample:falling-7", EncodeSpec(nw=nw)).medium
    groups = [[medium[i] for i in range(start, start + 8)] for start in range(0, len(medium) - 7, 250)]
    voxels = float(np.mean([paper(group).bytes / len(group) for group in groups])) * len(medium)
    found = {f"voxels, coder paper, nw {nw}": voxels}
    touch = TouchSpec(k=K, f0_n=F0_N)
    specs = {"paper": EncodeSpec(nw=nw, coder="paper", paper=PAPER), "touch": EncodeSpec(nw=nw, touch=touch)}
    with tempfile.TemporaryDirectory() as folder:
        for name, spec in specs.items():
            done = encode("sample:falling-7", Path(folder) / "a.touch", spec)
            found[f"file of objects, coder {name}"] = float(done.file_bytes)
    return found


# -- speed -------------------------------------------------------------------------------------------------


def speed(frames: list[ForceField], effort: str, runs: int = 3) -> dict[str, float]:
    """Return frames per second within the error bound, the best of `runs`.

    Each of `CORES` cores codes a segment of `frames`. ``TOUCHFIELD_THREADS`` must be 1.
    """
    encoder = TouchEncoder(frames[0].grid, TouchSpec(k=K, f0_n=F0_N, effort=effort))
    decoder = TouchDecoder(frames[0].grid, encoder.parameters)
    bodies: list[bytes] = []

    def rate(job: Callable[[int], object]) -> float:
        times = list[float]()
        while len(times) < runs and sum(times) < 60:  # a slow coder runs once
            began = perf_counter()
            with ThreadPoolExecutor(CORES) as pool:
                list(pool.map(job, range(CORES)))
            times.append(perf_counter() - began)
        return CORES * len(frames) / min(times)

    return {
        "encode_frames_s": rate(lambda _: bodies.append(encoder.encode_segment(frames).body)),
        "decode_frames_s": rate(lambda _: list(decoder.frames(bodies[0], len(frames)))),
        "bytes_a_frame": len(bodies[0]) / len(frames),
    }


# -- an equal error ----------------------------------------------------------------------------------------

Trial = tuple[float, ...]
"""NMSE in dB, then one or more sizes."""
BRACKET_DB, TOLERANCE_DB, BRACKET_RATIO = 0.5, 0.05, 1.08
"""Conditions that end a search.

Two trials around the target that differ by BRACKET_DB or by the step ratio BRACKET_RATIO, or one trial within
TOLERANCE_DB of the target. The encoder's bit allocation makes the NMSE vary by half a dB at times.
"""
OVERSHOOT_DB = 0.15
"""Distance beyond the target at which a trial is aimed, to bracket the target."""


@dataclass
class Search:
    """Search for a step: trials until two of them bracket the target closely.

    ``code(step)`` returns an NMSE in dB, which grows with the step by some 20 dB for a factor of 10, and
    sizes.
    """

    code: Callable[[float], Trial]
    target_db: float
    start: float
    trials: int = 7
    tried: dict[float, Trial] = field(default_factory=dict)

    def run(self) -> Search:
        """Try steps until one is near enough."""
        step = self.start
        for n in range(self.trials):
            self.tried[step] = self.code(step)
            off = {step: db - self.target_db for step, (db, *_) in self.tried.items()}
            nearest = sorted(off, key=lambda s: abs(off[s]))
            low = max((s for s in off if off[s] <= 0), key=off.__getitem__, default=0.0)
            high = min((s for s in off if off[s] > 0), key=off.__getitem__, default=math.inf)
            is_between = low > 0 and high < math.inf
            is_close = is_between and (off[high] - off[low] <= BRACKET_DB or high < BRACKET_RATIO * low)
            if is_close or abs(off[nearest[0]]) <= TOLERANCE_DB:
                break
            db_a_decade = 20.0
            if len(nearest) > 1:
                found = (off[nearest[1]] - off[nearest[0]]) / math.log10(nearest[1] / nearest[0])
                db_a_decade = found if 5 <= found <= 60 else db_a_decade
            edge = nearest[0] if is_between else max(off) if low else min(off)
            step = edge * 10 ** ((math.copysign(OVERSHOOT_DB, -off[edge]) - off[edge]) / db_a_decade)
            if is_between:
                step = math.sqrt(low * high) if n % 3 == 2 else min(high / 1.01, max(low * 1.01, step))
        return self

    def size(self, index: int = 0) -> float:
        """Return a size at the target; NaN if no trial came near it."""
        return interpolated([(sizes[index], db) for db, *sizes in self.tried.values()], self.target_db)

    def step(self) -> float:
        """Return the step whose trial is nearest to the target."""
        return min(self.tried, key=lambda s: abs(self.tried[s][0] - self.target_db))


def interpolated(points: list[tuple[float, float]], target_db: float) -> float:
    """Interpolate the size at `target_db` from points (size, dB).

    The logarithm of the size is interpolated between the nearest points on both sides. If all points are on
    one side, the nearest one counts if it is at most `TOLERANCE_DB` away; otherwise the result is NaN.
    """
    nearest = sorted(points, key=lambda p: abs(p[1] - target_db))
    below = next((p for p in nearest if p[1] <= target_db), None)
    above = next((p for p in nearest if p[1] > target_db), None)
    if below and above and min(below[0], above[0]) > 0:
        weight = (target_db - below[1]) / (above[1] - below[1])
        return float(math.exp(math.log(below[0]) * (1 - weight) + math.log(above[0]) * weight))
    return nearest[0][0] if nearest and abs(nearest[0][1] - target_db) <= TOLERANCE_DB else math.nan


def touch_search(frames: list[ForceField], target_db: float, effort: str, interframe: str) -> Search:
    """Search the step of coder `touch` in mode nmse for an NMSE.

    The sizes are all bytes, and the bits of all frames but the first. The first step is that of a uniform
    quantiser with this error, step^2 / 12 per component.
    """
    energy = sum(float((f.forces_n.astype(float) ** 2).sum()) for f in frames)
    count = max(1, sum(f.support_count for f in frames))

    def code(step_n: float) -> Trial:
        coded = touch(frames, mode="nmse", step_n=step_n, effort=effort, interframe=interframe)
        return coded.nmse_db, float(coded.bytes), float(coded.later_bits)

    return Search(code, target_db, math.sqrt(4 * energy / count * 10 ** (target_db / 10))).run()
