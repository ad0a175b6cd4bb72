"""The lattice and the settings of the coders that spend a budget best (paper section 4, "optimisation").

A medium that moves has a bit rate: R is that of a long stream, from a few pairs of frames that follow each other,
spread over the scene; the first of a pair tells what a frame alone takes, the second what one that follows takes. A
still medium is sent once, and has a size in bytes.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from touchfield.codec.paper.spec import PaperSpec
from touchfield.codec.registry import coder, field_decoder, field_encoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.errors import InvalidArgument
from touchfield.job.prepare import open_scene, prepare
from touchfield.job.settings import Lattice, Optimisation, Trial, lattices, tried
from touchfield.job.spec import EncodeSpec, Report, silent
from touchfield.sources.scene import Scene

if TYPE_CHECKING:
    from touchfield.codec.segment import CodedSegment
    from touchfield.medium import ForceField

__all__ = ["Budget", "Plan", "PlanGrid", "amount", "parse_budget", "plan"]

_BITS: Final = {"bit": 1, "kbit": 1_000, "Mbit": 1_000_000, "B": 8, "kB": 8_000, "MB": 8_000_000}
_BUDGET: Final = re.compile(r"(\d+(?:\.\d*)?|\.\d+)\s*(?:(bit|kbit|Mbit|B|kB)/s|(B|kB|MB))")
_PLACES: Final = 3
_SEGMENT_BYTES: Final = 60
"""Frame, checksum and index entry of a segment."""
_FILE_BYTES: Final = 1200
"""Head, provenance and end of a file, about."""
_MASK_KEPT: Final = 0.95
"""Where fewer of the voxels are within the mask, the choice is offered with a word on it."""


@dataclass(frozen=True)
class Budget:
    """Bits a second of a medium that moves, or bytes of the whole file, one of both."""

    bits_per_s: float | None = None
    bytes: float | None = None

    def __post_init__(self) -> None:
        amounts = [amount for amount in (self.bits_per_s, self.bytes) if amount is not None]
        if len(amounts) != 1 or not 0 < amounts[0] < math.inf:
            raise InvalidArgument("budget", repr(self), "bits a second or bytes, one of both, above 0")

    def of(self, frames: int, rate_hz: float) -> tuple[float, str]:
        """The amount and its unit: "bytes" for a single frame, else "bit/s"; of a rate that is what 1 s carries."""
        is_still = frames == 1
        seconds = 1.0 if is_still else frames / rate_hz
        size = (self.bits_per_s or 0.0) * seconds / 8 if self.bytes is None else self.bytes
        return (size, "bytes") if is_still else (self.bits_per_s or 8 * size / seconds, "bit/s")


def parse_budget(text: str) -> Budget:
    """A budget such as ``64kbit/s`` (bit/s, kbit/s, Mbit/s, B/s, kB/s) or ``60kB`` (B, kB, MB).

    Raises
    ------
    InvalidArgument
        If it is no positive number with one of them.
    """
    parts = _BUDGET.fullmatch(text.strip())
    if parts is None or not float(parts[1]) > 0:
        units = "bit/s, kbit/s, Mbit/s, B/s, kB/s, or of bytes B, kB, MB"
        raise InvalidArgument("--budget", repr(text), f"a positive number and one of {units}: 64kbit/s or 60kB")
    bits = float(parts[1]) * _BITS[parts[2] or parts[3]]
    return Budget(bits_per_s=bits) if parts[2] else Budget(bytes=bits / 8)


@dataclass(frozen=True)
class PlanGrid:
    """The settings to try; InvalidArgument if there is no lattice or no setting.

    n_w of the lattices (an array has its own); Weber fractions of coder `touch`, F_0 in proportion, in the modes
    "mask" and "mask-direction"; steps of its mode "nmse", newtons; codebooks of coder `paper`, as a comparison.
    """

    nw: tuple[int, ...] = (5, 6, 7)
    k: tuple[float, ...] = (0.05, 0.1, 0.2, 0.4)
    step_n: tuple[float, ...] = (0.02, 0.05, 0.1, 0.2, 0.4, 0.8)
    directions: tuple[str, ...] = ("ico3", "ico5")

    def __post_init__(self) -> None:
        for name in ("nw", "k", "step_n", "directions"):
            object.__setattr__(self, name, tuple(dict.fromkeys(getattr(self, name))))
        if not self.nw or not (self.k or self.step_n or self.directions):
            raise InvalidArgument("plan", "no setting to try", "a lattice, and a k, a step or a direction codebook")

    def specs(self, asked: EncodeSpec) -> list[EncodeSpec]:
        """Every setting on the lattice of `asked`."""
        touch = asked.touch
        masks = [replace(touch, k=k, f0_n=touch.f0_n * k / touch.k) for k in self.k]
        coders = [replace(one, mode=mode) for mode in ("mask", "mask-direction") for one in masks]
        coders += [replace(touch, mode="nmse", step_n=step) for step in self.step_n]
        length = touch.segment_frames or PaperSpec().segment_frames
        papers = [PaperSpec(directions=d, segment_frames=length) for d in self.directions]
        return [
            *(replace(asked, touch=one) for one in coders),
            *(replace(asked, coder="paper", touch=TouchSpec(), paper=one) for one in papers),
        ]

    @property
    def coarsest(self) -> PlanGrid:
        """Of these the settings that take least: the coarsest lattice, the weakest promise, the greatest step."""
        k, step_n = self.k and (max(self.k),), self.step_n and (max(self.step_n),)
        return PlanGrid((min(self.nw),), k, step_n, self.directions)


@dataclass(frozen=True)
class Plan(Optimisation):
    """All settings that were tried, and the best within a budget.

    Attributes
    ----------
    budget : float
    source : str
    frames_tried : int
    unit : str
        Of the budget: "bit/s", or "bytes" for a still medium.

    Raises
    ------
    InvalidArgument
        If no setting is within the budget; the message names the smallest.
    """

    budget: float
    source: str
    frames_tried: int
    unit: str = "bit/s"

    def __post_init__(self) -> None:
        if not any(map(self.is_within, self.trials)):
            least = min(self.trials, key=self.cost)
            raise _too_little(self.budget, self.unit, self.cost(least), least.options)

    def cost(self, trial: Trial) -> float:
        """Bits a second of a trial, or its bytes, as the budget has it."""
        return trial.bits_per_s if self.unit == "bit/s" else float(trial.file_bytes)

    def is_within(self, trial: Trial) -> bool:
        """True of a trial that keeps to the budget."""
        return self.cost(trial) <= self.budget

    @property
    def chosen(self) -> Trial:
        """The least NMSE within the budget."""
        return next(t for t in reversed(self.front()) if self.is_within(t))

    @property
    def notes(self) -> tuple[str, ...]:
        """A word on a choice that a hand tells from the source, and on what would keep the mask."""
        if self.chosen.mask_kept >= _MASK_KEPT:
            return ()
        note = (
            f"a hand feels the difference: only {100 * self.chosen.mask_kept:.3g} % of the voxels are within the mask"
        )
        keeping = [t for t in self.trials if t.mask_kept >= _MASK_KEPT]
        if not keeping:
            return (f"{note}; no setting that was tried keeps it (more --nw, a smaller --k)",)
        least = min(keeping, key=self.cost)
        return (f"{note}; {least.options} keeps it, for {amount(self.cost(least), self.unit)}",)

    @property
    def multiplier(self) -> float | None:
        """lambda: bits a second (bytes of a still medium) that one unit of NMSE is worth at the choice.

        The slope of the frontier's convex hull there: with it, R + lambda D is least at both ends of that edge. None
        where there is nothing to weigh.
        """
        hull: list[Trial] = []
        for t in self.front():
            while len(hull) > 1 and self._is_above(hull[-2], hull[-1], t):
                hull.pop()
            hull.append(t)
        at = self.cost(self.chosen)
        edges = [(a, b) for a, b in pairwise(hull) if self.cost(a) <= at <= self.cost(b)]
        if not edges:
            return None
        a, b = edges[-1]
        return (self.cost(b) - self.cost(a)) / (a.nmse - b.nmse)

    def _is_above(self, a: Trial, b: Trial, c: Trial) -> bool:
        """True where `b` lies on or above the line from `a` to `c`."""
        run, rise = self.cost(c) - self.cost(a), c.nmse - a.nmse
        return (b.nmse - a.nmse) * run >= rise * (self.cost(b) - self.cost(a))

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs; of a still medium bytes in place of bits a second."""
        is_rate = self.unit == "bit/s"
        return {
            "source": self.source,
            "budget_bits_per_s" if is_rate else "budget_bytes": self.budget,
            "frames_tried": self.frames_tried,
            "k": self.k,
            "f0_n": self.f0_n,
            "lambda_bits_per_s" if is_rate else "lambda_bytes": self.multiplier,
            "chosen": self.trials.index(self.chosen),
            "encode_options": self.chosen.options,
            "front": [self.trials.index(t) for t in self.front()],
            "trials": [t.summary() | ({"bits_per_s": t.bits_per_s} if is_rate else {}) for t in self.trials],
        }

    def draw(self, path: str | Path) -> None:
        """Write the picture, PNG: NMSE over the cost, the frontier, the budget and the choice."""
        from touchfield.job.preview import draw_plan

        draw_plan(Path(path), self)


