"""Tries lattices and settings of the coder, and finds those with the least error within a budget of bytes or
bits per second (paper section 4).

The search minimises R + lambda D; lambda is the slope of the convex hull of all settings at the choice (Y.
Shoham and A. Gersho, Efficient bit allocation for an arbitrary set of quantizers, IEEE Transactions on
Acoustics, Speech, and Signal Processing 36, 1988). A moving medium has a bit rate: R is that of a long
stream, estimated from a few pairs of consecutive frames spread over the scene. The first frame of a pair
gives the cost of an independent frame, the second that of a predicted frame. A static medium is sent once,
and has a size in bytes. D is the NMSE on the lattice of the largest n_w: a coarser stream is decoded and
interpolated to it, as a receiver does, so that the loss of a coarse lattice counts. The mask is the same for
all settings, whatever k a coder uses.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, pairwise, product
from pathlib import Path
from typing import Any, Final, NamedTuple

from touchfield.codec.paper.spec import PaperSpec
from touchfield.codec.registry import coder, field_decoder, field_encoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.compute.executor_kinds import TaskExecutor
from touchfield.compute.executors import in_order
from touchfield.compute.threads import Progress, silent
from touchfield.errors import InvalidArgument, is_finite, with_notes
from touchfield.filters.resample import interpolate
from touchfield.measure.fidelity import FidelityMeter
from touchfield.medium import ForceField
from touchfield.pipeline.preparation import prepare
from touchfield.pipeline.source import Openable, open_scene
from touchfield.pipeline.spec import NO_FLOOR_N, EncodeSpec
from touchfield.sources.scene import Scene
from touchfield.viewer.page import titled_figure, write_png

_BITS: Final = {"bit": 1, "kbit": 1_000, "Mbit": 1_000_000, "B": 8, "kB": 8_000, "MB": 8_000_000}
_COLOURS: Final = {
    "touch mask": "#0072b2",
    "touch mask-direction": "#009e73",
    "touch nmse": "#e69f00",
    "paper": "0.45",
}
_SHAPES: Final = "os^Dv<>p"
_SIZE_INCH: Final = (9.5, 5.6)
_BUDGET: Final = re.compile(r"(\d+(?:\.\d*)?|\.\d+)\s*(?:(bit|kbit|Mbit|B|kB)/s|(B|kB|MB))")
_PAIRS: Final = 3
_SEGMENT_BYTES: Final = 60  # frame, checksum and index entry of a segment
_FILE_BYTES: Final = 1340  # head, provenance and end of a file, about
_MIN_MASK_FRACTION: Final = 0.95  # with fewer voxels within the mask, the choice has a note


@dataclass(frozen=True)
class Budget:
    """A budget, in bits per second of a moving medium or in bytes of the whole file."""

    bits_per_s: float | None = None
    bytes: float | None = None

    def __post_init__(self) -> None:
        amounts = [amount for amount in (self.bits_per_s, self.bytes) if amount is not None]
        if len(amounts) != 1 or not (is_finite(amounts[0]) and amounts[0] > 0):
            raise InvalidArgument("budget", repr(self), "bits a second or bytes, one of both, above 0")

    def of(self, frames: int, rate_hz: float) -> tuple[float, str]:
        """Return the amount and its unit: "bytes" for a single frame, else "bit/s".

        For a single frame, a budget in bits per second is that of one second.
        """
        is_static = frames == 1
        seconds = 1.0 if is_static else frames / rate_hz
        size = (self.bits_per_s or 0.0) * seconds / 8 if self.bytes is None else self.bytes
        return (size, "bytes") if is_static else (self.bits_per_s or 8 * size / seconds, "bit/s")


def parse_budget(text: str) -> Budget:
    """Parse a budget such as ``64kbit/s`` or ``60kB``.

    Units are bit/s, kbit/s, Mbit/s, B/s, kB/s, and B, kB, MB.
    """
    parts = _BUDGET.fullmatch(text.strip())
    if parts is None or not float(parts[1]) > 0:
        units = "bit/s, kbit/s, Mbit/s, B/s, kB/s, or of bytes B, kB, MB"
        raise InvalidArgument(
            "--budget", repr(text), f"a positive number and one of {units}: 64kbit/s or 60kB"
        )
    bits = float(parts[1]) * _BITS[parts[2] or parts[3]]
    return Budget(bits_per_s=bits) if parts[2] else Budget(bytes=bits / 8)


@dataclass(frozen=True)
class PlanGrid:
    """The settings to try.

    Raises InvalidArgument if there is no lattice or no setting.

    `nw` are the n_w of the lattices (an array has its own lattice). `k` are Weber fractions of coder `touch`
    in the modes "mask" and "mask-direction"; F_0 is scaled in proportion. `step_n` are steps of its mode
    "nmse", newtons. `directions` (codebooks, N_d), `paper_k` (Weber fractions) and `nq` (n_q) are tried in
    all combinations with coder `paper`.
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
            raise InvalidArgument(
                "plan", "no setting to try", "a lattice, and a k, a step or a direction codebook"
            )

    @property
    def coarsest(self) -> PlanGrid:
        """The cheapest of these settings.

        It has the coarsest lattice, the weakest bound and the largest step.
        """
        greatest = {
            name: (max(axis),) for name in ("k", "step_n", "paper_k") if (axis := getattr(self, name))
        }
        return replace(self, nw=(min(self.nw),), nq=self.nq and (min(self.nq),), **greatest)

    def specs(self, base: EncodeSpec, fraction: float = 1.0) -> list[EncodeSpec]:
        """Return every setting on the lattice of `base`.

        The Weber fractions of coder `touch` are multiplied by `fraction`.
        """
        touch = base.touch
        masks = [replace(touch, k=k, f0_n=touch.f0_n * k / touch.k) for k in (fraction * k for k in self.k)]
        coders = [
            replace(coder_spec, mode=mode) for mode in ("mask", "mask-direction") for coder_spec in masks
        ]
        coders += [replace(touch, mode="nmse", step_n=step) for step in self.step_n]
        length = touch.segment_frames or PaperSpec().segment_frames
        papers = [
            PaperSpec(k=k, nq=nq, directions=d, segment_frames=length)
            for k, nq, d in product(self.paper_k, self.nq, self.directions)
        ]
        return [
            *(replace(base, touch=coder_spec) for coder_spec in coders),
            *(replace(base, coder="paper", touch=TouchSpec(), paper=coder_spec) for coder_spec in papers),
        ]


