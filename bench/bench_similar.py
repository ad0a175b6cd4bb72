"""Measures which changes of a medium the measures of `touchfield similar` see through.

    python bench/bench_similar.py [--quick] [--media N]

Each of `--media` random solids (`retrieval_media`) is changed, and compared with every original. "top-1" is
the fraction of them whose nearest original by a measure is their own. NMI and VI compare voxels at equal
positions, sqrt(JSD) the histograms of symbols, NCD the bytes of a compressor; "descriptor" is the distance of
`touchfield search`. The comparisons are the difference in the number of supported voxels, and a random order.
"""

from __future__ import annotations

import warnings

import numpy as np

from machine import Bar, Figures, at_least, bench
from retrieval_media import field_of
from touchfield.codec.paper.field_quantiser import FieldQuantiserSpec
from touchfield.measure import FewSamplesWarning, FieldSymbols, similarity
from touchfield.measure.descriptors import descriptor
from touchfield.measure.retrieval import distance
from touchfield.medium import ForceField

QUANTISER = "weber:0.25/ico1"
CHANGES = ("shift", "noise", "rotation", "coder", "all combined")
MEASURES = ("NMI", "VI", "sqrt(JSD)", "NCD")


def symbol_distances(first: FieldSymbols, second: FieldSymbols) -> list[float]:
    """Return the distance of two media by each of `MEASURES`."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FewSamplesWarning)  # a ranking needs no interval
        found = similarity(first, second, "object", interval=False)
    assert found.compression is not None
    return [
        -float(found.normalised),
        float(found.variation),
        float(found.jensen_shannon),
        float(found.compression),
    ]


def top_1(distances: list[list[float]]) -> float:
    """Return the fraction of rows whose smallest distance is on the diagonal."""
    return float(np.mean(np.argmin(distances, axis=1) == np.arange(len(distances))))


def row(originals: list[ForceField], changed: list[ForceField]) -> dict[str, float]:
    """Return the fraction found by each measure."""
    quantise = FieldQuantiserSpec.parse(QUANTISER).fit([*originals, *changed])
    symbols, queries = ([quantise(field) for field in fields] for fields in (originals, changed))
    of_symbols = np.array([[symbol_distances(query, other) for other in symbols] for query in queries])
    found = {name: top_1(of_symbols[..., n].tolist()) for n, name in enumerate(MEASURES)}
    described, query_entries = ([descriptor(field) for field in fields] for fields in (originals, changed))
    counts, query_counts = ([field.support_count for field in fields] for fields in (originals, changed))
    return {
        **found,
        "descriptor": top_1([[distance(query, other) for other in described] for query in query_entries]),
        "voxel count": top_1([[abs(query - other) for other in counts] for query in query_counts]),
        "random": 1 / len(originals),
    }


def measure(media: int) -> Figures:
    """Measure every change."""
    originals = [field_of(seed, "original") for seed in range(media)]
    rows = {}
    for change in CHANGES:
        rows[change] = row(originals, [field_of(seed, change) for seed in range(media)])
        print(change, rows[change], flush=True)
    return {"media": media, "top-1": rows}


def bars(figures: Figures) -> list[Bar]:
    """Require the descriptor for every change, and the voxels for noise and coding."""
    rows = figures["top-1"]
    return [
        at_least("descriptor: top-1, worst", min(row["descriptor"] for row in rows.values()), 0.9),
        at_least("NMI after noise and coder: top-1", min(rows[c]["NMI"] for c in ("noise", "coder")), 0.9),
    ]


if __name__ == "__main__":
    bench("similar", __doc__, measure, bars, media=(16, 4))
