"""Vibration signals: crossover from force, reduction to one axis, and removal of imperceptible parts.

The paper (section 6.4) gives no method: "process the vibrotactile feedback in the spectral domain and then
modulate the force feedback appropriately in the time domain". Here a `Crossover` splits a recorded force into
two parts that add up to it again; `dft321` reduces three axes to one, as a hand does not perceive the
direction of a vibration; a `Stft` is the spectral domain; and `reduce_vibration` keeps the perceptible part::

    force -> Crossover -> low: the medium's force
                       -> high -> dft321 -> reduced -> symbols and steps -> decoded

What is sent is off by less than the threshold of a hand (`perception.human`) in every third of an octave and
every half second. A threshold is that of a sine alone: that a sum of thirds below it, or a vibration beside
another one, is imperceptible, too, is likely but does not follow from it.
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
"""Centres of the sixteen thirds of an octave from 31.6 Hz to 1 kHz; a band reaches a factor 10 ** 0.05 either
way.
"""

WINDOW_S: Final = 0.5
"""In which a level is taken."""

_LONG_S: Final = 2.0  # the same where a mean is wanted, so that a band has many bins
_HALF: Final = 10**0.05
_TAPS: Final = 3.3  # of a Hamming window: its transition is as wide as the crossover is high
_MAX_TAPS: Final = (1 << 20) - 1
_PER_OCTAVE: Final = 4  # of steps
_DEAD_ZONE: Final = 0.6  # of a step; what is smaller is left out
_ROUNDS: Final = 400
_PATIENCE: Final = 8


def _signal(where: str, values: ArrayLike, shapes: tuple[str, ...], rate_hz: float = 1.0) -> Float64s:
    """Numbers over time, checked; `shapes` are words of "[n]" and "[n, 3]"."""
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
    """A split of a signal into what lies below a frequency and what lies above, which add up to it again.

    The low-pass h is a windowed sinc of an odd number of taps (Hamming), of linear phase; the high-pass is
    the impulse at its middle less h. Both are 6 dB down at `cutoff_hz` and in phase there; `split` takes
    their delay off.

    Raises `InvalidArgument` if a number is not positive and finite, or the cut-off is half of `rate_hz` or
    more.
    """

    rate_hz: float  # samples a second
    cutoff_hz: float = figure("force_bandwidth_hz")  # where what a hand feels as a force ends

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
        """h, float64 [taps], of sum 1."""
        from scipy.signal import firwin

        count = 2 * math.ceil(_TAPS * self.rate_hz / self.cutoff_hz / 2) + 1
        taps = firwin(count, self.cutoff_hz, fs=self.rate_hz)
        return np.asarray((taps + taps[::-1]) / 2)

    def split(self, signal: ArrayLike) -> tuple[Float64s, Float64s]:
        """The low part and the high part, without delay, each float64 as `signal`, in its unit.

        signal : float [n] or [n, 3]; beyond its ends it is taken to stay as it is there.
        Their sum is the signal to the rounding of one addition. Raises `InvalidArgument` if the shape is
        another or a number is not finite.
        """
        from scipy.signal import oaconvolve

        x = _signal("signal", signal, ("[n]", "[n, 3]"), self.rate_hz)
        half = len(self.low_taps) // 2
        wide = np.pad(x, [(half, half), *[(0, 0)] * (x.ndim - 1)], "edge")
        taps = self.low_taps.reshape(-1, *[1] * (x.ndim - 1))
        low: Float64s = oaconvolve(wide, taps, mode="valid", axes=0)
        return low, x - low


def dft321(signal: ArrayLike) -> Float64s:
    """One axis for three, with the energy of the three in each bin of the spectrum, float64 [n].

    signal : float [n, 3]; any unit, which stays.
    The phase is that of the sum of the axes, of Landin, Romano, McMahan and Kuchenbecker 2010, Dimensional
    reduction of high-frequency accelerations for haptic rendering (EuroHaptics). The whole signal is one
    transform, and what happens at a time happens near it, no more: a tap that the axes feel at different
    times is smeared. Raises `InvalidArgument` if the shape is another or a number is not finite.
    """
    spectra = np.fft.rfft(_signal("signal", signal, ("[n, 3]",)), axis=0)
    size = np.sqrt((np.abs(spectra) ** 2).sum(axis=1))
    together = spectra.sum(axis=1)
    angle = np.angle(together)
    angle[np.abs(together) < 1e-15 * size] = 0.0  # of nothing, the rounding would be drawn
    return np.fft.irfft(size * np.exp(1j * angle), len(np.asarray(signal)))


def handle_force_n(
    acceleration_m_s2: ArrayLike, rate_hz: float, hand: VibrationThreshold | None = None
) -> Float64s:
    """The force that shakes a handle in a hand as it was recorded, newtons, float64 [n].

    acceleration_m_s2 : float [n]; of the handle, at `rate_hz`.
    hand : VibrationThreshold, optional; whose mass, damper and spring are taken, by default the stylus.
    F = a (m + b / (i w) - k / w^2); what lies below the lowest of `BANDS_HZ` is left out. Raises
    `InvalidArgument` if the shape is another or a number is not finite.
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
    """Edges of the thirds of an octave from the lowest of `BANDS_HZ` to half the rate, Hz."""
    first = BANDS_HZ[0] / _HALF
    count = max(0, math.ceil(10 * math.log10(max(rate_hz / 2 / first, 1.0)) - 1e-9))
    return np.asarray(first * 10 ** (0.1 * np.arange(count)))


