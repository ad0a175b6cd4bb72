"""Spectral coding of a field, brick by brick: the 5/3 wavelet and the DCT (paper section 4.3 and figure 4).

The paper names spectral coding and no transform. The wavelet is LeGall's 5/3 by whole-number lifting, as in JPEG
2000 (ISO/IEC 15444-1, annex F), in three axes: it comes back to the bit. It serves bricks and whole volumes. The DCT
is the orthonormal one (type 2) on bricks of 8x8x8, its coefficients quantised.

Where the support ends, a brick would have an edge that costs many coefficients; the support is known to the decoder,
so what lies outside is free, and the encoder fills it smoothly.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Final

import numpy as np

from touchfield.codec.field_stage import FieldStage, StepStage, lattice_points, newtons, step_from_bytes
from touchfield.codec.stage import Claim
from touchfield.errors import CorruptFile, InvalidArgument
from touchfield.medium.grid import BRICK

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.medium import ForceField

    Int32s = NDArray[np.int32]
    Float32s = NDArray[np.float32]
    Float64s = NDArray[np.float64]
    Mask = NDArray[np.bool_]

__all__ = ["DctSpec", "DctStage", "WaveletSpec", "WaveletStage", "filled", "wavelet_forward", "wavelet_inverse"]

_PASSES: Final = 4
_LEVELS = 3  # of a brick's eight samples


# -- the 5/3 wavelet --------------------------------------------------------------------------------------


def wavelet_forward(values: Int32s, levels: int, axes: tuple[int, ...] = (0, 1, 2)) -> Int32s:
    """The 5/3 wavelet of whole numbers, each level on what was coarse in all axes.

    Parameters
    ----------
    values : int32 [...]
        Of any sizes; within 2^29, so that no coefficient overflows.
    levels : int
        0 or more; a level leaves an axis of one sample as it is.
    axes : tuple of int

    Returns
    -------
    int32 [...]
        Coarse first, then detail, along each axis.
    """
    out = np.array(values, np.int32)
    for level in range(levels):
        part = out[_corner(out.shape, level, axes)]
        for axis in axes:
            part[...] = _split(part, axis)
    return out


def wavelet_inverse(coefficients: Int32s, levels: int, axes: tuple[int, ...] = (0, 1, 2)) -> Int32s:
    """The inverse of `wavelet_forward`, exact."""
    out = np.array(coefficients, np.int32)
    for level in reversed(range(levels)):
        part = out[_corner(out.shape, level, axes)]
        for axis in reversed(axes):
            part[...] = _joined(part, axis)
    return out


def _corner(shape: tuple[int, ...], level: int, axes: tuple[int, ...]) -> tuple[slice, ...]:
    sizes = [-(-n >> level) if i in axes else n for i, n in enumerate(shape)]  # -(-n >> l): rounded up
    return tuple(slice(0, n) for n in sizes)


def _split(values: Int32s, axis: int) -> Int32s:
    x = np.moveaxis(values, axis, 0)
    even, odd = x[0::2], x[1::2]
    if not len(odd):
        return values
    after = np.concatenate([even[1:], even[-1:]])[: len(odd)]
    detail = odd - ((even[: len(odd)] + after) >> 1)
    return np.moveaxis(np.concatenate([even + _update(detail, len(even)), detail]), 0, axis)


def _joined(values: Int32s, axis: int) -> Int32s:
    x = np.moveaxis(values, axis, 0)
    count = (len(x) + 1) // 2
    coarse, detail = x[:count], x[count:]
    if not len(detail):
        return values
    even = coarse - _update(detail, count)
    after = np.concatenate([even[1:], even[-1:]])[: len(detail)]
    out = np.empty_like(x)
    out[0::2] = even
    out[1::2] = detail + ((even[: len(detail)] + after) >> 1)
    return np.moveaxis(out, 0, axis)


def _update(detail: Int32s, count: int) -> Int32s:
    """A quarter of the details on both sides; the border mirrors them."""
    left = np.concatenate([detail[:1], detail])[:count]
    right = np.concatenate([detail, detail[-1:]])[:count]
    update: Int32s = (left + right + 2) >> 2
    return update


# -- what both stages share -------------------------------------------------------------------------------


def filled(forces_n: Float32s, mask: Mask) -> Float64s:
    """Forces [n, 8, 8, 8, 3] with what the mask leaves out filled: the brick's mean, then means of neighbours."""
    held = mask[..., None]
    counts = np.maximum(mask.sum(axis=(1, 2, 3)), 1)
    x = forces_n.astype(np.float64)
    mean = x.sum(axis=(1, 2, 3), where=held) / counts[:, None]
    x = np.where(held, x, mean[:, None, None, None, :])
    for _ in range(_PASSES):
        padded = np.pad(x, ((0, 0), (1, 1), (1, 1), (1, 1), (0, 0)), mode="edge")
        around = padded[:, :-2, 1:-1, 1:-1] + padded[:, 2:, 1:-1, 1:-1] + padded[:, 1:-1, :-2, 1:-1]
        around += padded[:, 1:-1, 2:, 1:-1] + padded[:, 1:-1, 1:-1, :-2] + padded[:, 1:-1, 1:-1, 2:]
        x = np.where(held, x, around / 6)
    return x


def _order(key: NDArray[np.int64]) -> NDArray[np.int64]:
    """The 512 places of a brick, low frequencies first."""
    return np.argsort(key.reshape(-1), kind="stable")


