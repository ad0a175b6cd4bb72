"""The settings search: min R + lambda D over the lattice and what is asked of the coder (paper section 4).

R is the size in bits a frame, D either the NMSE (the ratio of energies of eq. 10, not in dB) or how many voxels are
beyond the mask. lambda is what one unit of D is worth in bits a frame: 0 asks for the smallest file, and a great one
for the best field. `optimise` is the paper's own search, over (n_w, k, n_q, N_d), and weighs whole files;
`touchfield.job.plan` is the search for a budget.

Settings of different n_w are compared on one lattice, that of the greatest n_w: a coarser stream is decoded and
interpolated there as a receiver does, so that what a coarse lattice leaves out counts. The mask is the same for all,
that of the spec, whatever k the coder took.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any, Final, NamedTuple

from touchfield.codec.touch.spec import TouchSpec
from touchfield.errors import InvalidArgument
from touchfield.filters.resample import interpolated
from touchfield.job.encode import encode_prepared, in_order, provenance_of
from touchfield.job.prepare import Prepared, open_scene, prepare
from touchfield.job.spec import DEFAULT_F0_N, NO_FLOOR_N, EncodeSpec, Report, silent
from touchfield.measure.fidelity import FidelityMeter
from touchfield.medium import ForceField, HapticMedium
from touchfield.sources.scene import Scene
from touchfield.stream.opened import open_stream

__all__ = ["DISTORTIONS", "Lattice", "Optimisation", "SearchGrid", "Trial", "lattices", "optimise", "tried"]

DISTORTIONS: Final = ("nmse", "beyond_mask")

FRAMES: Final = 2
"""Frames that are tried where none are named: one alone, and one that differs."""

MOST_TRIALS: Final = 4096


@dataclass(frozen=True)
class Trial:
    """One setting, and what came of it.

    Attributes
    ----------
    spec : EncodeSpec
        What `touchfield.job.encode` takes, to code the whole source so.
    file_bytes : int
        The whole file of the frames that were tried; in a plan that of a still medium, or a segment of a long stream.
    frames : int
        In these bytes.
    nmse : float
        sum |e|^2 / sum |F|^2 on the finest lattice.
    beyond_mask : float
        Voxels that differ by more than a hand can feel, over those that held a force on that lattice: one number for
        every n_w, so that a coarse lattice does not gain by spreading what it lost. It can exceed 1.
    rate_hz : float
        Frames a second.
    mask_kept : float
        Share of the voxels whose error no hand can feel, on the finest lattice.
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

    def distortion(self, by: str) -> float:
        """D, by one of `DISTORTIONS`; InvalidArgument if it is unknown."""
        if by not in DISTORTIONS:
            raise InvalidArgument("distortion", repr(by), " or ".join(DISTORTIONS))
        return self.nmse if by == "nmse" else self.beyond_mask

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
class Optimisation:
    """All settings that were tried, in the order of the search.

    Attributes
    ----------
    trials : tuple of Trial
    k, f0_n : float
        The mask of `Trial.beyond_mask` and `Trial.mask_kept`.
    """

    trials: tuple[Trial, ...]
    k: float
    f0_n: float

    def front(self, by: str = "nmse") -> tuple[Trial, ...]:
        """The Pareto front: settings that no other beats in both size and distortion, the smallest file first.

        Of settings that are equal in both the first tried is taken.
        """
        front: list[Trial] = []
        for trial in sorted(self.trials, key=lambda t: (t.bits_per_s, t.distortion(by))):
            if not front or trial.distortion(by) < front[-1].distortion(by):
                front.append(trial)
        return tuple(front)

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
        """The best field whose file has at most so many bytes; InvalidArgument names the smallest if none has."""
        fitting = [t for t in self.front(by) if t.file_bytes <= most_bytes]
        if not fitting:
            nearest = self.front(by)[0]
            least = f"at least {nearest.file_bytes}, the nearest ({nearest.options})"
            raise InvalidArgument("target of bytes", f"{most_bytes:g}", least)
        return fitting[-1]

    def within_distortion(self, most: float, by: str = "nmse") -> Trial:
        """The smallest file whose distortion is at most so great; an NMSE as a ratio, not in dB.

        InvalidArgument names the best if there is none.
        """
        for trial in self.front(by):
            if trial.distortion(by) <= most:
                return trial
        nearest = self.front(by)[-1]
        least = f"at least {nearest.distortion(by):.6g}, the nearest ({nearest.options})"
        raise InvalidArgument(f"target of {by}", f"{most:g}", least)

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        return {
            "k": self.k,
            "f0_n": self.f0_n,
            "trials": [t.summary() for t in self.trials],
            **{f"front_{by}": [self.trials.index(t) for t in self.front(by)] for by in DISTORTIONS},
        }


class Lattice(NamedTuple):
    """The frames to try on one lattice, and the same frames on the finest."""

    prepared: Prepared
    fields: tuple[ForceField, ...]
    reference: tuple[ForceField, ...]


