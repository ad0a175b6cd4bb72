"""Equation 5: what a finite impulse response does to each frequency (paper section 3.2).

H(w1, ..) = sum over n of h[n] exp(-i (w1 n1 + ..)), a finite sum, frequencies in radians per sample; the paper calls
it H as it does the entropy. The two meet in one number: a stationary Gaussian process gains the mean of log2|H| over
all frequencies, bits a sample, in entropy rate (Papoulis, "Maximum entropy and spectral estimation", 1981).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from touchfield.arrays import Float64s
from touchfield.errors import InvalidArgument, MissingExtra
from touchfield.filters.separable import factors
from touchfield.medium.atomic import atomic_path
from touchfield.medium.field import frozen

_FLOOR: Final = 1e-15  # -300 dB: a gain of zero has no decibels
_SCAN: Final = 4096
_MIDPOINTS: Final = {2: 8192, 3: 192, 4: 40}  # for each axis but the last
_COLOURS: Final = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")  # Okabe and Ito: told apart by every eye
_STYLES: Final = ("-", "--", "-.", ":")


def frequency_response(taps: ArrayLike, *omegas: ArrayLike) -> NDArray[np.complex128]:
    """Equation 5: H(w1, ..) of a kernel [n1, ...] at frequencies in radians per sample, complex128 of their shape."""
    kernel = np.asarray(taps, np.float64)
    if kernel.ndim != len(omegas) or not omegas:
        raise InvalidArgument("frequency_response", f"{len(omegas)} frequencies", f"{kernel.ndim}, one for each axis")
    frequencies = np.broadcast_arrays(*(np.asarray(w, np.float64) for w in omegas))
    response: Any = np.broadcast_to(kernel, (*frequencies[0].shape, *kernel.shape))
    for omega, count in zip(reversed(frequencies), reversed(kernel.shape), strict=True):
        wave = np.exp(-1j * omega[..., None] * np.arange(count))
        wave = wave.reshape(*omega.shape, *([1] * (response.ndim - omega.ndim - 1)), count)
        response = (response * wave).sum(axis=-1)
    return np.asarray(response, np.complex128)


@dataclass(frozen=True)
class FrequencyResponse:
    """The response of one kernel, float64, N-D.

    spacing_m : tuple of float, optional; distance between samples along each axis; for cycles per millimetre.
    Raises `InvalidArgument` if the kernel is empty or not finite, all zero, or the spacing does not fit it.
    """

    taps: Float64s
    spacing_m: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        h = np.array(self.taps, np.float64)
        if not h.size or not h.ndim or not np.isfinite(h).all() or not h.any():
            raise InvalidArgument("taps", f"an array {h.shape}", "finite taps, not all of them zero")
        spacing = self.spacing_m
        if spacing is not None and not (len(spacing) == h.ndim and all(0 < s < math.inf for s in spacing)):
            raise InvalidArgument("spacing_m", repr(spacing), f"{h.ndim} positive lengths, one for each axis")
        object.__setattr__(self, "taps", frozen(h))

    def __call__(self, *omegas: ArrayLike) -> NDArray[np.complex128]:
        """H at these frequencies, radians per sample, one array for each axis."""
        return frequency_response(self.taps, *omegas)

    @property
    def dc_gain(self) -> float:
        """H(0), the sum of the taps."""
        return float(self.taps.sum())

    def gain_db(self, omega: ArrayLike, direction: Sequence[float] | str | None = None) -> Float64s:
        """20 log10 |H| along a line through zero frequency; -300 dB where there is nothing.

        omega : float; radians per sample along the line.
        direction : str or sequence of float, optional; "x", "y", "z", "t" for an axis, "diagonal" for omega along all
            axes at once, or how much of omega lies along each axis. The first axis if none is given.
        """
        w = np.asarray(omega, np.float64)
        gain = np.abs(self(*(part * w for part in self._direction(direction))))
        decibels: Float64s = 20 * np.log10(np.maximum(gain, _FLOOR))
        return decibels

    def crossing_rad(self, drop_db: float, direction: Sequence[float] | str | None = None) -> float:
        """The lowest frequency, radians per sample up to pi, where |H| is `drop_db` below |H(0)|; NaN if none.

        direction : optional; see `gain_db`.
        """
        if not drop_db > 0:
            raise InvalidArgument("drop_db", repr(drop_db), "a positive number of decibels")
        if not abs(self.dc_gain) > _FLOOR:
            return math.nan  # a high-pass has nothing to fall from
        level = 20 * math.log10(abs(self.dc_gain)) - drop_db
        omega = np.linspace(0, np.pi, _SCAN + 1)
        below = np.flatnonzero(self.gain_db(omega, direction) <= level)
        if not len(below):
            return math.nan
        from scipy import optimize

        a, b = omega[below[0] - 1], omega[below[0]]
        return float(optimize.brentq(lambda w: float(self.gain_db(w, direction)) - level, a, b, xtol=1e-12))

    def minus_3_db_rad(self, direction: Sequence[float] | str | None = None) -> float:
        """Where half the power is left, radians per sample."""
        return self.crossing_rad(10 * math.log10(2), direction)

    def minus_6_db_rad(self, direction: Sequence[float] | str | None = None) -> float:
        """Where half the amplitude is left, radians per sample."""
        return self.crossing_rad(20 * math.log10(2), direction)

    def entropy_rate_change_bits(self) -> float:
        """The mean of log2|H| over all frequencies: what the filter adds to a Gaussian process, bits a sample.

        Exact for one axis and for products of rows, by Jensen's formula. Otherwise exact along the last axis, and a
        mean over midpoints along the others, good to about 1e-6 for two axes and 1e-4 for three.
        Raises `InvalidArgument` for a kernel of more than four axes that is no product of rows.
        """
        rows = [self.taps] if self.taps.ndim == 1 else factors(self.taps)
        if rows:
            return float(sum(_mean_log2(row[None])[0] for row in rows))
        if self.taps.ndim not in _MIDPOINTS:
            raise InvalidArgument("taps", f"{self.taps.ndim} axes", "up to four axes, or a product of rows")
        count = _MIDPOINTS[self.taps.ndim]
        omega = (np.arange(count) + 0.5) * (2 * np.pi / count)
        rest = self.taps.astype(np.complex128)
        for _ in range(self.taps.ndim - 1):
            wave = np.exp(-1j * np.outer(omega, np.arange(rest.shape[0])))
            rest = np.moveaxis(np.tensordot(wave, rest, axes=1), 0, -1)
        lines = np.moveaxis(rest, 0, -1).reshape(-1, self.taps.shape[-1])
        return float(_mean_log2(lines).mean())

    def plot(self, path: str | Path, title: str = "") -> None:
        """Write a picture: gain in decibels along each axis and, for two axes and more, along the diagonal.

        Raises `MissingExtra` if matplotlib is not installed; `InvalidArgument` if it cannot write such a file.
        """
        try:
            from matplotlib.figure import Figure
        except ImportError:
            raise MissingExtra("a plot of a frequency response", "matplotlib", "report") from None
        figure = Figure(figsize=(7.2, 4.4), layout="constrained", dpi=150)
        self._draw(figure.add_subplot(), title)
        kinds = figure.canvas.get_supported_filetypes()
        kind = Path(path).suffix.lstrip(".").lower()
        if kind not in kinds:
            expected = f"one of {', '.join(sorted(kinds))}"
            raise InvalidArgument(str(path), f"the ending {Path(path).suffix!r}", expected)
        with atomic_path(Path(path)) as temporary:
            figure.savefig(temporary, format=kind)

    def _names(self) -> tuple[str, ...]:
        return ("x", "y", "z", "t")[: self.taps.ndim] if self.taps.ndim <= 4 else ()

    def _direction(self, direction: Sequence[float] | str | None) -> tuple[float, ...]:
        axes = self.taps.ndim
        if direction is None:
            return (1.0, *[0.0] * (axes - 1))
        if direction == "diagonal":
            return (1.0,) * axes
        if isinstance(direction, str):
            if direction not in self._names():
                expected = ", ".join((*self._names(), "diagonal"))
                raise InvalidArgument("direction", repr(direction), f"one of {expected}, or {axes} numbers")
            return tuple(float(name == direction) for name in self._names())
        if len(direction) != axes:
            raise InvalidArgument("direction", repr(direction), f"{axes} numbers, one for each axis")
        return tuple(float(part) for part in direction)

    def _draw(self, axes: Any, title: str) -> None:
        omega = np.linspace(0, np.pi, 1025)
        lines = self._lines()
        lowest = 0.0
        for n, (label, direction) in enumerate(lines):
            gain = self.gain_db(omega, direction)
            lowest = min(lowest, float(gain.min()))
            half = self.crossing_rad(20 * math.log10(2), direction)
            words = f"{label}, −6 dB at {half:.3g} rad" if math.isfinite(half) else label
            axes.plot(omega, gain, _STYLES[n % 4], color=_COLOURS[n % 4], linewidth=2, label=words)
        axes.axhline(-20 * math.log10(2), color="#666666", linewidth=0.8)
        axes.text(np.pi * 0.995, -5.6, "−6 dB", ha="right", va="bottom", color="#444444", fontsize=8)
        axes.set(xlim=(0, np.pi), ylim=(max(-100.0, 1.05 * lowest) - 1, None), title=title)
        axes.set_xticks(np.linspace(0, np.pi, 5), ["0", "π/4", "π/2", "3π/4", "π"])
        axes.set_xlabel("frequency, radians per sample" + (" along each axis" if len(lines) > 1 else ""))
        axes.set_ylabel("gain |H|, dB")
        axes.grid(color="#DDDDDD", linewidth=0.6)
        axes.figure.legend(loc="outside lower center", ncols=2, frameon=False)
        spacing = self.spacing_m
        if spacing is not None and max(spacing) - min(spacing) < 1e-9 * max(spacing):
            per_mm = 1e-3 / (2 * np.pi * spacing[0])
            above = axes.secondary_xaxis("top", functions=(lambda w: w * per_mm, lambda f: f / per_mm))
            above.set_xlabel("cycles per millimetre" + (" along each axis" if len(lines) > 1 else ""))

    def _lines(self) -> list[tuple[str, tuple[float, ...]]]:
        """Labels and directions to draw; axes with the same response share a line."""
        count = self.taps.ndim
        omega = np.linspace(0, np.pi, 257)
        lines: list[tuple[str, tuple[float, ...]]] = []
        for axis in range(count):
            direction = tuple(float(a == axis) for a in range(count))
            name = self._names()[axis] if count <= 4 else f"axis {axis}"
            gain = self.gain_db(omega, direction)
            same = [n for n, (_, d) in enumerate(lines) if np.allclose(self.gain_db(omega, d), gain, atol=1e-6)]
            if same:
                lines[same[0]] = (f"{lines[same[0]][0]}, {name}", lines[same[0]][1])
            else:
                lines.append((f"along {name}", direction))
        return [*lines, ("diagonal", (1.0,) * count)] if count > 1 else lines


def _mean_log2(lines: NDArray[Any]) -> Float64s:
    """The mean of log2 |sum of c[n] z^n| over |z| = 1 for each row of coefficients [m, n], by Jensen's formula."""
    used = np.flatnonzero(np.abs(lines).max(axis=0) > 0)
    c = lines[:, used[0] : used[-1] + 1]
    top = np.abs(c).max(axis=1)
    # a leading coefficient of zero is a root at infinity: a very distant one stands for it, and cancels
    lead = np.where(np.abs(c[:, -1]) > 1e-14 * top, c[:, -1], 1e-14 * top)
    degree = c.shape[1] - 1
    mean: Float64s = np.log2(np.abs(lead))
    if degree:
        companion = np.zeros((len(c), degree, degree), np.complex128)
        companion[:, np.arange(1, degree), np.arange(degree - 1)] = 1
        companion[:, :, -1] = -c[:, :-1] / lead[:, None]
        roots = np.abs(np.linalg.eigvals(companion))
        # double roots on the circle come out a little beside it
        mean = mean + np.log2(np.where(roots > 1 + 1e-7, roots, 1.0)).sum(axis=1)
    return mean