@dataclass(frozen=True)
class Trial:
    """One setting, as an argument of `touchfield.pipeline.encode`, and its result.

    `file_bytes` is the size of the file of a static medium, or of a segment of `frames` in a long stream of a
    moving one. `nmse`, sum |e|^2 / sum |F|^2, and `mask_fraction`, the fraction of the voxels within the
    mask, are measured on the finest lattice.
    """

    spec: EncodeSpec
    file_bytes: int
    frames: int
    nmse: float
    rate_hz: float = 1.0
    mask_fraction: float = 1.0

    @property
    def bits_per_frame(self) -> float:
        """R, bits per frame."""
        return 8 * self.file_bytes / self.frames

    @property
    def bits_per_s(self) -> float:
        """R as a rate, bits per second."""
        return self.bits_per_frame * self.rate_hz

    @property
    def nmse_db(self) -> float:
        """The NMSE in decibels; -inf without error."""
        return 10 * math.log10(self.nmse) if self.nmse > 0 else -math.inf

    @property
    def kind(self) -> str:
        """The coder, and its mode."""
        return "paper" if self.spec.coder == "paper" else f"touch {self.spec.touch.mode}"

    @property
    def settings(self) -> dict[str, Any]:
        """The settings of the coder that were varied, by the names of their options."""
        if self.spec.coder == "paper":
            names = ["k", "nq", "directions"]
        else:
            names = ["mode", "step_n"] if self.spec.touch.mode == "nmse" else ["mode", "k", "f0_n"]
        return {name: getattr(self.spec.coding, name) for name in names}

    def summary(self) -> dict[str, Any]:
        """Return the trial as a dictionary with stable keys.

        A setting that the coder or its mode does not have is None.
        """
        return {
            "nw": self.spec.nw,
            "coder": self.spec.coder,
            **dict.fromkeys(("mode", "k", "f0_n", "step_n", "nq", "directions")),
            **self.settings,
            "file_bytes": self.file_bytes,
            "bits_per_frame": self.bits_per_frame,
            "nmse": self.nmse,
            "nmse_db": self.nmse_db if self.nmse > 0 else None,
            "mask_kept": self.mask_fraction,
        }

    @property
    def options(self) -> str:
        """The options of `touchfield encode` for this setting."""
        options = [] if self.spec.nw is None else [f"--nw {self.spec.nw}"]
        if self.spec.coder == "paper":
            options.append("--coder paper")
        for key, value in self.settings.items():
            if value != "mask":
                options.append(
                    f"--{key.replace('_', '-')} {value if isinstance(value, str) else f'{value:g}'}"
                )
        return " ".join(options)


