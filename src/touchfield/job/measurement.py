"""What was measured of a medium, for people, programs and eyes (paper sections 3 and 3.1, equations 1 to 3)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from touchfield.codec.rate import RAW_BITS_PER_VECTOR
from touchfield.measure.estimators import binary_entropy_bits

if TYPE_CHECKING:
    from touchfield.measure.capacity import Capacity
    from touchfield.measure.limits import CodingLimits
    from touchfield.measure.passivity import Passivity
    from touchfield.measure.quantity import Quantity
    from touchfield.viewer.information import Bar

__all__ = ["Measurement"]


@dataclass(frozen=True)
class Measurement:
    """What `measure` found.

    Attributes
    ----------
    name : str
        The medium's.
    quantiser : str
        Q in words.
    alphabet : int
        K, its symbols with "no force".
    frames, voxels, supported_voxels : int
        Frames; voxels of one frame; supported voxels of all frames, after Q.
    entropy : Quantity
        H(S) over the weighting that was asked for.
    voxel, object : Quantity
        H(S) over all voxels, and over the object alone; of the plug-in estimates
        H_voxel = h2(p) + p H_object holds exactly.
    corrected : Quantity
        `voxel` with the correction of Miller and Madow: how far the estimate may be trusted at all.
    per_frame : Quantity
        H(W): H_voxel times the voxels of a frame.
    in_time : dict of str to Quantity
        Between a frame and the next, over voxels: H(S_t | S_t-1), I(S_t; S_t-1), normalised, and the variation of
        information; empty for one frame.
    limits : CodingLimits or None
    capacities : dict of str to Capacity
        By device.
    passivity : Passivity or None
        Of the frame with the largest support.
    file_bits : int or None
        All bits of the ``.touch`` file that was measured.
    notes : tuple of str
    """

    name: str
    quantiser: str
    alphabet: int
    frames: int
    voxels: int
    supported_voxels: int
    entropy: Quantity
    voxel: Quantity
    object: Quantity
    corrected: Quantity
    per_frame: Quantity
    in_time: dict[str, Quantity]
    limits: CodingLimits | None
    capacities: dict[str, Capacity]
    passivity: Passivity | None
    file_bits: int | None
    notes: tuple[str, ...]

    @cached_property
    def occupancy(self) -> float:
        """p, the share of voxels whose quantised force is not zero."""
        return self.supported_voxels / (self.frames * self.voxels)

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        return {
            "medium": self.name,
            "quantiser": self.quantiser,
            "alphabet": self.alphabet,
            "frames": self.frames,
            "voxels_per_frame": self.voxels,
            "supported_voxels": self.supported_voxels,
            "occupancy": self.occupancy,
            "occupancy_entropy_bits": binary_entropy_bits(self.occupancy),
            "entropy": self.entropy.summary(),
            "entropy_voxel": self.voxel.summary(),
            "entropy_object": self.object.summary(),
            "entropy_voxel_miller_madow": self.corrected.summary(),
            "entropy_frame": self.per_frame.summary(),
            "in_time": {name: q.summary() for name, q in self.in_time.items()},
            "coding_limits": None if self.limits is None else self.limits.summary(),
            "capacity": {name: c.summary() for name, c in self.capacities.items()},
            "passivity": None if self.passivity is None else self.passivity.summary(),
            "file_bits": self.file_bits,
        }

    def draw(self, path: str | Path) -> None:
        """Write the picture, PNG: the bits of the medium beside the limits of coding it, and each device's share."""
        from touchfield.viewer.information import DeviceBars, InformationView, draw_information

        devices = [
            DeviceBars(
                name, c.capacity.value, c.wmr.value, c.hil.value, _ends(c.wmr) if c.rendered.interval else None
            )
            for name, c in self.capacities.items()
        ]
        title = (
            f"{self.name}: {self.frames} frame{'s' * (self.frames > 1)} of {self.voxels:,} voxels, "
            f"{self.occupancy:.2%} with a force; Q {self.quantiser}, H(W) = {self.per_frame.value:,.0f} bit/frame"
        )
        draw_information(Path(path), InformationView(title, "bits per supported voxel", self._bars(), devices))

    def _bars(self) -> list[Bar]:
        """What a supported voxel costs, from raw numbers to the best limit; telling where it is included."""
        from touchfield.viewer.information import Bar

        each = self.frames * self.voxels / self.supported_voxels
        low_high = _ends(self.voxel)
        ends = low_high and (low_high[0] * each, low_high[1] * each)
        shown = [
            Bar("three float32 numbers", float(RAW_BITS_PER_VECTOR)),
            Bar("H(S) over voxels: no neighbours", self.voxel.value * each, ends),
        ]
        if self.limits is not None:
            for c in self.limits.contexts:
                if c.per_voxel.value > 0 and not c.is_diluted:
                    shown.append(Bar(c.per_voxel.name, c.per_voxel.value * each))
            what = "prequential code" + (" of the symbols" if self.quantiser == "distinct" else ": surely reached")
            shown.append(Bar(what, self.limits.prequential.per_supported.value))
        if self.file_bits is not None:
            shown.append(Bar("this file, everything counted", self.file_bits / self.supported_voxels, is_actual=True))
        return shown


def _ends(quantity: Quantity) -> tuple[float, float] | None:
    return None if quantity.interval is None else (quantity.interval.low, quantity.interval.high)
