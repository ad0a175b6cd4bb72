"""The lattice and the settings of the coders that spend a budget best: min R + lambda D (paper section 4).

A medium that moves has a bit rate: R is that of a long stream, from a few pairs of frames that follow each other,
spread over the scene; the first of a pair tells what a frame alone takes, the second what one that follows takes. A
still medium is sent once, and has a size in bytes.

D is the NMSE on one lattice, that of the greatest n_w: a coarser stream is decoded and interpolated there as a
receiver does, so that what a coarse lattice leaves out counts. The mask is the same for all, whatever k a coder took.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise, product
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from touchfield.codec.paper.spec import PaperSpec
from touchfield.codec.registry import coder, field_decoder, field_encoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.errors import InvalidArgument
from touchfield.filters.resample import interpolated
from touchfield.job.executors import in_order
from touchfield.job.prepare import Prepared, open_scene, prepare
from touchfield.job.spec import NO_FLOOR_N, EncodeSpec
from touchfield.measure.fidelity import FidelityMeter
from touchfield.medium import ForceField
from touchfield.parallel import Report, silent
from touchfield.sources.scene import Scene

if TYPE_CHECKING:
    from touchfield.codec.segment import CodedSegment


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
    """A budget such as ``64kbit/s`` (bit/s, kbit/s, Mbit/s, B/s, kB/s) or ``60kB`` (B, kB, MB)."""
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
    "mask" and "mask-direction"; steps of its mode "nmse", newtons; of coder `paper`, every one with every other,
    codebooks (N_d), Weber fractions and n_q.
    """

    nw: tuple[int, ...] = (5, 6, 7)
    k: tuple[float, ...] = (0.05, 0.1, 0.2, 0.4)
    step_n: tuple[float, ...] = (0.02, 0.05, 0.1, 0.2, 0.4, 0.8)
    directions: tuple[str, ...] = ("ico3", "ico5")
    paper_k: tuple[float, ...] = (PaperSpec().k,)
    nq: tuple[int, ...] = (PaperSpec().nq,)

    def __post_init__(self) -> None:
        for name in ("nw", "k", "step_n", "directions", "paper_k", "nq"):
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
        papers = [
            PaperSpec(k=k, nq=nq, directions=d, segment_frames=length)
            for k, nq, d in product(self.paper_k, self.nq, self.directions)
        ]
        return [
            *(replace(asked, touch=one) for one in coders),
            *(replace(asked, coder="paper", touch=TouchSpec(), paper=one) for one in papers),
        ]

    @property
    def coarsest(self) -> PlanGrid:
        """Of these the settings that take least: the coarsest lattice, the weakest promise, the greatest step."""
        greatest = {name: (max(axis),) for name in ("k", "step_n", "paper_k") if (axis := getattr(self, name))}
        return replace(self, nw=(min(self.nw),), nq=self.nq and (min(self.nq),), **greatest)


