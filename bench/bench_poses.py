"""Measures the coder of body motions (tracks of poses), against zlib and LZMA: bytes per pose and speed.

    python bench/bench_poses.py [--quick] [--frames N]

The tracks have 2000 frames (`--frames`) at 1 kHz: the seven bodies of `sample:falling-7`, which tumble and
bounce; a body that spins; and a body that stands still. The quantisation steps are those that move no point
of a body of 4 cm by more than 100, 10 and 1 um.

The peers are zlib -9 and LZMA on the same quantised integers, component by component, as first or second
differences in int32, whichever is shorter; and the poses as seven float32.
"""

from __future__ import annotations

import lzma
import zlib
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from machine import Bar, Figures, at_least, at_most, bench, column, timed
from touchfield.codec.objects.decoder import PoseSteps, decode_poses
from touchfield.codec.objects.encoder import choose_pose_steps, encode_poses
from touchfield.medium.pose_track import PoseTrack
from touchfield.pipeline import prepare
from touchfield.pipeline.spec import EncodeSpec

RATE_HZ = 1000.0
REACH_M = 0.04

Float64s = NDArray[np.float64]


def spinning(frames: int) -> PoseTrack:
    """Return a track that spins about one axis at 3 turns per second, in place."""
    half = np.pi * 3 * np.arange(frames) / RATE_HZ
    return PoseTrack(
        np.column_stack([np.cos(half), 0 * half, 0.6 * np.sin(half), 0.8 * np.sin(half)]),
        np.zeros((frames, 3)),
    )


def packed(numbers: NDArray[np.int64], pack: Callable[[bytes], bytes]) -> int:
    """Return the bytes of the differences by a general-purpose coder.

    The better of the first and second differences counts.
    """
    return min(len(pack(np.diff(numbers, order, axis=0).T.astype("<i4").tobytes())) for order in (1, 2))


def row_of(track: PoseTrack, steps: PoseSteps) -> dict[str, float]:
    """Return bytes per pose, also of the peers, and million poses per second."""
    data = encode_poses(track, steps)
    turns = np.rint(track.quaternions / steps.quaternion)
    numbers = np.column_stack([np.rint(track.positions_m / steps.position_m), turns]).astype(np.int64)
    count = len(track)
    encode_ms = timed(lambda: encode_poses(track, steps))["min_ms"]
    decode_ms = timed(lambda: decode_poses(data, count, steps))["min_ms"]
    return {
        "bytes": len(data),
        "bytes_a_pose": len(data) / count,
        "zlib_bytes_a_pose": packed(numbers, lambda b: zlib.compress(b, 9)) / count,
        "lzma_bytes_a_pose": packed(numbers, lzma.compress) / count,
        "float32_bytes_a_pose": 28.0,
        "encode_mposes_s": count / encode_ms / 1e3,
        "decode_mposes_s": count / decode_ms / 1e3,
    }


def measure(frames: int) -> Figures:
    """Measure each track at three tolerances."""
    scene = prepare("sample:falling-7", EncodeSpec(frames=(0, frames))).objects
    assert scene is not None
    tracks = {
        **{f"falling {body.name}": body.track for body in scene.objects},
        "spinning": spinning(frames),
        "still": PoseTrack.constant(frames, (0.1, 0.2, 0.05)),
    }
    rows = {}
    for tolerance_um in (100, 10, 1):
        for name, track in tracks.items():
            steps = choose_pose_steps(track, REACH_M, 1e-6 * tolerance_um)
            at = {"position_step_m": steps.position_m, "quaternion_step": steps.quaternion}
            rows[f"{name}, {tolerance_um} um"] = row_of(track, steps) | at
    search_ms = timed(lambda: choose_pose_steps(tracks["spinning"], REACH_M, 1e-5))["min_ms"]
    return {"frames": frames, "rows": rows, "place_steps_ms": search_ms}


def bars(figures: Figures) -> list[Bar]:
    """Require fewer bytes than the peers, 3 kB for a falling body, and 0.1 M poses/s."""
    rows = figures["rows"]
    over = [
        min(row["zlib_bytes_a_pose"], row["lzma_bytes_a_pose"]) / row["bytes_a_pose"] for row in rows.values()
    ]
    falling = [
        row["bytes"] for name, row in rows.items() if name.startswith("falling") and name.endswith(" 10 um")
    ]
    coded, decoded = (min(column(rows, f"{way}_mposes_s")) for way in ("encode", "decode"))
    return [
        at_least("bytes of the shorter of zlib and lzma over ours, worst", min(over), 1.0),
        at_most("2000 poses of a falling body at 10 um", max(falling, default=None), 3000, "bytes"),
        at_least("poses coded, slowest", coded, 0.1, "M/s"),
        at_least("poses decoded, slowest", decoded, 0.1, "M/s"),
        at_most("search for the steps of a track", figures.get("place_steps_ms"), 50.0, "ms"),
    ]


if __name__ == "__main__":
    bench("poses", __doc__, measure, bars, frames=(2000, 200))
