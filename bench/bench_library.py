"""Measures the time to index a folder of 10,000 small `.touch` files, and to search it.

    python bench/bench_library.py [--quick] [--files N]

The folder has 10,000 .touch files (`--files`): balls and walls of 40 sizes, each with three frames on a
lattice of 32^3 samples, in 250 copies. The copies differ in their provenance, so that no checksum matches.
The time to index is compared with the time to open every file and decode all frames, on all cores; decoding
and indexing alternate over ten subfolders. Then the unchanged folder is indexed again, and searched.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from machine import Bar, Figures, at_least, at_most, bench
from touchfield.compute.executors import in_order
from touchfield.container.records import Pair, Provenance
from touchfield.container.wire import encode_record
from touchfield.measure.descriptors import Descriptor
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.pipeline.encoding import encode_prepared
from touchfield.pipeline.preparation import prepare
from touchfield.pipeline.source import decode
from touchfield.tasks.library import Library, index_folder, library_path

KINDS, N = 40, 32


def media() -> list[HapticMedium]:
    """Return balls and walls of `KINDS` sizes that move a little."""
    grid = Grid((N, N, N), (0.003,) * 3, (-0.0465,) * 3)
    x, y, z = np.meshgrid(*(grid.axis_m(n) for n in range(3)), indexing="ij")
    media_list = []
    for kind in range(KINDS):
        frames = []
        for frame in range(3):
            size = 0.012 + 0.0006 * kind
            if kind % 2:
                away = np.sqrt((x - 0.002 * frame) ** 2 + y**2 + z**2)
                normal = np.stack([x - 0.002 * frame, y, z], axis=-1) / np.maximum(away, 1e-9)[..., None]
                depth = size - away
            else:
                normal = np.broadcast_to([0.0, 0.6, 0.8], (*grid.shape, 3))
                depth = size - 0.02 - 0.6 * y - 0.8 * z - 0.001 * frame + 0.004 * np.sin(60 * x)
            force = np.clip(400 * depth, 0, 3.0) * (depth < 0.009)
            frames.append(ForceField.from_dense(grid, force[..., None] * normal))
        media_list.append(HapticMedium.from_frames(frames, 30.0))
    return media_list


def fill_folder(folder: Path, files: int) -> float:
    """Write `files` files into `folder`; return their mean size."""
    for kind, medium in enumerate(media()):
        encode_prepared(prepare(medium), folder / "first.touch", {"copy": "0000"})
        content = (folder / "first.touch").read_bytes()
        for copy in range(files // KINDS):
            target = folder / f"{copy % 10}" / f"kind{kind:02}-{copy:04}.touch"
            target.parent.mkdir(exist_ok=True)
            target.write_bytes(content.replace(_provenance_record("0000"), _provenance_record(f"{copy:04}")))
    (folder / "first.touch").unlink()
    return float(np.mean([f.stat().st_size for f in folder.rglob("*.touch")]))


def _provenance_record(copy: str) -> bytes:
    return encode_record("PROV", Provenance(pairs=(Pair(key="copy", value=copy),)))


def decode_s(folder: Path) -> float:
    """Return the seconds to decode every file, on all cores as `index_folder` does."""

    def count_supported(path: Path) -> int:
        return sum(frame.support_count for frame in decode(path))

    files = sorted(folder.rglob("*.touch"))
    began = perf_counter()
    assert sum(in_order(count_supported, files)) > 0
    return perf_counter() - began


def query_times(folder: Path) -> dict[str, Any]:
    """Return milliseconds to read the index, to prepare the search, and for one query."""
    began = perf_counter()
    library = Library.load(library_path(folder))
    read_ms, began = 1e3 * (perf_counter() - began), perf_counter()
    index = library.index()
    rows = [Descriptor(row) for row in list(library.rows.values())[:: len(library.rows) // 50]]
    index.query(rows[0], 1)
    ready_ms = 1e3 * (perf_counter() - began)
    times = []
    for row in rows:
        began = perf_counter()
        index.query(row, 10)
        times.append(1e3 * (perf_counter() - began))
    median, worst = float(np.median(times)), max(times)
    return {
        "media": len(index),
        "read_ms": read_ms,
        "ready_ms": ready_ms,
        "median_ms": median,
        "worst_ms": worst,
    }


def same_kind_fraction(folder: Path) -> float:
    """Return the fraction of queries whose ten nearest media are all of the same kind."""
    index = Library.load(library_path(folder)).index()
    names = index.names[:: len(index.names) // 50]
    is_right = []
    for name in names:
        nearest = index.query(index[name], 10)
        is_right.append(all(match.name[2:8] == name[2:8] for match in nearest))
    return float(np.mean(is_right))


def measure(files: int) -> Figures:
    """Decode and index alternately, index the unchanged folder again, and search it."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "media"
        folder.mkdir()
        mean_bytes = fill_folder(folder, files)
        index_folder(folder / "0", folder.parent / "warm.npz")  # compile kernels and fill the disk cache
        merged, pairs = Library(), []
        for part in sorted(p for p in folder.iterdir() if p.is_dir()):
            alone_s = decode_s(part)  # alternate, because the load of a machine varies
            done = index_folder(part, folder.parent / f"{part.name}.npz")
            pairs.append((alone_s, done.figures["seconds"]))
            for name, row in done.library.rows.items():
                merged.store(f"{part.name}/{name}", done.library.entries[name], row)
        merged.save(library_path(folder))
        again = index_folder(folder)
        alone_s, index_s = (sum(times) for times in zip(*pairs, strict=True))
        index = {"decoder_s": alone_s, "index_s": index_s, "files_per_s": len(merged.rows) / index_s}
        index |= {"unchanged_s": again.figures["seconds"], "described_again": again.figures["described"]}
        return {
            "files": {"count": len(merged.rows), "mean_bytes": mean_bytes, "frames": 3, "lattice": [N, N, N]},
            "index": index | {"times_the_decoder": index_s / alone_s},
            "query": {**query_times(folder), "own_kind_share": same_kind_fraction(folder)},
        }


def bars(figures: Figures) -> list[Bar]:
    """Limit indexing to twice the decoding time; require fast, correct queries."""
    index, query = figures["index"], figures["query"]
    return [
        at_most("time to describe a folder over the decoder's own", index["times_the_decoder"], 2.0),
        at_most("files described again where nothing changed", index["described_again"], 0),
        at_most("a folder in which nothing changed", index["unchanged_s"], 1.0, "s"),
        at_most("a query, worst", query["worst_ms"], 50.0, "ms"),
        at_least("queries whose ten nearest are of their kind, share", query["own_kind_share"], 1.0),
    ]


if __name__ == "__main__":
    bench("library", __doc__, measure, bars, files=(10_000, 480))