@dataclass(frozen=True)
class Plan:
    """All settings that were tried, in order, and the best within a budget.

    `k` and `f0_n` are the mask of `Trial.mask_fraction`; `unit` is the unit of the budget: "bit/s", or
    "bytes" for a static medium. Raises InvalidArgument, which names the cheapest setting, if none is within
    the budget.
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
            cheapest = min(self.trials, key=self.cost)
            nearest = (
                f"it takes at least {self.cost(cheapest):.0f} {self.unit}, the nearest ({cheapest.options})"
            )
            raise InvalidArgument(f"--budget of {self.budget:g} {self.unit} is too small: {nearest}")

    def cost(self, trial: Trial) -> float:
        """Return the cost of a trial in the unit of the budget: bits per second, or bytes."""
        return trial.bits_per_s if self.unit == "bit/s" else float(trial.file_bytes)

    def is_within(self, trial: Trial) -> bool:
        """Return True if a trial is within the budget."""
        return self.cost(trial) <= self.budget

    def front(self) -> tuple[Trial, ...]:
        """Return the Pareto front in size and NMSE, the smallest first.

        Of equal settings it has the first one tried.
        """
        front: list[Trial] = []
        for trial in sorted(self.trials, key=lambda t: (t.bits_per_s, t.nmse)):
            if not front or trial.nmse < front[-1].nmse:
                front.append(trial)
        return tuple(front)

    @property
    def choice(self) -> Trial:
        """The setting with the least NMSE within the budget."""
        return next(t for t in reversed(self.front()) if self.is_within(t))

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on a choice outside the mask, and on the cheapest setting within it."""
        if self.choice.mask_fraction >= _MIN_MASK_FRACTION:
            return ()
        message = f"only {100 * self.choice.mask_fraction:.3g} % of the voxels are within the mask"
        note = f"the choice is beyond the bound: {message}"
        keeping = [t for t in self.trials if t.mask_fraction >= _MIN_MASK_FRACTION]
        if not keeping:
            return (f"{note}; no setting that was tried keeps it (more --nw, a smaller --k)",)
        cheapest = min(keeping, key=self.cost)
        return (f"{note}; {cheapest.options} keeps it, for {amount(self.cost(cheapest), self.unit)}",)

    @property
    def multiplier(self) -> float | None:
        """lambda at the choice, bits per second (or bytes) per unit of NMSE.

        The value is None if it is undefined.

        It is the slope of the front's convex hull: R + lambda D is minimal at both ends of that edge.
        """

        def slope(a: Trial, b: Trial) -> float:
            return (a.nmse - b.nmse) / (self.cost(b) - self.cost(a))

        hull: list[Trial] = []
        for t in self.front():
            while len(hull) > 1 and slope(hull[-2], hull[-1]) <= slope(hull[-2], t):
                hull.pop()
            hull.append(t)
        at = self.cost(self.choice)
        edges = [(a, b) for a, b in pairwise(hull) if self.cost(a) <= at <= self.cost(b)]
        return 1 / slope(*edges[-1]) if edges else None

    def summary(self) -> dict[str, Any]:
        """Return the plan as a dictionary with stable keys.

        A static medium has bytes instead of bits per second.
        """
        is_rate = self.unit == "bit/s"
        return {
            "source": self.source,
            "budget_bits_per_s" if is_rate else "budget_bytes": self.budget,
            "frames_tried": self.frames_tried,
            "k": self.k,
            "f0_n": self.f0_n,
            "lambda_bits_per_s" if is_rate else "lambda_bytes": self.multiplier,
            "chosen": self.trials.index(self.choice),
            "encode_options": self.choice.options,
            "front": [self.trials.index(t) for t in self.front()],
            "trials": [t.summary() | ({"bits_per_s": t.bits_per_s} if is_rate else {}) for t in self.trials],
        }

    def draw(self, path: str | Path) -> None:
        """Draw NMSE over the cost, the Pareto front, the budget and the choice, as PNG."""
        choice = self.choice
        title = f"{self.source}: {choice.options} for {amount(self.budget, self.unit)}"
        figure = titled_figure("the picture of a plan", title, *_SIZE_INCH)
        panel = figure.subplots()
        nws = sorted({t.spec.nw or 0 for t in self.trials})
        drawn = [t for t in self.trials if t.nmse > 0]
        for trial in drawn:
            shape = _SHAPES[nws.index(trial.spec.nw or 0) % len(_SHAPES)]
            panel.plot(self.cost(trial), trial.nmse_db, shape, ms=6, color=_COLOURS[trial.kind], zorder=2)
        front = [t for t in self.front() if t.nmse > 0]
        panel.plot([self.cost(t) for t in front], [t.nmse_db for t in front], color="black", lw=1, zorder=1)
        panel.axvline(self.budget, color="0.3", lw=1, ls="--", zorder=0)
        if choice.nmse > 0:
            at = self.cost(choice), choice.nmse_db
            panel.plot(*at, "o", ms=15, mfc="none", mec="black", mew=1.6)
            cost = f"{amount(at[0], self.unit)}, {100 * choice.mask_fraction:.1f} % in the mask"
            panel.annotate(
                f"{choice.kind}, {choice.options}\n{cost}",
                at,
                (12, 12),
                textcoords="offset points",
                fontsize=8,
                parse_math=False,
            )
        panel.set_xscale("log")
        panel.set_xlabel(
            f"{self.unit} (dashed: the budget; line: the frontier; ring: the choice)", fontsize=8
        )
        panel.set_ylabel("NMSE, dB, against the finest lattice", fontsize=8)
        panel.tick_params(labelsize=8)
        panel.grid(color="0.92")
        panel.spines[["top", "right"]].set_visible(False)
        for kind in dict.fromkeys(t.kind for t in drawn):
            panel.plot([], [], "o", ms=6, color=_COLOURS[kind], label=kind)
        for i, nw in enumerate(nws):
            panel.plot([], [], _SHAPES[i % len(_SHAPES)], ms=6, color="0.2", mfc="none", label=f"nw {nw}")
        panel.legend(fontsize=8, frameon=False)
        write_png(figure, Path(path))


