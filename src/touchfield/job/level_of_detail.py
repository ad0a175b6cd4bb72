"""The coarsest level of detail that loses little enough (paper section 4, level of detail).

Two criteria, both of all frames together:

* ``hil``: haptic information loss, eq. 3: max(H_0 - H_l, 0) / H_0 with H_l the bits a frame of level l, its voxels
  times the plug-in entropy of one under a single Q.
* ``jnd``: how many voxels differ from the finest level by more than a hand can feel, max(F_0, k |F|), once the level
  is interpolated back as a receiver does, over the voxels that held a force. A share of the voxels of either field
  would fall as a level spreads what it lost; this one can exceed 1.

Neither must rise from level to level: a low-pass makes new values, and what is spread widely enough is felt nowhere
but where it was. `LevelChoice.is_monotone` tells.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any, Final

from touchfield.codec.paper.field_quantiser import FieldQuantiser, FieldQuantiserSpec
from touchfield.errors import InvalidArgument
from touchfield.filters.device_filter import limited
from touchfield.filters.lifting import most_levels, pyramid, rebuilt
from touchfield.job.spec import DEFAULT_F0_N, Report, silent
from touchfield.measure.capacity import capacity, codomain_bits
from touchfield.measure.fidelity import FidelityMeter
from touchfield.measure.field_information import field_entropy
from touchfield.measure.field_symbols import FieldSymbols
from touchfield.measure.quantity import FewSamplesWarning, Quantity
from touchfield.medium import BRICK, ForceField, Grid, HapticMedium

__all__ = ["LevelChoice", "coarsest"]

CRITERIA: Final = ("hil", "jnd")


@dataclass(frozen=True)
class LevelChoice:
    """A level of detail, and what all levels lose.

    Attributes
    ----------
    criterion : str
    epsilon : float
    level : int
        The coarsest whose loss is `epsilon` or less; level 0 loses nothing.
    losses : tuple of float
        Of each level from 0 on.
    grids : tuple of Grid
    quantiser : str
        Q of the information; of the other criterion the mask.
    """

    criterion: str
    epsilon: float
    level: int
    losses: tuple[float, ...]
    grids: tuple[Grid, ...]
    quantiser: str

    @property
    def is_monotone(self) -> bool:
        """Whether no level loses less than a finer one."""
        return all(a <= b for a, b in zip(self.losses, self.losses[1:], strict=False))

    def field(self, frame: ForceField) -> ForceField:
        """The chosen level of a frame."""
        return pyramid(frame, self.level)[-1]

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        return {
            "criterion": self.criterion,
            "epsilon": self.epsilon,
            "level": self.level,
            "losses": list(self.losses),
            "grid_shape": list(self.grids[self.level].shape),
            "is_monotone": self.is_monotone,
            "quantiser": self.quantiser,
        }


def coarsest(
    medium: HapticMedium,
    criterion: str,
    epsilon: float,
    *,
    levels: int | None = None,
    quantiser: str | FieldQuantiserSpec | None = None,
    k: float = 0.1,
    f0_n: float = DEFAULT_F0_N,
    report: Report = silent,
) -> LevelChoice:
    """The coarsest level of detail of a medium that loses at most `epsilon`.

    Parameters
    ----------
    medium : HapticMedium
    criterion : str
        "hil" or "jnd".
    epsilon : float
        Share of the bits, or of the voxels with a force, from 0 to 1.
    levels : int, optional
        How many levels below the finest are looked at; by default down to a single brick.
    quantiser : str or FieldQuantiserSpec, optional
        Q of "hil".
    k, f0_n : float
        The mask of "jnd": Weber fraction and F_0 in newtons.
    report : callable
        ``report(done, total)`` in frames.

    Raises
    ------
    InvalidArgument
        If the criterion is unknown, `epsilon` or `levels` out of range, or the medium tells nothing under Q.
    """
    if criterion not in CRITERIA:
        raise InvalidArgument("criterion", repr(criterion), " or ".join(CRITERIA))
    if not 0 <= epsilon <= 1:
        raise InvalidArgument("epsilon", repr(epsilon), "a share from 0 to 1")
    most = most_levels(medium.grid)
    wanted = max(0, most - most_levels(Grid((BRICK,) * 3, (1.0,) * 3, (0.0,) * 3))) if levels is None else levels
    if isinstance(wanted, bool) or not isinstance(wanted, int) or not 0 <= wanted <= most:
        raise InvalidArgument("levels", repr(levels), f"0 to {most}")
    asked = FieldQuantiserSpec.parse(quantiser) if isinstance(quantiser, str) else quantiser or FieldQuantiserSpec()
    if criterion == "hil":
        found, grids, words = _information(medium, wanted, asked, report)
    else:
        found, grids = _perceived(medium, wanted, FidelityMeter(k, f0_n), report)
        words = f"mask max({f0_n:g} N, {k:g} |F|)"
    level = max(n for n, loss in enumerate(found) if loss <= epsilon)
    return LevelChoice(criterion, float(epsilon), level, found, grids, words)


def _information(
    medium: HapticMedium, levels: int, asked: FieldQuantiserSpec, report: Report
) -> tuple[tuple[float, ...], tuple[Grid, ...], str]:
    if asked.form == "distinct":
        raise InvalidArgument("quantiser", "distinct", "one that also knows filtered forces, such as weber:0.1")
    quantise = asked.fit(medium)
    symbols: list[list[FieldSymbols]] = [[] for _ in range(levels + 1)]
    for i, frame in enumerate(medium):
        for kept, field in zip(symbols, pyramid(frame, levels), strict=True):
            kept.append(quantise(limited(field, quantise.top_n)))  # weights that round up must not leave Q
        report(i + 1, len(medium))
    entropies = [_bits(fields, quantise) for fields in symbols]
    if not entropies[0].value > 0:
        raise InvalidArgument(
            "medium", f"one that tells nothing under {quantise.words}", "a force", "Take a finer quantiser."
        )
    grids = tuple(fields[0].grid for fields in symbols)
    losses = []
    for bits, grid in zip(entropies, grids, strict=True):
        top = codomain_bits(grid.voxel_count, quantise.alphabet)
        losses.append(capacity(entropies[0], bits, top).hil.value)
    return tuple(losses), grids, quantise.words


def _bits(fields: list[FieldSymbols], quantise: FieldQuantiser) -> Quantity:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FewSamplesWarning)  # the coarsest levels have few samples by nature
        entropy = field_entropy(fields, "voxel", interval=False)
    return entropy.times(fields[0].grid.voxel_count, "bit/frame", "H(W)")


def _perceived(
    medium: HapticMedium, levels: int, mask: FidelityMeter, report: Report
) -> tuple[tuple[float, ...], tuple[Grid, ...]]:
    meters = [FidelityMeter(mask.k, mask.f0_n) for _ in range(levels + 1)]
    grids: tuple[Grid, ...] = ()
    for i, frame in enumerate(medium):
        made = pyramid(frame, levels)
        grids = tuple(f.grid for f in made)
        for n, (meter, field) in enumerate(zip(meters, made, strict=True)):
            meter.add(frame, rebuilt(field, frame.grid) if n else frame)
        report(i + 1, len(medium))
    return tuple(m.mask_violations / max(1, m.supported_voxels) for m in meters), grids