def plan(
    source: str | Path | Scene,
    budget: float | Budget,
    spec: EncodeSpec | None = None,
    search: PlanGrid | None = None,
    report: Report = silent,
) -> Plan:
    """Code a few frames of a source, as voxels, under every setting, and choose the best within a budget.

    Parameters
    ----------
    source : path or Scene
    budget : float or Budget
        A number is bits a second.
    spec : EncodeSpec, optional
        Of coder `touch`; its k and F_0 are the mask that is reported, its effort that of every trial.
    search : PlanGrid, optional
    report : callable
        ``report(done, total)`` in settings.

    Raises
    ------
    TouchfieldError
        If a setting is not possible, the frames hold no force, or nothing is within the budget; the message then
        names what takes least. The cheapest settings are tried first, so that this is told soon.
    """
    spec, search = spec or EncodeSpec(), search or PlanGrid()
    budget = budget if isinstance(budget, Budget) else Budget(bits_per_s=budget)
    if spec.coder != "touch":
        raise InvalidArgument("plan", f"coder {spec.coder}", "coder touch; the paper's is tried, too")
    asked = replace(spec, representation="voxel", touch=replace(spec.touch, mode="mask"))
    scene = open_scene(source, spec.source)
    _check_possible(scene, asked, search.coarsest, budget)
    total, medium = 0, None

    def tries() -> Iterator[tuple[Lattice, EncodeSpec]]:
        nonlocal total, medium
        for lattice in lattices(scene, asked, sorted(search.nw), _numbers):
            specs, medium = search.specs(lattice.prepared.spec), lattice.prepared.medium
            total = len(specs) * (1 if lattice.prepared.device.is_array else len(search.nw))
            yield from ((lattice, one) for one in specs)

    mask = spec.touch.k, spec.touch.f0_n
    trials = tried(tries(), _in_memory, mask, lambda done: report(done, total))
    assert medium is not None
    amount, unit = budget.of(len(medium), medium.rate_hz)
    return Plan(trials, *mask, amount, str(source), len(_numbers(len(medium))), unit)