def plan(
    source: Openable,
    budget: float | str | Budget,
    spec: EncodeSpec | None = None,
    search: PlanGrid | None = None,
    report: Progress = silent,
    executor: TaskExecutor | None = None,
) -> Plan:
    """Encode a few frames of a source with every setting; choose the best within a budget.

    Frames are encoded as voxels. `budget` is a number of bits per second, or text such as "64kbit/s"
    (`parse_budget`). `spec` must have coder `touch`: its k and F_0 are the reported mask, and its effort is
    that of every trial. ``report(done, total)`` counts settings; with `executor` its workers try them. Raises
    TouchfieldError if a setting is impossible, the frames have no force, or no setting is within the budget;
    the message then names the cheapest. The cheapest settings are tried first, so that this is reported
    early.
    """
    spec, search = spec or EncodeSpec(), search or PlanGrid()
    budget = parse_budget(budget) if isinstance(budget, str) else budget
    budget = budget if isinstance(budget, Budget) else Budget(bits_per_s=budget)
    if spec.coder != "touch":
        raise InvalidArgument("plan", f"coder {spec.coder}", "coder touch; the paper's is tried, too")
    base = replace(spec, representation="voxel", touch=replace(spec.touch, mode="mask"))
    scene = open_scene(source, spec.source)

    def searched(grid: PlanGrid, report: Progress) -> Plan:
        total, lattice = 0, None

        def tries() -> Iterator[tuple[Lattice, EncodeSpec]]:
            nonlocal total, lattice
            for lattice in _lattices(scene, base, sorted(grid.nw)):
                # the coarsest lattice alone may miss a thin scene that the finest one has
                if grid is search and not any(field.support_count for field in lattice.reference):
                    error = InvalidArgument("source of a search", "frames without a force", "a force")
                    raise with_notes(error, (*scene.notes, *scene.late_notes()))
                specs = grid.specs(lattice.spec, lattice.spec.touch.k / spec.touch.k)
                total = len(specs) * (1 if lattice.is_array else len(grid.nw))
                yield from ((lattice, one) for one in specs)

        trials: list[Trial] = []
        for trial in in_order(_trial, tries(), executor=executor):
            trials.append(trial)
            report(len(trials), total)
        assert lattice is not None
        amount, unit = budget.of(lattice.frames, lattice.rate_hz)
        touch = lattice.spec.touch
        return Plan(tuple(trials), touch.k, touch.f0_n, amount, str(source), len(lattice.reference), unit)

    if search.coarsest != search:
        searched(search.coarsest, silent)  # rejects an impossible budget before a finer lattice is made
    return searched(search, report)


