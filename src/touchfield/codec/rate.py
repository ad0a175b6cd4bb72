"""Costs of a stream: compression ratios (paper eq. 9) and where the bits go.

Eq. 9, literal: CR = (C_a + C_d) / (m V 96) with C_a, C_d the lengths in bits of the coded amplitudes and
directions (the paper calls them vectors), m frames, V voxels of the device lattice, 96 bits a vector. It omits
the support, the code tables and the headers; CR full counts every bit of the file.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

RAW_BITS_PER_VECTOR = 96  # three float32 components (paper table 1, "raw storage per sample")


@dataclass(frozen=True)
class BitAccount:
    """Bits by what they tell."""

    support: int = 0  # where the force is not zero
    amplitude: int = 0  # C_a: amplitudes, with what says which samples are held
    direction: int = 0  # C_d
    side: int = 0  # code tables, lengths, headers, checksums, index, provenance
    poses: int = 0  # poses of objects (`touchfield.codec.objects`)
    models: int = 0  # what a frame is predicted from: a surface, moved blocks (`touchfield.codec.touch`)

    @property
    def total(self) -> int:
        """All bits."""
        return sum(getattr(self, f.name) for f in fields(self))

    def __add__(self, other: BitAccount) -> BitAccount:
        return BitAccount(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(self)))


def compression_ratio(bits: float, frame_count: int, voxel_count: int) -> float:
    """Bits over the raw bits of the device-filtered lattice (eq. 9's denominator); lower is better."""
    return bits / (frame_count * voxel_count * RAW_BITS_PER_VECTOR)