def lattices(
    scene: Scene, base: EncodeSpec, nws: Sequence[int], numbers: Callable[[int], Sequence[int]]
) -> Iterator[Lattice]:
    """The lattices of several n_w, each made once; `numbers` of the count of frames are those to try.

    An array has its own lattice: of several n_w the first is taken. InvalidArgument if no frame holds a force.
    """
    finest = prepare(scene, replace(base, nw=max(nws)))
    wanted = numbers(len(finest.medium))
    reference = tuple(finest.medium[i] for i in wanted)
    if not any(f.support_count for f in reference):
        raise InvalidArgument("source of a search", f"{len(reference)} frames without a force", "a force")
    for nw in nws[:1] if finest.device.is_array else nws:
        asked = replace(base, nw=nw)
        is_finest = nw == max(nws) or finest.device.is_array
        prepared = replace(finest, spec=asked) if is_finest else prepare(scene, asked)
        fields = reference if is_finest else tuple(prepared.medium[i] for i in wanted)
        yield Lattice(prepared, fields, reference)


Code = Callable[[Lattice, EncodeSpec], tuple[int, int, list[ForceField]]]
"""Codes the fields of a lattice: bytes, the frames that these are of, and the decoded fields."""


def tried(
    tries: Iterator[tuple[Lattice, EncodeSpec]], code: Code, mask: tuple[float, float], report: Callable[[int], None]
) -> tuple[Trial, ...]:
    """Every setting coded, decoded and measured; `mask` is k and F_0, and `report` gets how many are done."""

    def trial(one: tuple[Lattice, EncodeSpec]) -> Trial:
        lattice, spec = one
        size, frames, decoded = code(lattice, spec)
        meter = FidelityMeter(mask[0], max(mask[1], NO_FLOOR_N))
        for original, field in zip(lattice.reference, decoded, strict=True):
            same = field.grid.shape == original.grid.shape
            meter.add(original, field if same else interpolated(field, original.grid, border="cell"))
        nmse = 0.0 if meter.nmse_db is None else 10 ** (meter.nmse_db / 10)
        beyond = meter.mask_violations / max(1, meter.supported_voxels)
        rate_hz = lattice.prepared.medium.rate_hz
        return Trial(spec, size, frames, nmse, beyond, rate_hz, 1 - meter.mask_violation_share)

    trials: list[Trial] = []
    for done in in_order(trial, tries):
        trials.append(done)
        report(len(trials))
    return tuple(trials)


@dataclass(frozen=True)
class SearchGrid:
    """The settings to try, every one with every other; the paper's own by default (section 5.2).

    `directions` are codebooks, for N_d. InvalidArgument if an axis is empty, or there are more than 4096 settings.
    """

    nw: tuple[int, ...] = (5, 6)
    k: tuple[float, ...] = (0.01, 0.1, 0.25)
    nq: tuple[int, ...] = (4, 6, 8)
    directions: tuple[str, ...] = ("ico3", "ico5")

    def __post_init__(self) -> None:
        for name in ("nw", "k", "nq", "directions"):
            object.__setattr__(self, name, tuple(dict.fromkeys(getattr(self, name))))
        if not 1 <= len(self) <= MOST_TRIALS:
            raise InvalidArgument("search grid", f"{len(self)} settings", f"1 to {MOST_TRIALS}")

    def __len__(self) -> int:
        return len(self.nw) * len(self.k) * len(self.nq) * len(self.directions)


def optimise(
    source: str | Path | Scene,
    spec: EncodeSpec | None = None,
    search: SearchGrid | None = None,
    report: Report = silent,
) -> Optimisation:
    """Code a source under every setting of a grid, as voxels, and measure size and fidelity.

    Parameters
    ----------
    source : path or Scene
    spec : EncodeSpec, optional
        Everything but the coder, which is `paper`, n_w, k, n_q and the directions. Its ``paper.k`` is the Weber
        fraction of the mask; of its frames, or of the first two where it names none, each setting makes a file.
    search : SearchGrid, optional
    report : callable
        ``report(done, total)`` in settings.

    Raises
    ------
    TouchfieldError
        If a setting is not possible, or the frames hold no force.
    """
    spec, search = spec or EncodeSpec(), search or SearchGrid()
    if spec.coder != "paper":
        spec = replace(spec, coder="paper", touch=TouchSpec())
    base = replace(spec, representation="voxel")
    coders = [
        replace(spec.paper, k=k, nq=nq, directions=d) for k, nq, d in product(search.k, search.nq, search.directions)
    ]
    total = len(coders)

    def tries() -> Iterator[tuple[Lattice, EncodeSpec]]:
        nonlocal total
        scene = open_scene(source, spec.source)
        frames = (lambda count: range(count)) if spec.frames else (lambda count: range(min(FRAMES, count)))
        for lattice in lattices(scene, base, search.nw, frames):
            total = len(coders) * (1 if lattice.prepared.device.is_array else len(search.nw))
            yield from ((lattice, replace(lattice.prepared.spec, paper=paper)) for paper in coders)

    trials = tried(tries(), _as_file, (spec.paper.k, DEFAULT_F0_N), lambda done: report(done, total))
    return Optimisation(trials, spec.paper.k, DEFAULT_F0_N)


def _as_file(lattice: Lattice, spec: EncodeSpec) -> tuple[int, int, list[ForceField]]:
    was = lattice.prepared.medium
    medium = HapticMedium.from_frames(lattice.fields, was.rate_hz, was.axes)
    prepared = replace(lattice.prepared, medium=medium, spec=spec, source=None)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "trial.touch"
        size = encode_prepared(prepared, path, provenance_of("trial", prepared)).file_bytes
        with open_stream(path) as opened:
            return size, len(lattice.fields), list(opened.medium)
