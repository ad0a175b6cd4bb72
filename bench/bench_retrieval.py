"""Measures how often a changed medium finds its original among 500 others by `touchfield search`.

    python bench/bench_retrieval.py [--quick] [--media N]

The index has `--media` random solids (`retrieval_media`). Each is changed in seven ways, a split each, and is
the query of a search; "top-1" is the fraction of the queries whose nearest medium is the original:

* shift: up to 15 mm along each axis.
* noise: normal, 0.1 N in each component of every force.
* rotation: any.
* scale: 0.7 to 1.4 times as large, the law of the hand unchanged.
* sensor: a cloud of points with 0.3 mm noise, seen from 14 sides; the wall ends where the force is largest.
* coder: encoded within the mask by the default coder, and decoded.
* all combined: rotated, scaled, shifted, with noise, and after the coder.

The ways to search are `search`, `search --any-pose`, and for comparison: the descriptor without its shells
(version 1), the number of perceptible voxels, the histogram of distances between pairs of voxels (D2 of R.
Osada, T. Funkhouser, B. Chazelle and D. Dobkin, Shape distributions, ACM Transactions on Graphics 21(4),
2002) relative to their mean, and a random order.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from machine import Bar, Figures, at_least, bench, figure
from retrieval_media import SPLITS, field_of
from touchfield.measure.descriptors import FORCES_N, Descriptor, descriptor
from touchfield.measure.retrieval import ANY_POSE, MediumIndex
from touchfield.medium import ForceField

SEARCH, ANY, VERSION_1, COUNT, D2, RANDOM = (
    "search", "any pose", "without shells", "voxel count", "D2", "random",
)  # fmt: skip
WEIGHTS: Final = {SEARCH: {}, ANY: dict(ANY_POSE), VERSION_1: {"shells": 0.0}}
PAIRS, BINS, MAX_DISTANCE = 20_000, 32, 3.0
LIMITS: Final = {
    "shift": 0.95, "noise": 0.95, "coder": 0.95, "rotation": 0.9, "scale": 0.85, "all combined": 0.8,
}  # fmt: skip

Float64s = NDArray[np.float64]


def pair_distances(field: ForceField, seed: int) -> Float64s:
    """Return the square roots of a histogram of pair distances over their mean, float64 [BINS]."""
    support = field.support()
    positions = support.positions[support.amplitudes_n >= FORCES_N[0]].astype(np.float64)
    pairs = np.random.default_rng([seed, 3]).integers(len(positions), size=(2, PAIRS))
    distances = np.linalg.norm(positions[pairs[0]] - positions[pairs[1]], axis=1)
    counts, _ = np.histogram(distances / distances.mean(), BINS, (0, MAX_DISTANCE))
    return np.asarray(np.sqrt(counts / PAIRS))


def voxel_count(field: ForceField) -> int:
    """Return the number of perceptible voxels."""
    return int((field.support().amplitudes_n >= FORCES_N[0]).sum())


def described(count: int, split: str) -> dict[str, Any]:
    """Return descriptors, voxel counts and pair distances of all solids in a split."""
    entries: list[Descriptor] = []
    counts, pairs = np.empty(count), np.empty((count, BINS))
    for seed in range(count):
        field = field_of(seed, split)
        entries.append(descriptor(field))
        counts[seed], pairs[seed] = voxel_count(field), pair_distances(field, seed)
    print(split, "described", flush=True)
    return {
        "entries": entries,
        COUNT: np.log(counts)[:, None],
        D2: pairs,
        "mean_voxels": float(counts.mean()),
    }


def nearest_fraction(originals: Float64s, queries: Float64s) -> float:
    """Return the fraction of the queries [n, d] whose nearest original [n, d] is their own."""
    nearest = [int(((originals - query) ** 2).sum(axis=1).argmin()) for query in queries]
    return float(np.mean(nearest == np.arange(len(queries))))


def measure(media: int) -> Figures:
    """Describe all media, and search for each in each split."""
    originals, index = described(media, "original"), MediumIndex()
    for seed, entry in enumerate(originals["entries"]):
        index.add(str(seed), entry)
    rows: Figures = {}
    for split in SPLITS:
        queries = described(media, split)
        row = {}
        for way, weights in WEIGHTS.items():
            found = [index.query(entry, 1, weights)[0].name for entry in queries["entries"]]
            row[way] = float(np.mean([name == str(seed) for seed, name in enumerate(found)]))
        row |= {way: nearest_fraction(originals[way], queries[way]) for way in (COUNT, D2)}
        rows[split] = {**row, RANDOM: 1 / media, "mean_voxels": queries["mean_voxels"]}
    return {"media": media, "top-1": rows}


def bars(figures: Figures) -> list[Bar]:
    """Require the original first for most queries, and more often than simpler descriptors find it."""
    rows = figures["top-1"]
    found = [
        at_least(f"{split}: top-1", figure(rows, split, SEARCH), limit) for split, limit in LIMITS.items()
    ]
    found += [
        at_least(f"{split}: top-1, any pose", figure(rows, split, ANY), LIMITS[split])
        for split in ("rotation", "all combined")
    ]
    ahead = min(row[SEARCH] - max(row[COUNT], row[D2]) for row in rows.values())
    return [*found, at_least("top-1 over that of voxel count and D2, worst split", ahead, 0.0)]


if __name__ == "__main__":
    bench("retrieval", __doc__, measure, bars, media=(500, 20))
