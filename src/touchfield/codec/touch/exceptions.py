"""Voxels that a frame model left beyond the promise, sent apart: float32, exactly as they were.

Departure from the paper, which has no escape: single voxels in 10^5 would break the mask by accumulated rounding.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from touchfield.codec.varint import read_varint, write_varint
from touchfield.errors import CorruptFile, TruncatedFile
from touchfield.medium import ForceField, Grid
from touchfield.medium.budget import zero_forces
from touchfield.medium.field import brick_keys

_WHERE: Final = "SEGM.body exceptions"
_SAMPLES: Final = 512
_VECTOR: Final = 12


@dataclass(frozen=True)
class Exceptions:
    """Forces that replace decoded ones."""

    keys: NDArray[np.int64]  # [m]; of the bricks
    places: NDArray[np.int64]  # [m]; samples in them, 0 to 511; (key, place) ascends
    forces_n: NDArray[np.float32]  # [m, 3]; newtons, to the bit

    @classmethod
    def of(cls, original: ForceField, keys: NDArray[np.int64], places: NDArray[np.int64]) -> Exceptions:
        """The forces of a field at some voxels, in any order and perhaps named twice."""
        pairs = np.unique(np.stack([keys, places], axis=1), axis=0)
        bricks, slot = np.unique(pairs[:, 0], return_inverse=True)
        forces = original.forces_at(bricks).reshape(-1, _SAMPLES, 3)[slot.reshape(-1), pairs[:, 1]]
        return cls(pairs[:, 0], pairs[:, 1], forces)

    def __len__(self) -> int:
        return len(self.keys)

    def to_bytes(self) -> bytes:
        """The chunk (docs/format/touch.md, "Exceptions")."""
        parts, before = [], 0
        bits = np.ascontiguousarray(self.forces_n).view(np.int32)
        vectors = np.ascontiguousarray(self.forces_n, "<f4")
        for i, (key, place) in enumerate(zip(self.keys.tolist(), self.places.tolist(), strict=True)):
            none = not bits[i].any()
            parts += [
                write_varint(key - before),
                write_varint(2 * place + none),
                b"" if none else vectors[i].tobytes(),
            ]
            before = key
        return b"".join(parts)

    @classmethod
    def from_bytes(cls, data: bytes, grid: Grid) -> Exceptions:
        """The inverse of `to_bytes`; CorruptFile or TruncatedFile where the bytes are not what it writes."""
        keys: list[int] = []
        places: list[int] = []
        forces: list[bytes] = []
        at, key, place = 0, 0, -1
        limit = math.prod(grid.brick_shape)
        while at < len(data):
            gap, at = read_varint(data, at, f"{_WHERE}, brick", limit - key)
            coded, at = read_varint(data, at, f"{_WHERE}, sample", 2 * _SAMPLES)
            if keys and gap == 0 and coded >> 1 <= place:
                raise CorruptFile(_WHERE, f"sample {coded >> 1} after sample {place}", "ascending samples")
            key, place = key + gap, coded >> 1
            vector = bytes(_VECTOR)
            if not coded & 1:
                vector = data[at : at + _VECTOR]
                if len(vector) < _VECTOR:
                    raise TruncatedFile(_WHERE, f"{len(vector)} bytes", f"{_VECTOR} bytes of a force")
                at += _VECTOR
            keys.append(key)
            places.append(place)
            forces.append(vector)
        vectors = np.frombuffer(b"".join(forces), "<f4").astype(np.float32).reshape(-1, 3)
        if not np.isfinite(vectors).all():
            raise CorruptFile(_WHERE, "a force that is not finite", "finite newtons")
        made = cls(np.array(keys, np.int64), np.array(places, np.int64), vectors)
        made._check_inside(grid)
        return made

    def _check_inside(self, grid: Grid) -> None:
        bricks = np.stack(np.unravel_index(self.keys, grid.brick_shape), axis=-1)
        local = np.stack(np.unravel_index(self.places, (8, 8, 8)), axis=-1)
        if len(self) and ((8 * bricks + local) >= np.asarray(grid.shape)).any():
            raise CorruptFile(_WHERE, "a sample beyond the grid", f"samples below {grid.shape}")

    def applied(self, field: ForceField) -> ForceField:
        """A field with these forces in place of its own; bricks without any force are left out."""
        if not len(self):
            return field
        keys = np.union1d(brick_keys(field.grid, field.bricks), self.keys)
        bricks = np.stack(np.unravel_index(keys, field.grid.brick_shape), axis=-1).astype(np.int32)
        own = np.searchsorted(keys, brick_keys(field.grid, field.bricks))
        forces = zero_forces(len(keys))
        forces[own] = field.forces_n
        forces.reshape(-1, _SAMPLES, 3)[np.searchsorted(keys, self.keys), self.places] = self.forces_n
        held = forces.any(axis=(1, 2, 3, 4))
        return ForceField(field.grid, bricks[held], forces[held])
