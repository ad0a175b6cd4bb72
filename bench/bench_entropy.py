"""Measures the lossless codes of coder `paper` and of the support (the samples that have a force), against
zlib and LZMA.

    python bench/bench_entropy.py [--quick] [--symbols N]

Huffman codes and hold runs are timed on `--symbols` random symbols. A support, the set of samples that have a
force, is coded for the band and height fields of `rate.py` at 128^3 samples (alone, and given the frame
before) and for the walls of six spheres, once smooth and once with a rough edge. The peers of the support
code are zlib -9 and LZMA on the mask packed into bits; only bytes are compared. Times are the best of several
runs, on one thread.
"""

from __future__ import annotations

import lzma
import tempfile
import zlib
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machine import Bar, Figures, at_least, at_most, bench, column, timed
from rate_fields import cases
from touchfield.codec.paper.body import RUN_SYMBOLS, decode_symbols
from touchfield.codec.paper.encoder import encode_symbols, fitted_code, pack_runs
from touchfield.codec.support import decode_support, encode_numbers, encode_support
from touchfield.medium import ForceField, Grid

SAMPLES = 128
WALL = 4
GRID = Grid((SAMPLES,) * 3, (1e-3,) * 3, (0, 0, 0))


def best_ms(job: Callable[[], object]) -> float:
    """Return the wall time of the fastest of several runs, milliseconds."""
    return timed(job, runs=9)["min_ms"]


# -- Huffman -----------------------------------------------------------------------------------------------


def fit(symbols: NDArray[np.uint16], count: int) -> Any:
    """Fit a code to the counts of symbols below `count`."""
    return fitted_code(np.bincount(symbols, minlength=count))


def plain_rates(count: int) -> dict[str, dict[str, float]]:
    """Time Huffman codes on random symbols, Msym/s.

    The alphabets have the sizes of amplitude levels, of 258 directions, and of 4000 symbols.
    """
    rng = np.random.default_rng(1)
    rows = {}
    for n, spread in ((64, 8), (258, 60), (4000, 700)):
        symbols = np.minimum(np.abs(rng.normal(0, spread, count)), n - 1).astype(np.uint16)
        code = fitted_code(np.bincount(symbols, minlength=n))
        stream = encode_symbols(code, symbols)
        decode_ms = best_ms(partial(decode_symbols, code, stream, len(symbols), n))
        rows[f"huffman, {n} symbols"] = {
            "bits_a_symbol": stream.bit_length / len(symbols),
            "table_bytes": len(encode_numbers(code.lengths)),
            "encode_msym_s": len(symbols) / 1e3 / best_ms(partial(encode_symbols, code, symbols)),
            "decode_msym_s": len(symbols) / 1e3 / decode_ms,
            "fit_ms": best_ms(partial(fit, symbols[:100_000], n)),
        }
    return rows


def run_rates(count: int) -> dict[str, dict[str, float]]:
    """Time levels with hold runs, a fifth and half of the samples sent, Msample/s."""
    rng = np.random.default_rng(2)
    rows = {}
    for sent_fraction in (0.2, 0.5):
        sent = rng.random(count) < sent_fraction
        levels = np.minimum(np.abs(rng.normal(0, 8, int(sent.sum()))), 63).astype(np.uint16)
        streams = pack_runs(sent, levels, 64, single=False)
        code = fitted_code(np.bincount(streams[0], minlength=64 + RUN_SYMBOLS))
        stream = encode_symbols(code, *streams)
        pack_ms = best_ms(partial(pack_runs, sent, levels, 64, single=False))
        write_ms = best_ms(partial(encode_symbols, code, *streams))
        read_ms = best_ms(partial(decode_symbols, code, stream, len(sent), 64))
        rows[f"runs, {sent_fraction:.0%} sent"] = {
            "bits_a_sample": stream.bit_length / len(sent),
            "pack_msample_s": len(sent) / 1e3 / pack_ms,
            "encode_msym_s": len(streams[0]) / 1e3 / write_ms,
            "decode_msym_s": len(streams[0]) / 1e3 / read_ms,
            "decode_msample_s": len(sent) / 1e3 / read_ms,
        }
    return rows


# -- the support -------------------------------------------------------------------------------------------