@dataclass(frozen=True)
class Trial:
    """One setting, as `touchfield.job.encode` takes it, and what came of it.

    `file_bytes` are the file of a still medium, or of a medium that moves a segment of `frames` in a long stream.
    Measured on the finest lattice are `nmse`, sum |e|^2 / sum |F|^2; `beyond_mask`, the voxels that differ by more
    than a hand can feel over those that held a force, which can exceed 1; and `mask_kept`, the share of the voxels
    whose error no hand can feel.
    """

    spec: EncodeSpec
    file_bytes: int
    frames: int
    nmse: float
    beyond_mask: float
    rate_hz: float = 1.0
    mask_kept: float = 1.0

    @property
    def bits_per_frame(self) -> float:
        """R."""
        return 8 * self.file_bytes / self.frames

    @property
    def bits_per_s(self) -> float:
        """R as a rate."""
        return self.bits_per_frame * self.rate_hz

    @property
    def kind(self) -> str:
        """The coder, and its mode."""
        return "paper" if self.spec.coder == "paper" else f"touch {self.spec.touch.mode}"

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        touch, paper = self.spec.touch, self.spec.paper
        is_paper, is_nmse = self.spec.coder == "paper", touch.mode == "nmse"
        return {
            "nw": self.spec.nw,
            "coder": self.spec.coder,
            "mode": None if is_paper else touch.mode,
            "k": paper.k if is_paper else None if is_nmse else touch.k,
            "f0_n": None if is_paper or is_nmse else touch.f0_n,
            "step_n": touch.step_n if is_nmse and not is_paper else None,
            "nq": paper.nq if is_paper else None,
            "directions": paper.directions if is_paper else None,
            "file_bytes": self.file_bytes,
            "bits_per_frame": self.bits_per_frame,
            "nmse": self.nmse,
            "nmse_db": 10 * math.log10(self.nmse) if self.nmse > 0 else None,
            "beyond_mask": self.beyond_mask,
            "mask_kept": self.mask_kept,
        }

    @property
    def options(self) -> str:
        """The options of `touchfield encode` for it."""
        told = self.summary()
        words = [] if told["nw"] is None else [f"--nw {told['nw']}"]
        if told["coder"] == "paper":
            words.append("--coder paper")
        for key in ("mode", "k", "f0_n", "step_n", "nq", "directions"):
            if told[key] is not None and told[key] != "mask":
                value = told[key] if isinstance(told[key], str) else f"{told[key]:g}"
                words.append(f"--{key.replace('_', '-')} {value}")
        return " ".join(words)


