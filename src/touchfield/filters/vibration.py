"""Vibration made of a force: where a force is felt, a sine that is stronger where it is stronger (paper section 6.4).

The rule is the simplest that gives a surface a hum: the amplitude is a share of |F|, the frequency the same
everywhere, or rising with |F| up to F_max. It stands behind the haptic filters, and is no filter itself: a filter
makes a field of a field.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from threading import Lock
from typing import TYPE_CHECKING

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.medium.vibration import MAX_FREQUENCY_HZ, VibrationBand, VibrationFrame

if TYPE_CHECKING:
    from touchfield.medium import ForceField, HapticMedium

__all__ = ["VibrationRule", "vibrating"]

_OPTION = "--vibration"
_EXPECTED = "such as gain=0.1,frequency=150 or gain=0.1,frequency=80..250"


@dataclass(frozen=True)
class VibrationRule:
    """What vibrates beside a force.

    gain : float; amplitude of the sine, as a share of |F|; above 0.
    low_hz, high_hz : float; frequency at no force, and at F_max; 1 to `MAX_FREQUENCY_HZ`.
    """

    gain: float = 0.1
    low_hz: float = 150.0
    high_hz: float = 150.0

    def __post_init__(self) -> None:
        if not 0 < self.gain < math.inf:
            raise InvalidArgument(f"{_OPTION} gain", repr(self.gain), "a share of |F| above 0")
        for hz in (self.low_hz, self.high_hz):
            if not 1 <= hz <= MAX_FREQUENCY_HZ:
                raise InvalidArgument(f"{_OPTION} frequency", f"{hz:g} Hz", f"1 to {MAX_FREQUENCY_HZ:g} Hz")

    @classmethod
    def parse(cls, text: str) -> VibrationRule:
        """A rule of words: "gain=0.1,frequency=150", "frequency=80..250"; what is not named is as by default.

        Raises `InvalidArgument` if a word is unknown, there twice, or has no number.
        """
        given: dict[str, float] = {}
        for part in (p for p in text.split(",") if p.strip()):
            name, _, value = (piece.strip() for piece in part.partition("="))
            names = {"gain": ("gain",), "frequency": ("low_hz", "high_hz")}.get(name, ())
            values = value.split("..") if name == "frequency" else [value]
            if not names or names[0] in given or len(values) > len(names):
                raise InvalidArgument(_OPTION, repr(part.strip()), _EXPECTED)
            try:
                numbers = [float(one) for one in values]
            except ValueError:
                raise InvalidArgument(f"{_OPTION} {name}", repr(value), _EXPECTED) from None
            given |= dict(zip(names, numbers * len(names) if len(numbers) == 1 else numbers))
        return cls(**given)

    def of(self, field: ForceField, force_max_n: float) -> VibrationFrame:
        """What vibrates beside one field: all of its support, but for amplitudes too small for a number."""
        held = field.support()
        amplitudes = (self.gain * held.amplitudes_n.astype(np.float64)).astype(np.float32)
        share = np.minimum(held.amplitudes_n.astype(np.float64) / force_max_n, 1)
        hertz = (self.low_hz + (self.high_hz - self.low_hz) * share).astype(np.float32)
        kept = (amplitudes > 0) & np.isfinite(amplitudes)
        return VibrationFrame(field.grid, held.positions[kept], amplitudes[kept], hertz[kept])


def vibrating(medium: HapticMedium, rule: VibrationRule, force_max_n: float) -> HapticMedium:
    """The medium with a vibration by a rule beside it, in place of any that it has.

    force_max_n : float; F_max, at which the frequency is the highest, newtons.
    """
    latest = _Latest(medium)
    band = VibrationBand(medium.grid, medium.frame_count, lambda i: rule.of(latest(i), force_max_n))
    return replace(medium, make_frame=latest, vibration=band)


class _Latest:
    """The frames of a medium, the latest kept: its force and its vibration are asked for one after the other."""

    def __init__(self, medium: HapticMedium) -> None:
        self._medium, self._lock = medium, Lock()
        self._kept: tuple[int, ForceField] | None = None

    def __call__(self, frame: int) -> ForceField:
        with self._lock:
            kept = self._kept
        if kept is None or kept[0] != frame:
            kept = frame, self._medium[frame]
            with self._lock:
                self._kept = kept
        return kept[1]
