"""Finds the media whose descriptors are nearest to that of a given medium, in an index that is stored in a
file (paper sections 4 and 5.1).

The paper names "search and retrieval" without a method. A medium is indexed by its descriptor
(`touchfield.measure.descriptors`); a query is another descriptor, and the result lists the names by
distance::

    d(x, y)^2 = sum over the parts p of weight_p |x_p - y_p|^2

which is a metric between descriptors. The default weights (`WEIGHTS`) let the shells decide, so that a body
is found whichever way it is turned and whatever its size (`bench/bench_retrieval.py`); the other parts
separate media of like shape. The search is exact, one pass over all entries. In 125 dimensions a k-d tree
would visit nearly every entry, too, and building it takes longer than the few queries of a command.
"""

from __future__ import annotations

import json
import math
import zipfile
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import numpy as np

from touchfield.arrays import Float64s
from touchfield.atomic import atomic_path
from touchfield.errors import (
    InvalidArgument,
    SourceError,
    as_source_error,
    require_not_negative,
    require_one_of,
)
from touchfield.measure.descriptors import (
    DESCRIPTOR_LENGTH,
    DESCRIPTOR_VERSION,
    PARTS,
    Descriptor,
    part_slots,
)
from touchfield.medium.stores.npz import NpzArchive

WEIGHTS: Final[Mapping[str, float]] = MappingProxyType({"shells": 160.0})
"""Default weights of the parts; 1 for those that are not named.

The shells of two bodies differ by about a tenth of what their histograms do. With this weight they outweigh
a rotation, which changes the directions and the octree levels, and the other parts still decide between media
of one shape. Chosen on 150 solids that `bench/bench_retrieval.py` does not use.
"""

ANY_POSE: Final[Mapping[str, float]] = MappingProxyType(
    {"directions": 0.0, "support": 0.0, "level_entropy": 0.0}
)
"""Weights that omit the parts that depend on the pose: the directions and, less, the octree levels."""

MAX_MEDIA: Final = 1 << 20
_MAX_NAME: Final = 1000  # characters
_BLOCK: Final = 1 << 11  # number of media whose distances are computed at once, so that they stay in a cache
_MAX_HEAD_BYTES: Final = 1 << 28
_FORMAT: Final = "touchfield medium index"


class OutdatedIndex(SourceError):
    """An index file has descriptors of another version."""


class Match(NamedTuple):
    """A found medium and its distance from the query; 0 for equal descriptors."""

    name: str
    distance: float