@dataclass(frozen=True)
class Plan:
    """All settings that were tried, in the order of the search, and the best within a budget.

    `k` and `f0_n` are the mask of `Trial.beyond_mask` and `Trial.mask_kept`; `unit` is the budget's, "bit/s", or
    "bytes" for a still medium. InvalidArgument if no setting is within the budget; it names the smallest.
    """

    trials: tuple[Trial, ...]
    k: float
    f0_n: float
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

    def front(self) -> tuple[Trial, ...]:
        """Settings that no other beats in both size and NMSE, the smallest first; of equal ones the first tried."""
        front: list[Trial] = []
        for trial in sorted(self.trials, key=lambda t: (t.bits_per_s, t.nmse)):
            if not front or trial.nmse < front[-1].nmse:
                front.append(trial)
        return tuple(front)

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
        """lambda: bits a second (bytes of a still medium) that one unit of NMSE is worth at the choice, if any.

        The slope of the frontier's convex hull there: with it, R + lambda D is least at both ends of that edge.
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
        from touchfield.job.view import draw_plan

        draw_plan(Path(path), self)


def plan(
    source: str | Path | Scene,
    budget: float | Budget,
    spec: EncodeSpec | None = None,
    search: PlanGrid | None = None,
    report: Report = silent,
    executor: Executor | None = None,
) -> Plan:
    """Code a few frames of a source, as voxels, under every setting, and choose the best within a budget.

    A number as `budget` is bits a second; `spec` is of coder `touch`: its k and F_0 are the mask that is reported,
    its effort that of every trial. `report` gets ``(done, total)`` in settings; with `executor` its workers try them.

    TouchfieldError if a setting is not possible, the frames hold no force, or nothing is within the budget; the
    message then names what takes least. The cheapest settings are tried first, so that this is told soon.
    """
    spec, search = spec or EncodeSpec(), search or PlanGrid()
    budget = budget if isinstance(budget, Budget) else Budget(bits_per_s=budget)
    if spec.coder != "touch":
        raise InvalidArgument("plan", f"coder {spec.coder}", "coder touch; the paper's is tried, too")
    asked = replace(spec, representation="voxel", touch=replace(spec.touch, mode="mask"))
    scene = open_scene(source, spec.source)
    _check_possible(scene, asked, search.coarsest, budget)
    mask, total = (spec.touch.k, spec.touch.f0_n), 0
    lattice = None

    def tries() -> Iterator[tuple[Lattice, EncodeSpec]]:
        nonlocal total, lattice
        for lattice in lattices(scene, asked, sorted(search.nw)):
            specs = search.specs(lattice.spec)
            total = len(specs) * (1 if lattice.is_array else len(search.nw))
            yield from ((lattice, one) for one in specs)

    trials: list[Trial] = []
    for trial in in_order(partial(_trial, mask), tries(), executor=executor):
        trials.append(trial)
        report(len(trials), total)
    assert lattice is not None
    amount, unit = budget.of(lattice.frames, lattice.rate_hz)
    return Plan(tuple(trials), *mask, amount, str(source), len(_numbers(lattice.frames)), unit)


def _trial(mask: tuple[float, float], setting: tuple[Lattice, EncodeSpec]) -> Trial:
    """A setting coded, decoded and measured by the mask of k and F_0."""
    lattice, spec = setting
    size, frames, decoded = _in_memory(lattice, spec)
    meter = FidelityMeter(mask[0], max(mask[1], NO_FLOOR_N))
    for original, field in zip(lattice.reference, decoded, strict=True):
        same = field.grid.shape == original.grid.shape
        meter.add(original, field if same else interpolated(field, original.grid, border="cell"))
    nmse = 0.0 if meter.nmse_db is None else 10 ** (meter.nmse_db / 10)
    beyond = meter.mask_violations / max(1, meter.supported_voxels)
    return Trial(spec, size, frames, nmse, beyond, lattice.rate_hz, 1 - meter.mask_violation_share)


class Lattice(NamedTuple):
    """The frames to try of a medium on one lattice, and the same frames on the finest; it can be sent to a worker."""

    spec: EncodeSpec
    is_array: bool
    frames: int
    rate_hz: float
    fields: tuple[ForceField, ...]
    reference: tuple[ForceField, ...]


def lattices(scene: Scene, base: EncodeSpec, nws: Sequence[int]) -> Iterator[Lattice]:
    """The lattices of several n_w, each made once.

    An array has its own lattice: of several n_w the first is taken. InvalidArgument if no frame holds a force.
    """
    finest = prepare(scene, replace(base, nw=max(nws)))
    wanted = _numbers(len(finest.medium))
    reference = tuple(finest.medium[i] for i in wanted)
    if not any(f.support_count for f in reference):
        raise InvalidArgument("source of a search", f"{len(reference)} frames without a force", "a force")
    for nw in nws[:1] if finest.device.is_array else nws:
        asked = replace(base, nw=nw)
        is_finest = nw == max(nws) or finest.device.is_array
        prepared = replace(finest, spec=asked) if is_finest else prepare(scene, asked)
        fields = reference if is_finest else tuple(prepared.medium[i] for i in wanted)
        yield _lattice(prepared, fields, reference)


def _lattice(prepared: Prepared, fields: tuple[ForceField, ...], reference: tuple[ForceField, ...]) -> Lattice:
    medium = prepared.medium
    return Lattice(prepared.spec, prepared.device.is_array, len(medium), medium.rate_hz, fields, reference)


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
        size, frames, _ = _in_memory(_lattice(prepared, fields, fields), spec, is_decoded=False)
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
    fields, coding = iter(lattice.fields), coder(spec.coder).resolve(spec.coding, lattice.is_array)
    encoder = field_encoder(lattice.fields[0].grid, coding)
    decoder = field_decoder(spec.coder, lattice.fields[0].grid, encoder.parameters)
    coded: list[CodedSegment] = []
    decoded: list[ForceField] = []
    for pair in _pairs(lattice.frames):
        coded.append(encoder.encode_segment([next(fields) for _ in pair]))
        decoded += decoder.frames(coded[-1].body, len(pair)) if is_decoded else ()
    length = min(spec.segment_frames_at(lattice.rate_hz), lattice.frames)
    size = _SEGMENT_BYTES + _FILE_BYTES * length / lattice.frames + _segment_bytes(coded, length)
    return round(size), length, decoded


def _segment_bytes(coded: Sequence[CodedSegment], length: int) -> float:
    """The body of a segment of `length` frames: one alone, and the others as costly as the second of a pair."""
    total = 0.0
    for one in coded:
        first = 8 * len(one.body) - sum(frame.bits.total for frame in one.frames[1:])
        total += first + (length - 1) * sum(frame.bits.total for frame in one.frames[1:])
    return total / 8 / len(coded)
