"""Compares a field as a zarr store with ``.npz``: time to write and read, and bytes.

    python bench/bench_zarr.py [--nw N] [--runs N] [--quick]

The field is that of a stereo picture on 2^n_w samples along each axis. The zarr store is written with zstd,
zarr's default, and with the codec of coder `touch`. That codec guarantees the error bound with k = 0.1 and
F_0 = 0.05 N in every chunk, and the store is written tile by tile from the source. The formats take turns,
and the best of `--runs` runs counts.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

from machine import Bar, Figures, at_least, bench, figure, need_module
from touchfield import EncodeSpec, prepare
from touchfield.codec import TouchSpec
from touchfield.medium.stores.npz import read_npz, write_npz
from touchfield.medium.stores.zarr_store import read_zarr, write_zarr
from touchfield.pipeline.tiles import encode_tiles

SOURCE = "sample:motorcycle"


def seconds(work: Callable[[Path], object], path: Path) -> float:
    """Return the wall seconds of a call."""
    began = perf_counter()
    work(path)
    return perf_counter() - began


def size(path: Path) -> int:
    """Return the bytes of a file, or of all files in a folder."""
    return sum(p.stat().st_size for p in ([path] if path.is_file() else path.rglob("*")) if p.is_file())


def measure(nw: int, runs: int) -> Figures:
    """Write and read in each format, several times."""
    need_module("zarr")
    spec = EncodeSpec(nw=nw, representation="voxel", touch=TouchSpec())
    medium = prepare(SOURCE, spec).medium
    frames = [medium[0]]
    in_memory = type(medium).from_frames(frames, medium.rate_hz, medium.axes)
    rows: dict[str, Figures] = {"npz": {}, "zarr, zstd": {}, "zarr, touch": {}}
    for run in range(runs + 1):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            ways: dict[str, tuple[str, Callable[[Path], object], Callable[[Path], object]]] = {
                "npz": ("a.npz", lambda path: write_npz(path, in_memory), lambda path: read_npz(path)[0]),
                "zarr, zstd": (
                    "a.zarr",
                    lambda path: write_zarr(path, in_memory),
                    lambda path: read_zarr(path)[0],
                ),
                "zarr, touch": (
                    "b.zarr",
                    lambda path: encode_tiles(SOURCE, path, spec),
                    lambda path: read_zarr(path)[0],
                ),
            }
            for way, (file, write, read) in ways.items():
                took = {"write_s": seconds(write, folder / file), "read_s": seconds(read, folder / file)}
                if run:  # the first run compiles
                    rows[way] = {k: min(v, rows[way].get(k, v)) for k, v in took.items()}
                    rows[way]["bytes"] = size(folder / file)
    return {
        "source": SOURCE,
        "samples": medium.grid.voxel_count,
        "supported": frames[0].support_count,
        "ways": rows,
    }


def bars(figures: Figures) -> list[Bar]:
    """Require at least half the speed of ``.npz``."""

    def ratio(key: str) -> float:
        npz, zarr = (figure(figures, "ways", way, key) for way in ("npz", "zarr, zstd"))
        return float(npz / zarr)

    return [
        at_least("zarr: speed of writing over that of npz", ratio("write_s"), 0.5),
        at_least("zarr: speed of reading over that of npz", ratio("read_s"), 0.5),
    ]


if __name__ == "__main__":
    bench("zarr", __doc__, measure, bars, nw=(8, 6), runs=(3, 1))
