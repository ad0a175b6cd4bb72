"""Processes vibration: separates it from force by frequency, combines three axes into one, and reduces it to
what is above the threshold of a hand.

The paper (section 6.4) gives no method: "process the vibrotactile feedback in the spectral domain and then
modulate the force feedback appropriately in the time domain". Here a `Crossover` splits a recorded force into
two parts that sum to it; `dft321` reduces three axes to one, because a hand does not perceive the direction
of a vibration; a `Stft` provides the spectral domain; and `reduce_vibration` keeps the part above it::

    force -> Crossover -> low: the medium's force
                       -> high -> dft321 -> reduced -> symbols and steps -> decoded

The error of what is sent is below the threshold of a hand (`perception.human`) in every third of an octave
and every half second. A threshold is known for a single sine only: that a sum of thirds below it, or a
vibration in the presence of another, goes unnoticed does not follow.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from touchfield.arrays import Bools, Float64s, Int32s, Int64s
from touchfield.errors import InvalidArgument, require_between, require_positive
from touchfield.medium.field import numbers_of
from touchfield.perception.human import VibrationThreshold, figure, vibration_threshold

if TYPE_CHECKING:
    from collections.abc import Callable


BANDS_HZ: Final = tuple(float(1000 * 10 ** (n / 10)) for n in range(-15, 1))
"""Centres of the sixteen thirds of an octave from 31.6 Hz to 1 kHz; a band extends from its centre by a
factor 10 ** 0.05 to either side."""

WINDOW_S: Final = 0.5
"""Length of the window in which a level is measured."""

_LONG_S: Final = 2.0  # the same for mean levels, so that a band has many bins
_HALF: Final = 10**0.05
# taps times cutoff over rate; the transition of the Hamming window is then as wide as the cutoff
_TAPS: Final = 3.3
_MAX_TAPS: Final = (1 << 20) - 1
_PER_OCTAVE: Final = 4  # number of step sizes per octave
_DEAD_ZONE: Final = 0.6  # smaller coefficients, in steps, are omitted
_ROUNDS: Final = 400
_PATIENCE: Final = 8


def _signal(where: str, values: ArrayLike, shapes: tuple[str, ...], rate_hz: float = 1.0) -> Float64s:
    """Check a signal over time and return it as float64.

    `shapes` are the allowed ones of "[n]" and "[n, 3]".
    """
    require_positive(rate_hz=rate_hz)
    x = numbers_of(where, values)
    found = {1: "[n]", 2: f"[n, {x.shape[-1] if x.ndim else 0}]"}.get(x.ndim)
    if found not in shapes or not len(x):
        mend = "dft321 makes one axis of three." if found == "[n, 3]" else ""
        raise InvalidArgument(where, f"shape {x.shape}", f"{' or '.join(shapes)}, n at least 1", mend)
    wrong = np.argwhere(~np.isfinite(x))
    if len(wrong):
        raise InvalidArgument(where, f"{x[tuple(wrong[0])]} at sample {wrong[0][0]}", "finite numbers")
    return x


# -- force and vibration -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Crossover:
    """A split of a signal at a frequency into a low and a high part that sum to it.

    The low-pass h is a windowed sinc (Hamming) with an odd number of taps and linear phase; the high-pass is
    the impulse at its centre minus h. Both are 6 dB down at `cutoff_hz` and in phase there; `split`
    compensates their delay.

    Raises `InvalidArgument` if a number is not positive and finite, or the cut-off is half of `rate_hz` or
    more.
    """

    rate_hz: float  # samples a second
    # by default the upper bound of the forces that a hand controls, see human.toml
    cutoff_hz: float = figure("force_bandwidth_hz")

    def __post_init__(self) -> None:
        require_positive(rate_hz=self.rate_hz, cutoff_hz=self.cutoff_hz)
        if not 2 * self.cutoff_hz < self.rate_hz:
            raise InvalidArgument("cutoff_hz", f"{self.cutoff_hz:g} Hz", f"below half of {self.rate_hz:g} Hz")
        if _TAPS * self.rate_hz / self.cutoff_hz > _MAX_TAPS:
            raise InvalidArgument(
                "cutoff_hz", f"{self.cutoff_hz:g} Hz at {self.rate_hz:g} Hz", "a higher one"
            )

    @cached_property
    def low_taps(self) -> Float64s:
        """The low-pass h, float64 [taps], with sum 1."""
        from scipy.signal import firwin

        count = 2 * math.ceil(_TAPS * self.rate_hz / self.cutoff_hz / 2) + 1
        taps = firwin(count, self.cutoff_hz, fs=self.rate_hz)
        return np.asarray((taps + taps[::-1]) / 2)

    def split(self, signal: ArrayLike) -> tuple[Float64s, Float64s]:
        """The low part and the high part, without delay.

        signal : float [n] or [n, 3]; its end values are taken to continue beyond its ends.
        Both parts are float64 of the shape and unit of `signal`; their sum is the signal up to the rounding
        of one addition. Raises `InvalidArgument` for another shape or a number that is not finite.
        """
        from scipy.signal import oaconvolve

        x = _signal("signal", signal, ("[n]", "[n, 3]"), self.rate_hz)
        half = len(self.low_taps) // 2
        wide = np.pad(x, [(half, half), *[(0, 0)] * (x.ndim - 1)], "edge")
        taps = self.low_taps.reshape(-1, *[1] * (x.ndim - 1))
        low: Float64s = oaconvolve(wide, taps, mode="valid", axes=0)
        return low, x - low


def dft321(signal: ArrayLike) -> Float64s:
    """Reduce three axes to one with their energy in each spectral bin, float64 [n].

    signal : float [n, 3]; the unit is kept.
    The phase is that of the sum of the axes (Landin, Romano, McMahan and Kuchenbecker 2010, Dimensional
    reduction of high-frequency accelerations for haptic rendering, EuroHaptics). The whole signal is one
    transform, so that events keep their time only roughly: a tap that reaches the axes at different times is
    smeared. Raises `InvalidArgument` for another shape or a number that is not finite.
    """
    spectra = np.fft.rfft(_signal("signal", signal, ("[n, 3]",)), axis=0)
    size = np.sqrt((np.abs(spectra) ** 2).sum(axis=1))
    together = spectra.sum(axis=1)
    angle = np.angle(together)
    # of a sum of zero the angle would be that of rounding errors
    angle[np.abs(together) < 1e-15 * size] = 0.0
    return np.fft.irfft(size * np.exp(1j * angle), len(np.asarray(signal)))


def handle_force_n(
    acceleration_m_s2: ArrayLike, rate_hz: float, hand: VibrationThreshold | None = None
) -> Float64s:
    """The force that would shake a handle in a hand as recorded, newtons, float64 [n].

    acceleration_m_s2 : float [n]; of the handle, at `rate_hz`.
    hand : VibrationThreshold, optional; whose mass, damper and spring are used, by default the stylus.
    F = a (m + b / (i w) - k / w^2); frequencies below the lowest band of `BANDS_HZ` are omitted. Raises
    `InvalidArgument` for another shape or a number that is not finite.
    """
    a = _signal("acceleration_m_s2", acceleration_m_s2, ("[n]",), rate_hz)
    profile = hand or vibration_threshold()
    w = 2 * np.pi * np.fft.rfftfreq(len(a), 1 / rate_hz)
    is_in_band = w >= 2 * np.pi * BANDS_HZ[0] / _HALF
    w = np.where(is_in_band, w, 1.0)
    n_per_m = profile.stiffness_n_per_m - profile.mass_kg * w**2 + 1j * profile.damping_n_s_per_m * w
    return np.fft.irfft(np.where(is_in_band, -n_per_m / w**2, 0.0) * np.fft.rfft(a), len(a))


# -- levels ------------------------------------------------------------------------------------------------


def _edges(rate_hz: float) -> Float64s:
    """Edges of thirds of an octave from the lowest of `BANDS_HZ` to half the rate, Hz."""
    first = BANDS_HZ[0] / _HALF
    count = max(0, math.ceil(10 * math.log10(max(rate_hz / 2 / first, 1.0)) - 1e-9))
    return np.asarray(first * 10 ** (0.1 * np.arange(count)))


def _window_power(x: Float64s, rate_hz: float, edges: Float64s, window_s: float = WINDOW_S) -> Float64s:
    """Mean squares in each band and window, float64 [windows, edges + 1].

    Each window shares half of its samples with the next.
    """
    length = 4 * max(int(window_s * rate_hz / 4), 1)
    power = 4 / length * np.abs(Stft(length).spectra(x)) ** 2
    power[:, [0, -1]] /= 2
    band = np.searchsorted(edges, np.fft.rfftfreq(length, 1 / rate_hz), side="right")
    return np.stack([power[:, band == b].sum(axis=1) for b in range(len(edges) + 1)], axis=1)


def band_rms(signal: ArrayLike, rate_hz: float) -> Float64s:
    """Rms of a signal in each of `BANDS_HZ`, float64 [16], in the unit of the signal.

    signal : float [n]; at `rate_hz`, half a second or more.
    The rms is 0 in bands beyond half the rate. Raises `InvalidArgument` for another shape, a number that is
    not finite, or a shorter signal.
    """
    x = _signal("signal", signal, ("[n]",), rate_hz)
    if len(x) < WINDOW_S * rate_hz:
        raise InvalidArgument(
            "signal", f"{len(x) / rate_hz:.3g} s", f"{WINDOW_S:g} s or more", "Record longer."
        )
    edges = _edges(rate_hz)
    longest_s = min(_LONG_S, len(x) / rate_hz)
    length = 4 * max(int(longest_s * rate_hz / 4), 1)
    inner = _window_power(x, rate_hz, edges, longest_s)[1 : 2 * len(x) // length]  # full windows only
    rms = np.zeros(len(BANDS_HZ))
    count = min(len(edges) - int(not math.isclose(edges[-1] * 10**0.1, rate_hz / 2)), len(BANDS_HZ))
    rms[:count] = np.sqrt(inner.mean(axis=0))[1 : count + 1]
    return rms


# -- the spectral domain -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Stft:
    """Short-time spectra of overlapping frames; the real ones can be inverted.

    Each frame shares half of its samples with the next. The window before and after the transform is a sine,
    whose squares sum to 1 (constant overlap-add). The transforms preserve energy: the squares of all
    coefficients (those between the ends counted twice) sum to that of the signal.

    Raises `InvalidArgument` if `length` is not a multiple of 4.
    """

    length: int = 128

    def __post_init__(self) -> None:
        if self.length < 4 or self.length % 4:
            raise InvalidArgument("length", repr(self.length), "samples, a multiple of 4")

    def spectra(self, signal: ArrayLike) -> NDArray[np.complex128]:
        """Return the spectra of a signal [n], complex128 [frames, length / 2 + 1].

        `InvalidArgument` as in `dft321`.
        """
        return np.asarray(np.fft.rfft(self._frames(signal), axis=1, norm="ortho"))

    def real_spectra(self, signal: ArrayLike) -> Float64s:
        """Modified discrete cosine transform of a signal, float64 [frames, length / 2].

        There are as many coefficients as samples. Bin k is at (k + 1/2) / length of the rate. Aliasing within
        a frame cancels when overlapping frames are added.
        """
        from scipy.fft import dct

        a, b, c, d = np.split(self._frames(signal), np.arange(1, 4) * (self.length // 4), axis=1)
        folded = np.concatenate([-c[:, ::-1] - d, a - b[:, ::-1]], axis=1)
        return np.asarray(dct(folded, type=4, norm="ortho", axis=1))

    def signal_from(self, coefficients: Float64s, count: int) -> Float64s:
        """The first `count` samples of the signal of `real_spectra`, float64 [count]."""
        from scipy.fft import dct

        low, high = np.split(dct(coefficients, type=4, norm="ortho", axis=1), 2, axis=1)
        frames = np.concatenate([high, -high[:, ::-1], -low[:, ::-1], -low], axis=1) * self.window
        hop, signal = self.length // 2, np.zeros((len(frames) + 1) * self.length // 2)
        signal[:-hop] += frames[:, :hop].ravel()
        signal[hop:] += frames[:, hop:].ravel()
        return signal[hop : hop + count]

    @cached_property
    def window(self) -> Float64s:
        """The sine window, float64 [length]."""
        return np.asarray(np.sin(np.pi * (np.arange(self.length) + 0.5) / self.length))

    def _frames(self, signal: ArrayLike) -> Float64s:
        x, hop = _signal("signal", signal, ("[n]",)), self.length // 2
        wide = np.pad(x, (hop, hop + -len(x) % hop))
        return np.asarray(np.lib.stride_tricks.sliding_window_view(wide, self.length)[::hop] * self.window)


# -- what must be sent -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ReducedVibration:
    """The part of a vibration that is sent: integers, and a step for each band.

    symbols : int32 [frames, length / 2]; coefficients of `Stft.real_spectra`, in steps.
    exponents : int16 [bands]; steps are 2 ** (exponent / 4) newtons; -32768: nothing of the band is sent.
    The first band lies below the lowest third of an octave of `BANDS_HZ`; the others are the thirds from
    there to half the rate.
    """

    symbols: Int32s
    exponents: NDArray[np.int16]
    rate_hz: float
    count: int  # samples of the signal

    @property
    def length(self) -> int:
        """Samples of a frame."""
        return 2 * int(self.symbols.shape[1])

    @cached_property
    def bits(self) -> float:
        """Estimated bits of the symbols with adaptive arithmetic coding, and of the steps.

        The estimate is the code length of Krichevsky and Trofimov for each band, over the values from the
        smallest to the largest of the band; these two take 32 bits. A step takes 16 bits.
        """
        from scipy.special import gammaln

        band, total = _bands_of_bins(self.length, self.rate_hz), 16.0 * len(self.exponents)
        for b in np.flatnonzero(self.exponents > _NOTHING):
            values, counts = np.unique(self.symbols[:, band == b], return_counts=True)
            if len(values):
                n, wide = counts.sum(), int(values[-1]) - int(values[0]) + 1
                nats = (
                    gammaln(n + wide / 2) - gammaln(wide / 2) - (gammaln(counts + 0.5) - gammaln(0.5)).sum()
                )
                total += 32 + nats / math.log(2)
        return float(total)

    @property
    def bits_per_s(self) -> float:
        """Bits per second of the signal."""
        return self.bits * self.rate_hz / self.count

    def decoded(self) -> Float64s:
        """The vibration, newtons, float64 [count]."""
        step = _steps(self.exponents)[_bands_of_bins(self.length, self.rate_hz)]
        return Stft(self.length).signal_from(self.symbols * step, self.count)


_NOTHING: Final = np.int16(-32768)


def _steps(exponents: NDArray[np.int16]) -> Float64s:
    """Steps of bands, newtons; 1 where nothing is sent."""
    return np.asarray(2.0 ** (np.where(exponents == _NOTHING, 0, exponents) / _PER_OCTAVE))


def _bands_of_bins(length: int, rate_hz: float) -> Int64s:
    """The band of each bin, the same for sender and receiver."""
    return np.searchsorted(_edges(rate_hz), (np.arange(length // 2) + 0.5) * rate_hz / length, side="right")


def reduce_vibration(
    vibration_n: ArrayLike,
    rate_hz: float,
    threshold: VibrationThreshold | None = None,
    margin_db: float = 3.0,
) -> ReducedVibration:
    """Reduce a vibration to what must be sent for the loss to stay below a threshold.

    vibration_n : float [n]; newtons at `rate_hz`, such as the high part of a `Crossover` after `dft321`.
    threshold : VibrationThreshold, optional; of the hand, by default the stylus.
    margin_db : float; how far the loss stays below the threshold in each third of an octave, 0 or more.

    Bands with a level below that limit are not sent. In the others, coefficients below 0.6 steps are omitted
    and the rest is rounded to steps; the steps shrink until the error is below the limit in every band and
    every window of half a second. Raises `InvalidArgument` for another shape, a number that is not finite or
    out of range, or a rate below 100 Hz.
    """
    x = _signal("vibration_n", vibration_n, ("[n]",), rate_hz)
    if rate_hz < 100:
        raise InvalidArgument("rate_hz", repr(rate_hz), "100 Hz or more")
    require_between(0, 200, margin_db=margin_db)
    edges = _edges(rate_hz)
    # limit of the error in each band, newtons rms: the smallest threshold within the band, less the margin
    inside = edges[:, None] * 10 ** np.linspace(0, 0.1, 9)
    thirds = (threshold or vibration_threshold()).force_rms_mn(inside).min(axis=1)
    limits = 1e-3 * 10 ** (-margin_db / 20) * np.append(thirds[:1], thirds)
    stft = Stft(1 << max(4, round(math.log2(0.064 * rate_hz))))
    spectra, band = stft.real_spectra(x), _bands_of_bins(stft.length, rate_hz)

    def with_steps(exponents: NDArray[np.int16]) -> ReducedVibration:
        parts = spectra / _steps(exponents)[band]
        if np.abs(parts).max(initial=0.0) >= 2**31:
            found = f"{np.abs(parts).max():g} steps"
            raise InvalidArgument("vibration_n", found, "fewer than 2^31", "Check its unit.")
        is_sent = (np.abs(parts) >= _DEAD_ZONE) & (exponents > _NOTHING)[band]
        symbols = np.where(is_sent, np.rint(parts), 0).astype(np.int32)
        return ReducedVibration(symbols, exponents, rate_hz, len(x))

    def exceeds_limit(exponents: NDArray[np.int16]) -> Bools:
        error_power = _window_power(x - with_steps(exponents).decoded(), rate_hz, edges)
        return np.asarray(np.sqrt(error_power.max(axis=0)) > limits)

    bins = np.maximum(np.bincount(band, minlength=len(limits)), 1)
    first_exponents = np.ceil(_PER_OCTAVE * np.log2(limits * np.sqrt(6 * stft.length / bins))).astype(
        np.int16
    )
    is_above = np.sqrt(_window_power(x, rate_hz, edges).max(axis=0)) > 0.9 * limits
    exponents = _fine_enough(np.where(is_above, first_exponents, _NOTHING), first_exponents, exceeds_limit)
    for b in np.flatnonzero((exponents > _NOTHING) & np.isin(np.arange(len(limits)), band)):
        for _ in range(_PATIENCE):  # make steps coarser again that shrank only because of other bands
            coarser = exponents.copy()
            coarser[b] += 1
            if exceeds_limit(coarser).any():
                break
            exponents = coarser
    return with_steps(exponents)


def _fine_enough(
    exponents: NDArray[np.int16],
    first_exponents: NDArray[np.int16],
    exceeds_limit: Callable[[NDArray[np.int16]], Bools],
) -> NDArray[np.int16]:
    """Shrink the steps until no band exceeds its limit.

    A band that is not sent at first is sent only if nothing else helps.
    """
    failed = np.zeros(len(first_exponents), np.int64)
    for _ in range(_ROUNDS):
        wrong = exceeds_limit(exponents)
        if not wrong.any():
            return exponents
        failed += wrong
        is_affected = np.convolve(wrong, np.ones(3), "same") > 0  # the window leaks into neighbouring bands
        woken = wrong | (np.convolve(wrong & (failed > _PATIENCE), np.ones(3), "same") > 0)
        silent = exponents == _NOTHING
        finer = np.where(is_affected, exponents - 1, exponents)
        exponents = np.where(silent, np.where(woken, first_exponents, _NOTHING), finer).astype(np.int16)
    raise InvalidArgument(
        "vibration_n", "what no step makes fine enough", "forces of a hand", "Check its unit."
    )