def _frequencies() -> NDArray[np.int64]:
    total: NDArray[np.int64] = np.indices((BRICK,) * 3).sum(axis=0)
    return total


def _bands() -> NDArray[np.int64]:
    """The places of a wavelet's level-by-level bands: all of one band are neighbours."""
    level = np.array([0, 1, 2, 2, 3, 3, 3, 3])
    x, y, z = (level[i] for i in np.indices((BRICK,) * 3))
    top = np.maximum(np.maximum(x, y), z)
    band: NDArray[np.int64] = top * 8 + (x == top) * 4 + (y == top) * 2 + (z == top)
    return band


def _by_frequency(coefficients: NDArray[np.integer], order: NDArray[np.int64]) -> Int32s:
    """Coefficients [n, 8, 8, 8, 3] as a list: by component, by frequency, by brick."""
    listed = coefficients.reshape(len(coefficients), BRICK**3, 3)[:, order]
    return listed.transpose(2, 1, 0).reshape(-1).astype(np.int32)


def _by_brick(numbers: Int32s, order: NDArray[np.int64], count: int) -> Int32s:
    listed = numbers.reshape(3, BRICK**3, count).transpose(2, 1, 0)
    out = np.empty_like(listed)
    out[:, order] = listed
    return out.reshape(count, BRICK, BRICK, BRICK, 3)


@dataclass(frozen=True)
class WaveletSpec:
    """The wavelet as asked for.

    Parameters
    ----------
    step_n : float
        Step of the forces before the transform, newtons.
    """

    step_n: float

    def fit(self, field: ForceField) -> WaveletStage:
        """Nothing is fitted."""
        return WaveletStage(self.step_n)


@dataclass(frozen=True)
class WaveletStage(StepStage):
    """Quantised forces by the 5/3 wavelet, three levels on each brick."""

    kind: ClassVar[int] = 4

    def encode(self, field: ForceField) -> Int32s:
        """Coefficients by component, band and brick."""
        points = lattice_points(filled(field.forces_n, field.mask), self.step_n).astype(np.int32)
        return _by_frequency(wavelet_forward(points, _LEVELS, (1, 2, 3)), _order(_bands()))

    def count(self, bricks: Int32s, mask: Mask) -> int | None:
        """All samples of all bricks."""
        return 3 * BRICK**3 * len(bricks)

    def decode(self, numbers: Int32s, bricks: Int32s, mask: Mask) -> Float32s:
        """See `FieldStage`."""
        coefficients = _by_brick(numbers, _order(_bands()), len(bricks))
        return newtons(wavelet_inverse(coefficients, _LEVELS, (1, 2, 3)), self.step_n)


# -- the DCT ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class DctSpec:
    """The DCT as asked for.

    Parameters
    ----------
    step_n : float
        Step of the coefficients, newtons.
    dead : float
        Rounding: a coefficient below 1 - `dead` steps is none; 0.5 rounds to the nearest, less saves bits.
    """

    step_n: float
    dead: float = 1 / 3

    def __post_init__(self) -> None:
        if not 0 <= self.dead <= 0.5:
            raise InvalidArgument("dead", repr(self.dead), "0 to 0.5 of a step")

    def fit(self, field: ForceField) -> DctStage:
        """Nothing is fitted."""
        return DctStage(self.step_n, self.dead)


@dataclass(frozen=True)
class DctStage:
    """Forces by the orthonormal DCT on bricks; the coefficients are quantised.

    Attributes
    ----------
    step_n : float
        Step of the coefficients, newtons.
    dead : float
        Added before coefficients are cut to whole steps; the decoder does without it.
    """

    step_n: float
    dead: float
    kind: ClassVar[int] = 5

    @property
    def claim(self) -> Claim:
        """All 512 coefficients of a brick off by the most: an orthonormal transform keeps the sum of squares."""
        return Claim("absolute", max(self.dead, 1 - self.dead) * self.step_n * BRICK**1.5)

    def encode(self, field: ForceField) -> Int32s:
        """Coefficients by component, frequency and brick."""
        from scipy.fft import dctn

        spectrum = dctn(filled(field.forces_n, field.mask), axes=(1, 2, 3), norm="ortho")
        lattice_points(spectrum, self.step_n)  # refuses a step that is too fine
        points = np.sign(spectrum) * np.floor(np.abs(spectrum) / self.step_n + self.dead)
        return _by_frequency(points.astype(np.int64), _order(_frequencies()))

    def count(self, bricks: Int32s, mask: Mask) -> int | None:
        """All samples of all bricks."""
        return 3 * BRICK**3 * len(bricks)

    def decode(self, numbers: Int32s, bricks: Int32s, mask: Mask) -> Float32s:
        """See `FieldStage`; equal to the bit only where the same FFT is at work."""
        from scipy.fft import idctn

        coefficients = _by_brick(numbers, _order(_frequencies()), len(bricks))
        with np.errstate(over="ignore", invalid="ignore"):
            forces = idctn(coefficients * self.step_n, axes=(1, 2, 3), norm="ortho")
            return np.asarray(forces, np.float32)

    def to_bytes(self) -> bytes:
        """Step and rounding."""
        return struct.pack("<dd", self.step_n, self.dead)

    @classmethod
    def from_bytes(cls, data: bytes) -> FieldStage:
        """The inverse of `to_bytes`."""
        step_n, dead = step_from_bytes(data, "<dd")
        if not 0 <= dead <= 0.5:
            raise CorruptFile("DCT rounding", f"{dead}", "0 to 0.5 of a step")
        return cls(step_n, dead)