class MediumIndex:
    """Index of descriptors by name, with nearest-neighbour search; see the module."""

    def __init__(self) -> None:
        self._rows: dict[str, Float64s] = {}
        # [media, DESCRIPTOR_LENGTH]; None until the rows are stacked
        self._values: Float64s | None = None

    def __len__(self) -> int:
        return len(self._rows)

    def __contains__(self, name: object) -> bool:
        return name in self._rows

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the media, in the order in which they were added."""
        return tuple(self._rows)

    def __getitem__(self, name: str) -> Descriptor:
        """The descriptor of a medium."""
        if name not in self._rows:
            raise InvalidArgument("name", repr(name), "a medium of the index")
        return Descriptor(self._rows[name])

    def add(self, name: str, entry: Descriptor) -> None:
        """Add a medium under a new name of 1 to 1000 characters.

        InvalidArgument if the name is empty, too long or in use, or the index is full (2^20 media).
        """
        if not isinstance(name, str) or not 1 <= len(name) <= _MAX_NAME:
            raise InvalidArgument("name", repr(name)[:80], f"1 to {_MAX_NAME} characters")
        if name in self._rows:
            raise InvalidArgument("name", repr(name)[:80], "a name that is not there yet")
        if len(self._rows) >= MAX_MEDIA:
            raise InvalidArgument("index", f"{len(self._rows)} media", f"fewer than {MAX_MEDIA}")
        self._rows[name] = entry.values
        self._values = None

    def query(
        self, entry: Descriptor, count: int | None = None, weights: Mapping[str, float] | None = None
    ) -> tuple[Match, ...]:
        """Return the media nearest to a descriptor, the nearest first.

        Ties are in the order of addition. `count`: the number of matches; by default all. `weights`: weight
        of each part by name, 0 or more, as in `ANY_POSE`; those of `WEIGHTS` for parts that are not named.
        InvalidArgument if the index is empty, `count` is below 1, or a weight is out of range or of an
        unknown part.
        """
        if not self._rows:
            raise InvalidArgument("index", "no medium", "at least one", "Add some first.")
        if count is not None and count < 1:
            raise InvalidArgument("count", f"{count}", "1 or more")
        factors = _factors(weights or {})
        if self._values is None:
            self._values = np.stack(list(self._rows.values()))
        distances = np.empty(len(self))
        for start in range(0, len(self), _BLOCK):
            differences = (self._values[start : start + _BLOCK] - entry.values) * factors
            distances[start : start + _BLOCK] = np.sqrt(np.einsum("ij,ij->i", differences, differences))
        names = self.names
        return tuple(
            Match(names[i], float(distances[i])) for i in np.argsort(distances, kind="stable")[:count]
        )

    def save(self, path: str | Path) -> None:
        """Write the index as ``.npz``; equal indices give equal bytes.

        The file is written completely or not at all. InvalidArgument if the folder does not exist.
        SourceError if the system refuses to write.
        """
        parts, names = dict(PARTS), list(self._rows)
        head = {"format": _FORMAT, "descriptor_version": DESCRIPTOR_VERSION, "parts": parts, "names": names}
        arrays = {
            "head": np.frombuffer(json.dumps(head).encode(), np.uint8),
            "values": np.array(list(self._rows.values()), "<f8").reshape(len(self), DESCRIPTOR_LENGTH),
        }
        with atomic_path(Path(path)) as temporary, zipfile.ZipFile(temporary, "w") as archive:
            for name, array in arrays.items():
                with archive.open(zipfile.ZipInfo(f"{name}.npy"), "w", force_zip64=True) as stream:
                    np.lib.format.write_array(stream, array, version=(1, 0), allow_pickle=False)

    @classmethod
    def load(cls, path: str | Path) -> MediumIndex:
        """Read an index that `save` wrote.

        SourceError if the file is no such index, or is truncated or damaged; OutdatedIndex if it was written
        for another version of the descriptor.
        """
        archive = NpzArchive(Path(path))
        names = _names(archive)
        where = f"{path}, array values"
        header = archive.header("values")
        if header.dtype != np.dtype("<f8") or header.shape != (len(names), DESCRIPTOR_LENGTH):
            found = f"{header.dtype} {list(header.shape)}"
            raise SourceError(where, found, f"float64 [{len(names)}, {DESCRIPTOR_LENGTH}]")
        index = cls()
        for name, row in zip(names, archive.read("values"), strict=True):
            with as_source_error(f"{path}, "):
                index.add(name, Descriptor(row))
        return index


def _names(archive: NpzArchive) -> list[str]:
    """Return the names of an index file, after checking its head."""
    where = f"{archive.path}, array head"
    header = archive.header("head")
    if header.dtype != np.uint8 or len(header.shape) != 1 or header.data_bytes > _MAX_HEAD_BYTES:
        raise SourceError(where, f"{header.dtype} {list(header.shape)}", "the head of a medium index")
    try:
        head: Any = json.loads(archive.read("head").tobytes())
        kind, version, parts, names = (head[k] for k in ("format", "descriptor_version", "parts", "names"))
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise SourceError(
            where, f"text that cannot be read ({error})", "the head of a medium index"
        ) from None
    if kind != _FORMAT or not isinstance(names, list):
        raise SourceError(where, f"{str(kind)[:80]!r}", repr(_FORMAT))
    if version != DESCRIPTOR_VERSION:
        found = f"descriptors of version {str(version)[:20]}"
        raise OutdatedIndex(
            str(archive.path), found, f"version {DESCRIPTOR_VERSION}", "Make it anew: touchfield index FOLDER"
        )
    if parts != dict(PARTS):
        raise SourceError(where, f"descriptors of {str(parts)[:200]}", f"{dict(PARTS)}")
    return names


def part_distances(first: Descriptor, second: Descriptor) -> dict[str, float]:
    """Return the Euclidean distance of two descriptors in each part, without weights."""
    return {name: float(np.linalg.norm(first[name] - second[name])) for name in PARTS}


def distance(first: Descriptor, second: Descriptor, weights: Mapping[str, float] | None = None) -> float:
    """Return the distance by which `MediumIndex.query` ranks, with the same weights."""
    return float(np.linalg.norm((first.values - second.values) * _factors(weights or {})))


def _factors(weights: Mapping[str, float]) -> Float64s:
    """The square root of each number's weight, float64 [DESCRIPTOR_LENGTH]."""
    for name in weights:
        require_one_of("weights", name, PARTS)
    factors = np.ones(DESCRIPTOR_LENGTH)
    for name, slot in part_slots():
        weight = float(weights.get(name, WEIGHTS.get(name, 1.0)))
        require_not_negative(**{f"weight of {name}": weight})
        factors[slot] = math.sqrt(weight)
    if not factors.any():
        raise InvalidArgument("weights", "0 for every part", "a positive weight for at least one")
    return factors
