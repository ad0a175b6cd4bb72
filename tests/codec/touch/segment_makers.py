"""What the tests of the segment layer share: a frame model that is as plain as can be, and fields of every kind."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

import numpy as np
from touchfield.codec.touch.frame_model import CodedFrame, Known, Rule

from touchfield.codec.touch.fixed_field import FixedField
from touchfield.errors import CorruptFile
from touchfield.medium import ForceField, Grid
from touchfield.medium.field import brick_keys

__all__ = ["GRID", "KINDS", "PlainModel", "Shifted", "at", "field_of"]

GRID = Grid((20, 17, 13), (0.001, 0.002, 0.0015), (0.0, 0.01, -0.02))


def at(field: FixedField | None, grid: Grid, bricks: np.ndarray) -> np.ndarray:
    """The vectors of a known field at some bricks."""
    vectors = np.zeros((len(bricks), 8, 8, 8, 3), np.int32)
    if field is not None and len(field.bricks):
        own, keys = brick_keys(grid, field.bricks), brick_keys(grid, bricks)
        slot = np.minimum(np.searchsorted(own, keys), len(own) - 1)
        held = own[slot] == keys
        vectors[held] = field.vectors[slot[held]]
    return vectors


@dataclass(frozen=True)
class PlainModel:
    """Each component rounded to the step of the lattice, less what is known, through zlib.

    It does not report its misses where it is not `honest`: the caller must find them.
    """

    number: int = 0
    honest: bool = True

    def encode(self, frame: ForceField, known: Known, rule: Rule) -> CodedFrame:
        lattice = known.lattice
        exact = frame.forces_n.astype(np.float64) / lattice.unit_n
        size = np.sqrt((exact**2).sum(-1))
        step = np.maximum(1, np.minimum(1 << 16, np.maximum(lattice.floor, lattice.rate / 65536 * size)).astype(int))
        vectors = (np.rint(exact / step[..., None]) * step[..., None]).clip(-(1 << 17) + 1, (1 << 17) - 1)
        if not rule.movable:
            lost = (exact != 0).any(-1) & ~vectors.any(-1)
            vectors[lost] = np.sign(exact[lost])
        decoded = FixedField(np.array(frame.bricks), vectors.astype(np.int32))
        difference = decoded.vectors - self._known(known, decoded.bricks)
        payload = struct.pack("<I", len(frame.bricks)) + zlib.compress(
            decoded.bricks.astype("<i4").tobytes() + difference.astype("<i4").tobytes()
        )
        misses = np.zeros(0, np.int64)
        if self.honest and not rule.free and rule.sine == 0:
            error = np.sqrt(((vectors - exact) ** 2).sum(-1))
            beyond = error > np.maximum(rule.f0_n / lattice.unit_n, rule.k * size)
            misses = np.flatnonzero(beyond.reshape(-1))
        return CodedFrame(payload, decoded, (1.0, 2.0, 3.0), misses)

    def decode(self, payload: bytes, known: Known) -> FixedField:
        try:
            (count,) = struct.unpack_from("<I", payload)
            size = 12 * count * 513
            if count > len(payload):
                raise ValueError
            data = zlib.decompressobj().decompress(payload[4:], size + 1)
            bricks = np.frombuffer(data, "<i4", 3 * count).reshape(-1, 3).astype(np.int32)
            vectors = np.frombuffer(data, "<i4", 1536 * count, 12 * count).reshape(-1, 8, 8, 8, 3)
            ForceField(known.grid, bricks, np.ones(vectors.shape, np.float32))
            if len(data) != size or np.abs(vectors.astype(np.int64)).max(initial=0) > 1 << 18:
                raise ValueError
        except (struct.error, zlib.error, ValueError) as error:
            raise CorruptFile("payload", str(error)) from None
        return FixedField(bricks, vectors.astype(np.int32) + self._known(known, bricks))

    @staticmethod
    def _known(known: Known, bricks: np.ndarray) -> np.ndarray:
        return at(known.previous if known.guess is None else known.guess, known.grid, bricks)


class Shifted:
    """A guess provider whose guess is the previous frame itself, told in three bytes."""

    @staticmethod
    def find(frame: ForceField, known: Known) -> tuple[bytes, FixedField] | None:
        return None if known.previous is None else (b"sam", known.previous)

    @staticmethod
    def replay(data: bytes, known: Known) -> FixedField:
        if data != b"sam" or known.previous is None:
            raise CorruptFile("guess", repr(data))
        return known.previous


def field_of(kind: str, seed: int, grid: Grid = GRID) -> ForceField:
    """A random field."""
    rng = np.random.default_rng(seed)
    f = np.zeros((*grid.shape, 3), np.float32)
    if kind == "sparse":
        where = rng.random(grid.shape) < 0.02
        f[where] = rng.normal(0, 1, (int(where.sum()), 3))
    elif kind == "dense":
        x, y, z = np.meshgrid(*(np.arange(n) for n in grid.shape), indexing="ij")
        f[:] = np.stack([np.sin(x / 5 + seed), np.cos(y / 4), 1 + z / 9], -1)
    elif kind == "constant":
        f[:] = rng.normal(0, 1, 3)
    elif kind == "noise":
        f[:] = rng.normal(0, 0.1, f.shape)
    elif kind == "one":
        f[tuple(rng.integers(0, grid.shape))] = rng.normal(0, 1, 3)
    elif kind == "denormal":
        f[rng.random(grid.shape) < 0.03] = (rng.normal(0, 1, 3) * 1e-40).astype(np.float32)
    elif kind == "threshold":  # |F| at F_0 and its neighbours among the float32
        where = rng.random(grid.shape) < 0.05
        f[where, 2] = np.float32(0.05) + np.float32(2.0**-28) * rng.integers(-3, 4, int(where.sum()))
        f[3, 3, 3] = 2.0
    elif kind == "huge":
        where = rng.random(grid.shape) < 0.03
        size = 10 ** rng.uniform(-30, 30, (int(where.sum()), 1))
        f[where] = (rng.normal(0, 1, (int(where.sum()), 3)) * size).astype(np.float32)
    elif kind != "empty":
        raise ValueError(kind)
    return ForceField.from_dense(grid, f)


KINDS = ("empty", "sparse", "dense", "constant", "noise", "one", "denormal", "threshold", "huge")
