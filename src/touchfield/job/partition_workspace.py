"""A medium's workspace divided into the dyadic boxes that lose least (paper section 4)."""

from __future__ import annotations

from typing import Final

from touchfield.codec.paper.field_quantiser import FieldQuantiserSpec
from touchfield.errors import InvalidArgument
from touchfield.filters.device_filter import limited
from touchfield.filters.resample import resample
from touchfield.job.spec import Report, silent
from touchfield.measure.partition import BoxLosses, DyadicLattice, Partition, optimal_partition
from touchfield.medium import HapticMedium

__all__ = ["partition_workspace"]

COARSE_QUANTISER: Final = "weber:0.25/ico1"
"""Ten amplitudes by twelve directions: few enough symbols that a box holds many samples of each."""


def partition_workspace(
    medium: HapticMedium,
    device_shape: tuple[int, int, int],
    penalty_bits: float,
    quantiser: str | FieldQuantiserSpec = COARSE_QUANTISER,
    report: Report = silent,
) -> Partition:
    """Divide the workspace into boxes that each fill the device's lattice, with the least sum of losses.

    Parameters
    ----------
    medium : HapticMedium
        On a lattice of 2^D times the device's samples along each axis (`touchfield.measure.partition`).
    device_shape : (int, int, int)
        Samples that the device shows at once.
    penalty_bits : float
        lambda: bits a frame that another box must save.
    quantiser : str or FieldQuantiserSpec
        Q of the losses, in the words of `touchfield.codec.paper.field_quantiser`. What a box is told of a cell
        is Q of its mean force.
    report : callable
        ``report(done, total)`` in frames.

    Raises
    ------
    InvalidArgument
        If the lattice does not fit, lambda is negative or the quantiser knows no forces but those of the medium.
    """
    asked = FieldQuantiserSpec.parse(quantiser) if isinstance(quantiser, str) else quantiser
    if asked.form == "distinct":
        raise InvalidArgument("quantiser", "distinct", "one that also knows mean forces, such as weber:0.25/ico1")
    lattice = DyadicLattice(medium.grid, device_shape)
    losses = BoxLosses(lattice)
    quantise = asked.fit(medium)
    for i, frame in enumerate(medium):
        coarse = [resample(frame, lattice.lattice(d), "box") for d in range(lattice.depth)]
        # weights that round up must not leave Q
        losses.add([quantise(limited(level, quantise.top_n)) for level in (*coarse, frame)])
        report(i + 1, len(medium))
    return optimal_partition(lattice, losses.bits(), penalty_bits)
