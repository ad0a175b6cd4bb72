"""The choice among many settings by a bit rate: the frontier, lambda, and what to type."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from touchfield.errors import InvalidArgument
from touchfield.job.optimum import Optimisation, Trial

__all__ = ["Plan", "PlanTrial"]


@dataclass(frozen=True)
class PlanTrial(Trial):
    """One setting, and what came of it; `file_bytes` are those of a segment of `frames` frames in a long stream.

    Attributes
    ----------
    rate_hz : float
        Frames a second.
    mask_kept : float
        Share of the voxels whose error no hand can feel, on the finest lattice.
    """

    rate_hz: float = 1.0
    mask_kept: float = 1.0

    @property
    def bits_per_s(self) -> float:
        """R."""
        return self.bits_per_frame * self.rate_hz

    @property
    def kind(self) -> str:
        """The coder, and its mode."""
        return "paper" if self.spec.coder == "paper" else f"touch {self.spec.touch.mode}"

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        touch, paper = self.spec.touch, self.spec.paper
        is_paper, mode = self.spec.coder == "paper", self.spec.touch.mode
        masked = not is_paper and mode != "nmse"
        shared = super().summary()
        return {
            "nw": self.spec.nw,
            "coder": self.spec.coder,
            "mode": None if is_paper else mode,
            "k": paper.k if is_paper else touch.k if masked else None,
            "f0_n": touch.f0_n if masked else None,
            "step_n": touch.step_n if not is_paper and mode == "nmse" else None,
            "directions": paper.directions if is_paper else None,
            "bits_per_s": self.bits_per_s,
            "bits_per_frame": self.bits_per_frame,
            "nmse": self.nmse,
            "nmse_db": shared["nmse_db"],
            "mask_kept": self.mask_kept,
        }

    @property
    def options(self) -> str:
        """What `touchfield encode` takes for it."""
        told = self.summary()
        words = [] if told["nw"] is None else [f"--nw {told['nw']}"]
        if told["coder"] == "paper":
            words.append("--coder paper")
        for key in ("mode", "k", "f0_n", "step_n", "directions"):
            if told[key] is not None and told[key] != "mask":
                value = told[key] if isinstance(told[key], str) else f"{told[key]:g}"
                words.append(f"--{key.replace('_', '-')} {value}")
        return " ".join(words)


@dataclass(frozen=True)
class Plan:
    """All settings that were tried, and the best within a bit rate.

    Attributes
    ----------
    trials : tuple of PlanTrial
    k, f0_n : float
        The mask of `PlanTrial.mask_kept`.
    budget_bits_per_s : float
    source : str
    frames_tried : int

    Raises
    ------
    InvalidArgument
        If no setting is within the budget; the message names the smallest.
    """

    trials: tuple[PlanTrial, ...]
    k: float
    f0_n: float
    budget_bits_per_s: float
    source: str
    frames_tried: int

    def __post_init__(self) -> None:
        if not any(t.bits_per_s <= self.budget_bits_per_s for t in self.trials):
            least = min(self.trials, key=lambda t: t.bits_per_s)
            nearest = f"at least {least.bits_per_s:.0f} bit/s, the nearest ({least.options})"
            raise InvalidArgument("--budget", f"{self.budget_bits_per_s:g} bit/s", nearest)

    @property
    def front(self) -> tuple[PlanTrial, ...]:
        """The frontier: settings that no other beats in both rate and NMSE, the lowest rate first."""
        found = Optimisation(self.trials, self.k, self.f0_n).front()
        return tuple(t for t in found if isinstance(t, PlanTrial))

    @property
    def chosen(self) -> PlanTrial:
        """The least NMSE within the budget."""
        return [t for t in self.front if t.bits_per_s <= self.budget_bits_per_s][-1]

    @property
    def multiplier(self) -> float | None:
        """lambda: bits a second that one unit of NMSE is worth at the choice; None where there is nothing to weigh.

        The slope of the frontier's convex hull there: with it, R + lambda D is least at both ends of that edge.
        """
        hull = self._hull()
        edges = [(a, b) for a, b in pairwise(hull) if a.bits_per_s <= self.chosen.bits_per_s <= b.bits_per_s]
        if not edges:
            return None
        a, b = edges[-1]
        return (b.bits_per_s - a.bits_per_s) / (a.nmse - b.nmse)

    def _hull(self) -> list[PlanTrial]:
        hull: list[PlanTrial] = []
        for t in self.front:
            while len(hull) > 1 and _above(hull[-2], hull[-1], t):
                hull.pop()
            hull.append(t)
        return hull

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        front, chosen = self.front, self.chosen
        return {
            "source": self.source,
            "budget_bits_per_s": self.budget_bits_per_s,
            "frames_tried": self.frames_tried,
            "k": self.k,
            "f0_n": self.f0_n,
            "lambda_bits_per_s": self.multiplier,
            "chosen": self.trials.index(chosen),
            "encode_options": chosen.options,
            "front": [self.trials.index(t) for t in front],
            "trials": [t.summary() for t in self.trials],
        }

    def draw(self, path: str | Path) -> None:
        """Write the picture, PNG: NMSE over bit rate, the frontier, the budget and the choice."""
        from touchfield.job.plan_picture import draw_plan

        draw_plan(Path(path), self)


def _above(a: PlanTrial, b: PlanTrial, c: PlanTrial) -> bool:
    """Whether `b` lies on or above the line from `a` to `c`."""
    return (b.nmse - a.nmse) * (c.bits_per_s - a.bits_per_s) >= (c.nmse - a.nmse) * (b.bits_per_s - a.bits_per_s)