def _check_possible(scene: Scene, asked: EncodeSpec, search: PlanGrid, budget: Budget) -> None:
    """Refuse a budget that even the settings that take least exceed, before any other is tried."""
    prepared = prepare(scene, replace(asked, nw=search.nw[0]))
    count, rate_hz = len(prepared.medium), prepared.medium.rate_hz
    amount, unit = budget.of(count, rate_hz)
    fields = tuple(prepared.medium[i] for i in _numbers(count))
    if not any(field.support_count for field in fields):
        return  # the search tells it
    least = math.inf, ""
    for spec in search.specs(prepared.spec):
        size, frames, _ = _in_memory(Lattice(prepared, fields, fields), spec, is_decoded=False)
        own = Trial(spec, size, frames, 0.0, 0.0, rate_hz)
        least = min(least, (own.bits_per_s if unit == "bit/s" else float(size), own.options))
        if least[0] <= amount:
            return
    raise _too_little(amount, unit, *least)


def _too_little(budget: float, unit: str, least: float, options: str) -> InvalidArgument:
    return InvalidArgument(
        f"--budget of {budget:g} {unit} is too small: it takes at least {least:.0f} {unit}, the nearest ({options})"
    )


def amount(cost: float, unit: str) -> str:
    """A cost in words."""
    if unit == "bytes":
        return f"{cost:,.0f} bytes"
    for name, size in (("Mbit/s", 1e6), ("kbit/s", 1e3)):
        if cost >= size:
            return f"{cost / size:.4g} {name}"
    return f"{cost:.4g} bit/s"


def _pairs(count: int) -> tuple[tuple[int, ...], ...]:
    """Frames that follow each other, spread over all: pairs, or the one frame that there is."""
    if count == 1:
        return ((0,),)
    places = min(_PLACES, count // 2)
    starts = [(2 * i + 1) * (count - 2) // (2 * places) for i in range(places)]
    return tuple((start, start + 1) for start in starts)


def _numbers(count: int) -> list[int]:
    return [i for pair in _pairs(count) for i in pair]


def _in_memory(lattice: Lattice, spec: EncodeSpec, is_decoded: bool = True) -> tuple[int, int, list[ForceField]]:
    """The bytes of a segment in a long stream, or of the file of a still medium; and the decoded pairs."""
    medium, fields = lattice.prepared.medium, iter(lattice.fields)
    coding = coder(spec.coder).resolve(spec.coding, lattice.prepared.device.is_array)
    encoder = field_encoder(lattice.fields[0].grid, coding)
    decoder = field_decoder(spec.coder, lattice.fields[0].grid, encoder.parameters)
    coded: list[CodedSegment] = []
    decoded: list[ForceField] = []
    for pair in _pairs(len(medium)):
        coded.append(encoder.encode_segment([next(fields) for _ in pair]))
        decoded += decoder.frames(coded[-1].body, len(pair)) if is_decoded else ()
    length = min(spec.segment_frames_at(medium.rate_hz), len(medium))
    size = _SEGMENT_BYTES + _FILE_BYTES * length / len(medium) + _segment_bytes(coded, length)
    return round(size), length, decoded


def _segment_bytes(coded: Sequence[CodedSegment], length: int) -> float:
    """The body of a segment of `length` frames: one alone, and the others as costly as the second of a pair."""
    total = 0.0
    for one in coded:
        first = 8 * len(one.body) - sum(frame.bits.total for frame in one.frames[1:])
        total += first + (length - 1) * sum(frame.bits.total for frame in one.frames[1:])
    return total / 8 / len(coded)