class Lattice(NamedTuple):
    """The frames to try on one lattice, and the same frames on the finest; can be pickled."""

    spec: EncodeSpec
    is_array: bool
    frames: int
    rate_hz: float
    fields: tuple[ForceField, ...]
    reference: tuple[ForceField, ...]


def _lattices(scene: Scene, base: EncodeSpec, nws: Sequence[int]) -> Iterator[Lattice]:
    """Yield the lattices of several n_w; an array has only its own."""
    finest = prepare(scene, replace(base, nw=max(nws)))
    reference = tuple(finest.medium[i] for i in chain.from_iterable(_pairs(len(finest.medium))))
    is_array = finest.device.is_array
    for nw in nws[:1] if is_array else nws:
        lattice_spec = replace(finest.spec, nw=None if is_array else nw)
        is_finest = nw == max(nws) or is_array
        medium = finest.medium if is_finest else prepare(scene, lattice_spec).medium
        count = len(medium)
        fields = reference if is_finest else tuple(medium[i] for i in chain.from_iterable(_pairs(count)))
        yield Lattice(lattice_spec, is_array, count, medium.rate_hz, fields, reference)


def _pairs(count: int) -> tuple[tuple[int, ...], ...]:
    """Return pairs of consecutive frames, spread over all frames.

    A single frame is returned alone.
    """
    if count == 1:
        return ((0,),)
    pair_count = min(_PAIRS, count // 2)
    starts = [(2 * i + 1) * (count - 2) // (2 * pair_count) for i in range(pair_count)]
    return tuple((start, start + 1) for start in starts)


def _trial(setting: tuple[Lattice, EncodeSpec]) -> Trial:
    """Encode and decode with a setting, and measure by the mask of the requested k and F_0."""
    lattice, spec = setting
    grid, fields, reference = lattice.fields[0].grid, iter(lattice.fields), iter(lattice.reference)
    encoder = field_encoder(grid, coder(spec.coder).resolve(spec.coding, lattice.is_array))
    decoder = field_decoder(spec.coder, grid, encoder.parameters)
    length = min(spec.segment_frames_at(lattice.rate_hz), lattice.frames)
    mask = lattice.spec.touch
    meter, bits, pairs = FidelityMeter(mask.k, max(mask.f0_n, NO_FLOOR_N)), 0.0, _pairs(lattice.frames)
    for pair in pairs:
        coded = encoder.encode_segment([next(fields) for _ in pair])
        # a segment of a long stream: one independent frame like the first of the pair, and others with the
        # cost of the second
        bits += 8 * len(coded.body) + (length - len(pair)) * sum(
            frame.bits.total for frame in coded.frames[1:]
        )
        for field in decoder.frames(coded.body, len(pair)):
            original = next(reference)
            same = field.grid.shape == original.grid.shape
            meter.add(original, field if same else interpolate(field, original.grid, border="cell"))
    size = round(_SEGMENT_BYTES + _FILE_BYTES * length / lattice.frames + bits / 8 / len(pairs))
    nmse = 0.0 if meter.nmse_db is None else 10 ** (meter.nmse_db / 10)
    return Trial(spec, size, length, nmse, lattice.rate_hz, 1 - meter.mask_violation_share)


def amount(cost: float, unit: str) -> str:
    """Return a cost as text."""
    if unit == "bytes":
        return f"{cost:,.0f} bytes"
    size, name = next(((s, n) for s, n in ((1e6, "Mbit/s"), (1e3, "kbit/s")) if cost >= s), (1.0, "bit/s"))
    return f"{cost / size:.4g} {name}"
