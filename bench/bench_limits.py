"""Measures how fast coding limits (`measure.limits`) are computed, and compares their bits with those of zlib
and LZMA.

    python bench/bench_limits.py [--quick] [--nw N]

The fields are the samples terrain and motorcycle, and three frames of each depth sequence of the optional
folder ../shared/data, on 2^n_w samples along each axis, quantised by weber:0.1/ico5. The conditional entropy
of a symbol given its three neighbours is compared with zlib -9 and LZMA on the symbols as int16 in raster
order. The throughput counts every sample of the lattice, empty ones included. Times are the best of several
runs, on one thread.
"""

from __future__ import annotations

import lzma
import zlib
from collections.abc import Iterator

import numpy as np

import touchfield as tf
from machine import SHARED, Bar, Figures, at_least, bench, column, timed
from touchfield.codec.paper.field_quantiser import FieldQuantiserSpec
from touchfield.measure.field_symbols import FieldSymbols
from touchfield.measure.limits import ContextCounter, coding_limits


def media(nw: int) -> Iterator[tuple[str, list[FieldSymbols]]]:
    """Yield the name of each field and its quantised frames."""
    sources = {"terrain": "sample:terrain", "motorcycle": "sample:motorcycle"}
    for folder in ("rgbd_iclnuim_livingroom1", "rgbd_tum_fr1_rpy"):
        if (SHARED / folder).is_dir():
            sources[folder] = str(SHARED / folder)
    for name, source in sources.items():
        frames = (0, 3) if name.startswith("rgbd") else None
        medium = tf.prepare(source, tf.EncodeSpec(nw=nw, frames=frames)).medium
        fields = [medium[i] for i in range(medium.frame_count)]
        quantiser = FieldQuantiserSpec.parse("weber:0.1/ico5").fit(fields)
        yield name, [quantiser(f) for f in fields]


def row(frames: list[FieldSymbols]) -> dict[str, float]:
    """Return the throughput for the first frame, and the limits of all frames."""
    first = frames[0]
    voxels = first.voxel_count
    found: dict[str, float] = {"frames": len(frames), "support_share": first.object_count / voxels}

    def contexts() -> None:
        ContextCounter(first, previous_frame=False).add(first, None)

    found["contexts_mvoxel_s"] = voxels / 1e3 / timed(contexts, runs=5)["min_ms"]
    limits = coding_limits(frames)
    raw = np.stack([f.to_dense() for f in frames]).astype(np.int16).tobytes()
    supported = limits.supported
    found["object_entropy_bits"] = limits.object_entropy.value
    found["axes_bits_a_supported"] = limits.context("axes").per_voxel.value * limits.voxels / supported
    found["zlib_bits_a_supported"] = 8 * len(zlib.compress(raw, 9)) / supported
    found["lzma_bits_a_supported"] = 8 * len(lzma.compress(raw, preset=9)) / supported
    return found


def measure(nw: int) -> Figures:
    """Measure all fields."""
    return {"nw": nw, "rows": {name: row(frames) for name, frames in media(nw)}}


def bars(figures: Figures) -> list[Bar]:
    """Require limits below the bits of the best peer, and 30 million voxels/s."""
    rows = figures["rows"].values()
    peers = [min(row["zlib_bits_a_supported"], row["lzma_bits_a_supported"]) for row in rows]
    over = [peer / row["axes_bits_a_supported"] for peer, row in zip(peers, rows, strict=True)]
    return [
        at_least("bits of the shorter of zlib and lzma over H(S|3 neighbours), worst", min(over), 1.0),
        at_least("contexts, slowest", min(column(rows, "contexts_mvoxel_s")), 30.0, "M/s"),
    ]


if __name__ == "__main__":
    bench("limits", __doc__, measure, bars, nw=(7, 5))
