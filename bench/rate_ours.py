"""The package's own coders as `rate.py` measures them."""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rate_search import Search, Trial, at_error, interpolated
from touchfield.codec.objects.encoder import ObjectsEncoder
from touchfield.codec.paper.body import BodyReader
from touchfield.codec.paper.decoder import PaperDecoder
from touchfield.codec.paper.directions import Codebook
from touchfield.codec.paper.encoder import PaperEncoder
from touchfield.codec.paper.frames import scan_slots
from touchfield.codec.paper.spec import PaperSpec
from touchfield.codec.touch.decoder import TouchDecoder
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.measure.fidelity import FidelityMeter
from touchfield.medium import ForceField, HapticScene
from touchfield.parallel import worker_count

__all__ = [
    "F0_N",
    "Coded",
    "K",
    "at_error",
    "first_step",
    "interpolated",
    "object_bytes",
    "paper",
    "paper_symbols",
    "speed",
    "touch",
    "touch_at_error",
    "touch_search",
]

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


def paper_symbols(frames: list[ForceField], **asked: Any) -> tuple[NDArray[np.int32], int]:
    """What coder `paper` sends of frames coded alone: its symbols, and the bytes of what turns them into newtons.

    Returns
    -------
    symbols : int32 [frame, x, y, z, 2]
        Amplitude level from 1 on and number of the direction; both 0 where there is no force.
    table_bytes : int
        Of the amplitudes' levels, float32.
    """
    grid = frames[0].grid
    spec = PaperSpec(**{"nq": 6, "directions": "octa3", "deadband": "none", "interframe": "none", **asked})
    encoder = PaperEncoder(grid, spec)
    codebook = Codebook.get(encoder.parameters.decode("ascii"))
    reader = BodyReader(encoder.encode_segment(frames).body, grid, codebook)
    made = []
    for symbols, _ in reader.frames(len(frames)):
        values = np.zeros((len(symbols.bricks) * 512, 3), np.float32)
        slots = scan_slots(symbols.bricks, symbols.mask, reader.synthesis.scan)
        values[slots, 0], values[slots, 1] = symbols.levels + 1.0, symbols.directions
        field = ForceField(grid, symbols.bricks, values.reshape(-1, 8, 8, 8, 3))
        made.append(field.to_dense()[..., :2].astype(np.int32))
        table_bytes = 4 * len(reader.amplitude(symbols.kind).levels_n)
    return np.stack(made), table_bytes


def speed(frames: list[ForceField], effort: str, runs: int = 2) -> dict[str, float]:
    """Frames a second of the promise, segments of `frames` in a thread for each core; the best of `runs`."""
    encoder = TouchEncoder(frames[0].grid, TouchSpec(k=K, f0_n=F0_N, effort=effort))
    decoder = TouchDecoder(frames[0].grid, encoder.parameters)
    segments = worker_count()
    bodies: list[bytes] = []

    def rate(job: Callable[[int], object]) -> float:
        times = []
        for _ in range(runs):
            began = perf_counter()
            with ThreadPoolExecutor(segments) as pool:
                list(pool.map(job, range(segments)))
            times.append(perf_counter() - began)
        return segments * len(frames) / min(times)

    return {
        "encode_frames_s": rate(lambda _: bodies.append(encoder.encode_segment(frames).body)),
        "decode_frames_s": rate(lambda _: list(decoder.frames(bodies[0], len(frames)))),
        "bytes_a_frame": len(bodies[0]) / len(frames),
        "frames": len(frames),
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

FINER = {"fast": 1.0, "default": 1.0, "max": 0.62}
"""The step at an error, over that of the effort before: effort max weighs bits against error, and errs more."""


def first_step(frames: list[ForceField], target_db: float) -> float:
    """The step of a uniform lattice with that error: step^2 / 12 a component."""
    energy = sum(float((f.forces_n.astype(float) ** 2).sum()) for f in frames)
    count = sum(f.support_count for f in frames)
    return math.sqrt(4 * energy / max(count, 1) * 10 ** (target_db / 10))


def touch_search(
    frames: list[ForceField], target_db: float, effort: str, start: float, *, interframe: str = "auto", **asked: Any
) -> Search:
    """Coder `touch` in mode nmse at an NMSE; sizes are all bytes, and the bits of all frames but the first."""

    def code(step_n: float) -> Trial:
        made = touch(frames, mode="nmse", step_n=step_n, effort=effort, interframe=interframe)
        return made.nmse_db, float(made.bytes), float(sum(made.frame_bits[1:]))

    return Search(code, target_db, start, **asked).run()


def touch_at_error(frames: list[ForceField], target_db: float, effort: str) -> float:
    """Bytes of coder `touch` in mode nmse at an NMSE."""
    return touch_search(frames, target_db, effort, first_step(frames, target_db) * FINER[effort]).size()