def _window_power(x: Float64s, rate_hz: float, edges: Float64s, window_s: float = WINDOW_S) -> Float64s:
    """Mean squares by windows, half of each shared with the next, float64 [windows, edges + 1]."""
    length = 4 * max(int(window_s * rate_hz / 4), 1)
    power = 4 / length * np.abs(Stft(length).spectra(x)) ** 2
    power[:, [0, -1]] /= 2
    band = np.searchsorted(edges, np.fft.rfftfreq(length, 1 / rate_hz), side="right")
    return np.stack([power[:, band == b].sum(axis=1) for b in range(len(edges) + 1)], axis=1)


def band_rms(signal: ArrayLike, rate_hz: float) -> Float64s:
    """Rms of a signal in each of `BANDS_HZ`, float64 [16], in its unit; 0 in bands that the rate cannot hold.

    signal : float [n]; at `rate_hz`, half a second or more.
    Raises `InvalidArgument` if the shape is another, a number is not finite, or it is shorter.
    """
    x = _signal("signal", signal, ("[n]",), rate_hz)
    if len(x) < WINDOW_S * rate_hz:
        raise InvalidArgument(
            "signal", f"{len(x) / rate_hz:.3g} s", f"{WINDOW_S:g} s or more", "Record longer."
        )
    edges = _edges(rate_hz)
    longest_s = min(_LONG_S, len(x) / rate_hz)
    length = 4 * max(int(longest_s * rate_hz / 4), 1)
    inner = _window_power(x, rate_hz, edges, longest_s)[1 : 2 * len(x) // length]  # the others are not full
    rms = np.zeros(len(BANDS_HZ))
    count = min(len(edges) - int(not math.isclose(edges[-1] * 10**0.1, rate_hz / 2)), len(BANDS_HZ))
    rms[:count] = np.sqrt(inner.mean(axis=0))[1 : count + 1]
    return rms


# -- the spectral domain -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Stft:
    """Spectra of frames, half of each shared with the next; the real ones give the signal back.

    A sine is the window before and after, whose squares add up to 1 (constant overlap-add); transforms keep
    energy, so that the squares of all coefficients, those between the ends counted twice, are those of the
    signal.

    Raises `InvalidArgument` if `length` is not a multiple of 4.
    """

    length: int = 128

    def __post_init__(self) -> None:
        if self.length < 4 or self.length % 4:
            raise InvalidArgument("length", repr(self.length), "samples, a multiple of 4")

    def spectra(self, signal: ArrayLike) -> NDArray[np.complex128]:
        """Return complex128 [frames, length / 2 + 1] of float [n]; `InvalidArgument` as in `dft321`."""
        return np.asarray(np.fft.rfft(self._frames(signal), axis=1, norm="ortho"))

    def real_spectra(self, signal: ArrayLike) -> Float64s:
        """As many coefficients as samples, float64 [frames, length / 2]: the modified discrete cosine
        transform.

        Bin k is at (k + 1/2) / length of the rate. What each frame folds over is undone where frames add up.
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
        """float64 [length]."""
        return np.asarray(np.sin(np.pi * (np.arange(self.length) + 0.5) / self.length))

    def _frames(self, signal: ArrayLike) -> Float64s:
        x, hop = _signal("signal", signal, ("[n]",)), self.length // 2
        wide = np.pad(x, (hop, hop + -len(x) % hop))
        return np.asarray(np.lib.stride_tricks.sliding_window_view(wide, self.length)[::hop] * self.window)


# -- what must be sent -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ReducedVibration:
    """The part of a vibration that is sent: integers, and a step for each third of an octave.

    symbols : int32 [frames, length / 2]; coefficients of `Stft.real_spectra`, in steps.
    exponents : int16 [bands]; steps are 2 ** (exponent / 4) newtons; -32768: nothing of the band is sent.
    Bands are what lies below the lowest third of `BANDS_HZ`, and the thirds from there to half the rate.
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
        """Bits of the symbols by an arithmetic coder that learns each band as it goes, and 16 for each step.

        The length of the code of Krichevsky and Trofimov, over the values from the least to the greatest of a
        band; these two take 32 bits.
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
        """Bits for each second of the signal."""
        return self.bits * self.rate_hz / self.count

    def decoded(self) -> Float64s:
        """The vibration, newtons, float64 [count]."""
        step = _steps(self.exponents)[_bands_of_bins(self.length, self.rate_hz)]
        return Stft(self.length).signal_from(self.symbols * step, self.count)


_NOTHING: Final = np.int16(-32768)


def _steps(exponents: NDArray[np.int16]) -> Float64s:
    """Newtons; 1 where nothing is sent."""
    return np.asarray(2.0 ** (np.where(exponents == _NOTHING, 0, exponents) / _PER_OCTAVE))


def _bands_of_bins(length: int, rate_hz: float) -> Int64s:
    """The band of each bin; the same for a receiver."""
    return np.searchsorted(_edges(rate_hz), (np.arange(length // 2) + 0.5) * rate_hz / length, side="right")


def reduce_vibration(
    vibration_n: ArrayLike,
    rate_hz: float,
    threshold: VibrationThreshold | None = None,
    margin_db: float = 3.0,
) -> ReducedVibration:
    """Reduce a vibration to the part that must be sent for the loss to be imperceptible.

    vibration_n : float [n]; newtons at `rate_hz`, such as the high part of a `Crossover` after `dft321`.
    threshold : VibrationThreshold, optional; of the hand, by default the stylus.
    margin_db : float; how far the loss stays below the threshold in each third of an octave, 0 or more.

    Bands whose level is below that are not sent. In the others a coefficient below 0.6 steps is left out and
    the rest is rounded to steps, which shrink until the error that is there keeps below the threshold in
    every band and every window of half a second. Raises `InvalidArgument` if the shape is another, a number
    is not finite or out of range, or the rate is below 100 Hz.
    """
    x = _signal("vibration_n", vibration_n, ("[n]",), rate_hz)
    if rate_hz < 100:
        raise InvalidArgument("rate_hz", repr(rate_hz), "100 Hz or more")
    require_between(0, 200, margin_db=margin_db)
    edges = _edges(rate_hz)
    # bounds of the error in each band, newtons rms: the least of the threshold within it, less the margin
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
    is_perceptible = np.sqrt(_window_power(x, rate_hz, edges).max(axis=0)) > 0.9 * limits
    exponents = _fine_enough(
        np.where(is_perceptible, first_exponents, _NOTHING), first_exponents, exceeds_limit
    )
    for b in np.flatnonzero((exponents > _NOTHING) & np.isin(np.arange(len(limits)), band)):
        for _ in range(_PATIENCE):  # coarser again, where the others shrank it
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
    """Shrink steps until no band exceeds its limit; send an unsent band only if nothing else helps."""
    failed = np.zeros(len(first_exponents), np.int64)
    for _ in range(_ROUNDS):
        wrong = exceeds_limit(exponents)
        if not wrong.any():
            return exponents
        failed += wrong
        is_affected = np.convolve(wrong, np.ones(3), "same") > 0  # a window lets a band speak in the next
        woken = wrong | (np.convolve(wrong & (failed > _PATIENCE), np.ones(3), "same") > 0)
        silent = exponents == _NOTHING
        finer = np.where(is_affected, exponents - 1, exponents)
        exponents = np.where(silent, np.where(woken, first_exponents, _NOTHING), finer).astype(np.int16)
    raise InvalidArgument(
        "vibration_n", "what no step makes fine enough", "forces of a hand", "Check its unit."
    )
