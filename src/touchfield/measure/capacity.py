"""Computes how many bits of a medium a device can render, and how many it loses: workspace capacity, mapping
ratio WMR and information loss HIL (paper section 3.1, eq. 1-3).

Eq. 1 as printed, C(M) = min(C(M(W)), H(W)), has C on both sides. Read literally it is min(C_dev, H(W)) with
C_dev = log2 |codomain|, the most information that the device can receive in one frame. Here C = I(W; M(W)) =
H(M(W)) for a deterministic mapping: the information that the device receives of this medium, bits per frame.

No mapping exceeds H(W), by the data-processing inequality, so that in theory the printed min() never has an
effect. It remains as a guard against a biased estimate of either entropy, and against a lattice finer than
the medium's own ("active mappings" in the paper); `Capacity` notes when it had an effect. "Passive" means
this inequality and nothing else: `touchfield.measure.passivity` measures whether a field gives energy to the
hand.

Eq. 2: WMR = C / H(W). Eq. 3: HIL = max(H(W) - C, 0) / H(W). They sum to 1, because eq. 1 keeps C <= H(W).

Departures. Entropies per sample are refused: the mapping changes the number of samples, so that their ratio
has no meaning (the paper's Table 1 would give 2.3 / 1.2 > 1). The paper also requires C > 0; C = 0 plainly
means WMR = 0, HIL = 1 and is allowed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from numbers import Integral
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.errors import InvalidArgument, require_not_negative
from touchfield.measure.counts import Counts
from touchfield.measure.estimators import entropy_bits, estimate_bits
from touchfield.measure.quantity import Dependence, Interval, Quantity, Report, Spread, spread

_UNIT: Final = "bit/frame"
_NEVER_TOO_HIGH: Final = ("exact", "plug-in")  # these cannot exceed log2 of the number of symbols
_ROUNDING: Final = 1e-9


@dataclass(frozen=True)
class Capacity(Report):
    """Eq. 1 to 3 for one medium, device and mapping, in bits per frame except ratios.

    `reference`: H(W). `rendered`: H(M(W)). `codomain_bits`: C_dev. `capacity`: C. `wmr`, `hil`: workspace
    mapping ratio and haptic information loss; NaN if H(W) = 0.
    """

    reference: Quantity
    rendered: Quantity
    codomain_bits: float
    capacity: Quantity
    wmr: Quantity
    hil: Quantity

    @property
    def notes(self) -> tuple[str, ...]:
        """Guards that had an effect, or why a ratio does not exist."""
        return self.wmr.notes

    def summary(self) -> dict[str, Any]:
        """See `Report`."""
        return super().summary() | {"notes": list(self.notes)}


def codomain_bits(samples_per_frame: int, alphabet: int) -> float:
    """Return C_dev = log2 |codomain| of a device, bits per frame.

    `samples_per_frame`: number of lattice points or actuators. `alphabet`: number of symbols that each can
    show, including "no force". InvalidArgument if a number is not whole or below 1.
    """
    for where, count in (("samples_per_frame", samples_per_frame), ("alphabet", alphabet)):
        if isinstance(count, bool) or not isinstance(count, Integral) or count < 1:
            raise InvalidArgument(where, repr(count), "a whole number of at least 1")
    return samples_per_frame * math.log2(alphabet)


def capacity(
    reference: Quantity, rendered: Quantity, codomain_bits: float, ratio: Spread | None = None
) -> Capacity:
    """Return C, WMR and HIL of a mapping M of a medium W into a haptic workspace.

    Paper eq. 1-3. `reference`, `rendered`: H(W) and H(M(W)), "bit/frame", with the same weighting: of the
    whole quantised frame, or of a sample times the samples of a frame (`Quantity.times`). `codomain_bits`:
    C_dev, from the function of this name. `ratio`: the interval of H(M(W)) / H(W) from common blocks
    (`paired_ratio`). WMR gets this interval, cut at 1, and HIL its mirror image; neither has one if nothing
    is left of it.

    Without `ratio` the intervals of the two entropies are combined by interval arithmetic: min(C / H, 1)
    rises with C and falls with H, so that its bounds are those of opposite corners, at the level 1 - a - b of
    Bonferroni. This interval is wider than necessary, because the two estimates come from one medium and
    their errors are correlated. The interval of C is always computed in this way.

    InvalidArgument if a unit is not "bit/frame", a number is negative or not finite, the weightings differ,
    or a rendered entropy that cannot be overestimated exceeds C_dev (the codomain is then that of another
    device).
    """
    for where, entropy in (("reference", reference), ("rendered", rendered)):
        if entropy.unit != _UNIT:
            raise InvalidArgument(
                where, f"{entropy.name} in {entropy.unit}", f"an entropy in {_UNIT}",
                "A mapping changes the number of samples: multiply by the samples of a frame with "
                "Quantity.times.",
            )  # fmt: skip
        if not (math.isfinite(entropy.value) and entropy.value >= 0):
            raise InvalidArgument(where, f"{entropy.name} = {entropy.value}", "a finite entropy, 0 or more")
    if reference.weighting != rendered.weighting:
        raise InvalidArgument(
            "rendered",
            f"weighting {rendered.weighting}",
            f"{reference.weighting}, the weighting of the reference",
        )
    require_not_negative(codomain_bits=codomain_bits)
    excess = rendered.value > codomain_bits * (1 + _ROUNDING) + _ROUNDING
    if excess and rendered.estimator in _NEVER_TOO_HIGH:
        raise InvalidArgument(
            "codomain_bits",
            f"{codomain_bits:.6g}, below H(M(W)) = {rendered.value:.6g} bit/frame",
            "log2 of the number of frames that the device can show",
            "Count the samples and the alphabet of the lattice that was measured.",
        )
    return _of(reference, rendered, float(codomain_bits), ratio)


def paired_ratio(
    counts: tuple[Counts, Counts], voxels: tuple[int, int], codomain_bits: float, estimator: str = "plug-in"
) -> Spread | None:
    """Return the interval of min(H(M(W)), C_dev) / H(W) from common blocks of space.

    M(W) is a function of W, so that the errors of their estimates are correlated and the ratio varies less
    than either. `counts`: of W and of M(W) over voxels, in the same blocks
    (`touchfield.measure.field_count.shared_counts`). `voxels` (int, int): number of voxels of a frame of W
    and of M(W). `codomain_bits`: C_dev, bits per frame. `estimator`: of both entropies. None if H(W) = 0.
    The correlation length is not known, because the samples of both are not the same. InvalidArgument as in
    `touchfield.measure.quantity.spread`.
    """
    medium, rendered = counts
    assert medium.blocks is not None and rendered.blocks is not None
    cells = len(medium.cells)

    def ratio_of(entropy: Callable[[NDArray[Any], int | None], float], both: NDArray[Any]) -> float:
        above = voxels[1] * entropy(both[cells:], rendered.alphabet)
        return min(above, codomain_bits) / (voxels[0] * entropy(both[:cells], medium.alphabet))

    weights = np.concatenate([medium.weights, rendered.weights])
    if entropy_bits(medium.weights) == 0:
        return None
    found = spread(
        partial(ratio_of, lambda w, _: entropy_bits(w)),
        np.concatenate([medium.blocks, rendered.blocks], axis=1),
        bounds=(0.0, math.inf),
        layout=medium.layout,
        estimate=ratio_of(lambda w, k: estimate_bits(w, estimator, k), weights),
    )
    dependence = None if found.dependence is None else replace(found.dependence, correlation_length=math.nan)
    i = None if found.interval is None else replace(found.interval, method=f"paired, {found.interval.method}")
    return Spread(i, dependence, found.notes)


def _of(reference: Quantity, rendered: Quantity, device_bits: float, paired: Spread | None) -> Capacity:
    bits = min(rendered.value, device_bits, reference.value)
    notes = _guards(reference, rendered, device_bits)

    def of_both(name: str) -> str:
        notes, other_notes = getattr(reference, name), getattr(rendered, name)
        return str(notes) if notes == other_notes else f"W: {notes}; M(W): {other_notes}"

    base = rendered.of(unit="1", quantiser=of_both("quantiser"), estimator=of_both("estimator"), notes=notes)
    corners = _corners(reference, rendered, device_bits)
    c = base.of(name="C", value=bits, unit=_UNIT, interval=None if corners is None else corners[0])
    if reference.value == 0:
        why = "H(W) = 0: a medium without information loses none, and the ratio does not exist"
        nothing = base.of(value=math.nan, interval=None, notes=(*notes, why))
        return Capacity(reference, rendered, device_bits, c, nothing.of(name="WMR"), nothing.of(name="HIL"))
    ratio, loss = bits / reference.value, max(reference.value - bits, 0.0) / reference.value
    of_ratio = None if corners is None else corners[1]
    if paired is not None:
        i, notes = paired.interval, (*notes, *paired.notes)
        of_ratio = None if i is None else replace(i, low=min(i.low, ratio), high=min(max(i.high, ratio), 1.0))
        base = base.of(dependence=_dependence(paired, reference))
    if of_ratio is not None and of_ratio.low == of_ratio.high:
        of_ratio = None
        notes = (*notes, f"no interval: WMR is {ratio:.3g} wherever in their intervals the entropies lie")
    wmr = base.of(name="WMR", value=ratio, interval=of_ratio, notes=notes)
    i = of_ratio  # HIL = 1 - WMR
    mirrored = None if i is None else Interval(1.0 - i.high, 1.0 - i.low, i.level, i.method)
    hil = base.of(name="HIL", value=loss, interval=mirrored, notes=notes)
    return Capacity(reference, rendered, device_bits, c, wmr, hil)


def _dependence(paired: Spread, reference: Quantity) -> Dependence | None:
    """Return the dependence of a ratio, with the correlation length of W."""
    if paired.dependence is None or reference.dependence is None:
        return paired.dependence
    return replace(paired.dependence, correlation_length=reference.dependence.correlation_length)


def _guards(reference: Quantity, rendered: Quantity, device_bits: float) -> tuple[str, ...]:
    """Notes on the effect of the min() of eq. 1."""
    notes = []
    if rendered.value > device_bits * (1 + _ROUNDING):
        notes.append(
            f"H(M(W)) was estimated as {rendered.value:.6g} bit/frame, more than the {device_bits:.6g} that "
            "the "
            "device can show, which replaces it: the estimator overshoots"
        )
    if min(rendered.value, device_bits) > reference.value * (1 + _ROUNDING):
        notes.append(
            f"the min() of eq. 1 acted: H(M(W)) = {rendered.value:.6g} bit/frame is above "
            f"H(W) = {reference.value:.6g}, by a biased estimate, or a lattice or Q finer than W's"
        )
    if reference.estimator != rendered.estimator:
        notes.append(f"two estimators: {reference.estimator} for H(W), {rendered.estimator} for H(M(W))")
    return tuple(notes)


def _corners(reference: Quantity, rendered: Quantity, device_bits: float) -> tuple[Interval, Interval] | None:
    """Intervals of C and of WMR, by interval arithmetic; None if that of an entropy was refused."""
    if any(q.interval is None and q.dependence is not None for q in (reference, rendered)):
        return None
    intervals = [q.interval for q in (reference, rendered) if q.interval is not None]
    if not intervals:
        return None
    h_low, h_high = _range(reference)
    c_low, c_high = (min(end, device_bits) for end in _range(rendered))
    level = max(0.0, 1.0 - sum(1.0 - i.level for i in intervals))
    summary = f"H(W) in [{h_low:.6g}, {h_high:.6g}] and H(M(W)) in [{c_low:.6g}, {c_high:.6g}]"
    method = f"interval arithmetic, {summary}; {intervals[0].method}"
    low = 1.0 if h_high == 0 else min(c_low / h_high, 1.0)
    high = 1.0 if h_low <= c_high else c_high / h_low
    return (
        Interval(min(c_low, h_low), min(c_high, h_high), level, method),
        Interval(low, high, level, method),
    )


def _range(entropy: Quantity) -> tuple[float, float]:
    """The interval of an entropy, extended to the estimate; no impossible values."""
    i = entropy.interval
    if i is None:
        return entropy.value, entropy.value
    return max(0.0, min(i.low, entropy.value)), max(i.high, entropy.value)