def spheres(roughness: float) -> NDArray[np.bool_]:
    """Return the walls of six spheres.

    `roughness` is the standard deviation of the edge, in samples.
    """
    rng = np.random.default_rng(0)
    ijk = np.stack(np.meshgrid(*[np.arange(SAMPLES)] * 3, indexing="ij"), axis=-1)
    supported = np.zeros((SAMPLES,) * 3, np.bool_)
    for _ in range(6):
        distance = np.linalg.norm(ijk - rng.uniform(20, 108, 3), axis=-1) - rng.uniform(8, 20)
        distance += rng.normal(0, roughness, distance.shape)
        supported |= (distance < 0) & (distance > -WALL)
    return supported


def fields() -> Iterator[tuple[str, ForceField, ForceField | None]]:
    """Yield name, field, and the frame before or None."""
    with tempfile.TemporaryDirectory() as scratch:
        for case in cases((7,)):
            if case.kind in ("band", "height"):
                first, *others = case.frames(Path(scratch))[:2]
                yield f"support, {case.name}", first, None
                for second in others:
                    yield f"support, {case.name}, given the frame before", second, first
    for name, roughness in (("spheres", 0.0), ("rough spheres", 0.5)):
        yield (
            f"support, {name}",
            ForceField.from_dense(GRID, spheres(roughness)[..., None] * np.ones(3, "f4")),
            None,
        )


def support_row(field: ForceField, before: ForceField | None) -> dict[str, float]:
    """Return bytes, milliseconds and Mbit/s of one support.

    A bit is a sample of a brick.
    """
    grid, support = field.grid, (field.bricks, field.mask)
    previous = None if before is None else (before.bricks, before.mask)
    data = encode_support(grid, *support, previous)
    read = decode_support(data, grid, previous)
    assert all(np.array_equal(a, b) for a, b in zip(read, support, strict=True))
    raw = np.packbits(field.to_dense().any(axis=-1)).tobytes()
    encode_ms = best_ms(lambda: encode_support(grid, *support, previous))
    decode_ms = best_ms(lambda: decode_support(data, grid, previous))
    return {
        "supported_voxels": field.support_count,
        "bricks": len(field.bricks),
        "bytes": len(data),
        "zlib_bytes": len(zlib.compress(raw, 9)),
        "lzma_bytes": len(lzma.compress(raw, preset=9)),
        "bits_per_supported_voxel": 8 * len(data) / field.support_count,
        "encode_ms": encode_ms,
        "decode_ms": decode_ms,
        "encode_mbit_s": 0.512 * len(field.bricks) / encode_ms,
        "decode_mbit_s": 0.512 * len(field.bricks) / decode_ms,
    }


def measure(symbols: int) -> Figures:
    """Measure symbols, runs and supports."""
    supports = {name: support_row(field, before) for name, field, before in fields()}
    return {"rows": {**plain_rates(symbols), **run_rates(symbols), **supports}}


def bars(figures: Figures) -> list[Bar]:
    """Require shorter supports than the peers, and 30 frames/s at 128^3 samples."""
    rows = figures["rows"]
    supports = {name: row for name, row in rows.items() if name.startswith("support")}
    over = [min(row["zlib_bytes"], row["lzma_bytes"]) / row["bytes"] for row in supports.values()]
    dense_msym_s = 30 * SAMPLES**3 / 1e6
    plain = {name: row for name, row in rows.items() if name.startswith("huffman")}
    runs = {name: row for name, row in rows.items() if name.startswith("runs")}
    return [
        at_least(
            "bytes of the shorter of zlib and lzma over a support's, worst", min(over, default=None), 1.0
        ),
        at_most(
            "reading a support, slowest", max(column(supports, "decode_ms"), default=None), 1e3 / 30, "ms"
        ),
        at_most(
            "writing a support, slowest", max(column(supports, "encode_ms"), default=None), 1e3 / 30, "ms"
        ),
        at_least("Huffman, read", min(column(plain, "decode_msym_s"), default=None), dense_msym_s, "M/s"),
        at_least("Huffman, written", min(column(plain, "encode_msym_s"), default=None), dense_msym_s, "M/s"),
        at_least("hold runs, read", min(column(runs, "decode_msample_s"), default=None), dense_msym_s, "M/s"),
    ]


if __name__ == "__main__":
    bench("entropy", __doc__, measure, bars, symbols=(2_000_000, 100_000))
