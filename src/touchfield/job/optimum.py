"""The best of many settings of the coder: the Pareto front, and the choice by lambda or by a target."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

from touchfield.errors import InvalidArgument
from touchfield.job.spec import EncodeSpec

__all__ = ["DISTORTIONS", "Optimisation", "Trial"]

DISTORTIONS: Final = ("nmse", "beyond_mask")


@dataclass(frozen=True)
class Trial:
    """One setting of the coder, and what came of it.

    Attributes
    ----------
    spec : EncodeSpec
        What `touchfield.job.encode` takes, to code the whole source so.
    file_bytes : int
        The whole file of the frames that were tried.
    frames : int
    nmse : float
        sum |e|^2 / sum |F|^2 on the finest lattice.
    beyond_mask : float
        Voxels that differ by more than a hand can feel, over those that held a force on that lattice: one number for
        every n_w, so that a coarse lattice does not gain by spreading what it lost. It can exceed 1.
    """

    spec: EncodeSpec
    file_bytes: int
    frames: int
    nmse: float
    beyond_mask: float

    @property
    def bits_per_frame(self) -> float:
        """R."""
        return 8 * self.file_bytes / self.frames

    def distortion(self, by: str) -> float:
        """D, by one of `DISTORTIONS`.

        Raises
        ------
        InvalidArgument
            If it is unknown.
        """
        if by not in DISTORTIONS:
            raise InvalidArgument("distortion", repr(by), " or ".join(DISTORTIONS))
        return self.nmse if by == "nmse" else self.beyond_mask

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        paper = self.spec.paper
        return {
            "nw": self.spec.nw,
            "k": paper.k,
            "nq": paper.nq,
            "directions": paper.directions,
            "file_bytes": self.file_bytes,
            "bits_per_frame": self.bits_per_frame,
            "nmse": self.nmse,
            "nmse_db": 10 * math.log10(self.nmse) if self.nmse > 0 else None,
            "beyond_mask": self.beyond_mask,
        }


@dataclass(frozen=True)
class Optimisation:
    """All settings that were tried, in the order of the search.

    Attributes
    ----------
    trials : tuple of Trial
    k, f0_n : float
        The mask of `Trial.beyond_mask`.
    """

    trials: tuple[Trial, ...]
    k: float
    f0_n: float

    def front(self, by: str = "nmse") -> tuple[Trial, ...]:
        """The Pareto front: settings that no other beats in both size and distortion, the smallest file first.

        Of settings that are equal in both the first tried is taken.
        """
        found: list[Trial] = []
        for trial in sorted(self.trials, key=lambda t: (t.file_bytes, t.distortion(by))):
            if not found or trial.distortion(by) < found[-1].distortion(by):
                found.append(trial)
        return tuple(found)

    def at(self, multiplier: float, by: str = "nmse") -> Trial:
        """The setting with the least R + lambda D; of equal ones the smaller file.

        Parameters
        ----------
        multiplier : float
            lambda, bits a frame for one unit of D: 0 gives the smallest file, ``inf`` the best field.
        by : str
            D: "nmse" or "beyond_mask".
        """
        if not multiplier >= 0:
            raise InvalidArgument("lambda", repr(multiplier), "bits a frame for a unit of distortion, 0 or more")
        if math.isinf(multiplier):
            return self.front(by)[-1]
        return min(self.front(by), key=lambda t: t.bits_per_frame + multiplier * t.distortion(by))

    def within_bytes(self, most_bytes: float, by: str = "nmse") -> Trial:
        """The best field whose file has at most so many bytes.

        Raises
        ------
        InvalidArgument
            If no setting makes one; the message names the smallest.
        """
        fitting = [t for t in self.front(by) if t.file_bytes <= most_bytes]
        if not fitting:
            nearest = self.front(by)[0]
            raise InvalidArgument(
                "target of bytes",
                f"{most_bytes:g}",
                f"at least {nearest.file_bytes}, the nearest ({_named(nearest)})",
            )
        return fitting[-1]

    def within_distortion(self, most: float, by: str = "nmse") -> Trial:
        """The smallest file whose distortion is at most so great; an NMSE as a ratio, not in dB.

        Raises
        ------
        InvalidArgument
            If no setting makes one; the message names the best.
        """
        for trial in self.front(by):
            if trial.distortion(by) <= most:
                return trial
        nearest = self.front(by)[-1]
        reached = f"at least {nearest.distortion(by):.6g}, the nearest ({_named(nearest)})"
        raise InvalidArgument(f"target of {by}", f"{most:g}", reached)

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        return {
            "k": self.k,
            "f0_n": self.f0_n,
            "trials": [t.summary() for t in self.trials],
            **{f"front_{by}": [self.trials.index(t) for t in self.front(by)] for by in DISTORTIONS},
        }


def _named(trial: Trial) -> str:
    s = trial.summary()
    return f"nw {s['nw']}, k {s['k']:g}, nq {s['nq']}, directions {s['directions']}"
