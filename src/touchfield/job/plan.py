"""Which lattice and which settings of the coders spend a bit rate best (paper section 4, "optimisation").

min R + lambda D over (n_w, k, directions): R is the bit rate of a long stream, D the NMSE against the field on the
finest lattice tried, where what a coarser stream holds is interpolated as a receiver does. A few pairs of frames that
follow each other, spread over the scene, are coded under every setting: the first tells what a frame alone takes, the
second what one that follows takes.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from touchfield.codec.paper.spec import PaperSpec
from touchfield.codec.registry import coder, field_decoder, field_encoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.errors import InvalidArgument
from touchfield.filters.interpolate import interpolated
from touchfield.job.in_order import in_order
from touchfield.job.plan_choice import Plan, PlanTrial
from touchfield.job.prepare import Prepared, open_scene, prepare
from touchfield.job.spec import NO_FLOOR_N, EncodeSpec, Report, silent
from touchfield.measure.fidelity import FidelityMeter
from touchfield.sources.scene import Scene

if TYPE_CHECKING:
    from touchfield.codec.segment import CodedSegment
    from touchfield.medium import ForceField, Grid

__all__ = ["PlanGrid", "parse_rate", "plan"]

_UNITS: Final = {"bit": 1, "kbit": 1_000, "Mbit": 1_000_000, "B": 8, "kB": 8_000}
_RATE: Final = re.compile(r"(\d+(?:\.\d*)?|\.\d+)\s*(bit|kbit|Mbit|B|kB)/s")
_PLACES: Final = 3
_SEGMENT_BYTES: Final = 60
"""Frame, checksum and index entry of a segment."""
_FILE_BYTES: Final = 1200
"""Head, provenance and end of a file, about."""


def parse_rate(text: str) -> float:
    """A bit rate such as ``64kbit/s``, in bits a second; the units are bit/s, kbit/s, Mbit/s, B/s and kB/s.

    Raises
    ------
    InvalidArgument
        If it is no positive number with one of them.
    """
    found = _RATE.fullmatch(text.strip())
    rate = float(found[1]) * _UNITS[found[2]] if found else 0.0
    if not rate > 0:
        units = ", ".join(f"{unit}/s" for unit in _UNITS)
        raise InvalidArgument("--budget", repr(text), f"a positive number and one of {units}, such as 64kbit/s")
    return rate


@dataclass(frozen=True)
class PlanGrid:
    """The settings to try.

    Parameters
    ----------
    nw : tuple of int
        n_w of the lattices; an array has its own.
    k : tuple of float
        Weber fractions of coder `touch`, F_0 in proportion, in the modes "mask" and "mask-direction".
    step_n : tuple of float
        Steps of its mode "nmse", newtons.
    directions : tuple of str
        Codebooks of coder `paper`, as a point of comparison.

    Raises
    ------
    InvalidArgument
        If there is no lattice or no setting.
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


def plan(
    source: str | Path | Scene,
    budget_bits_per_s: float,
    spec: EncodeSpec | None = None,
    search: PlanGrid | None = None,
    report: Report = silent,
) -> Plan:
    """Code a few frames of a source, as voxels, under every setting, and choose the best within a bit rate.

    Parameters
    ----------
    source : path or Scene
    budget_bits_per_s : float
    spec : EncodeSpec, optional
        Of coder `touch`; its k and F_0 are the mask that is reported, its effort that of every trial.
    search : PlanGrid, optional
    report : callable
        ``report(done, total)`` in settings.

    Raises
    ------
    TouchfieldError
        If a setting is not possible, the frames hold no force, or nothing is within the budget; the message then
        names what takes least.
    """
    spec, search = spec or EncodeSpec(), search or PlanGrid()
    if spec.coder != "touch":
        raise InvalidArgument("plan", f"coder {spec.coder}", "coder touch; the paper's is tried, too")
    asked = replace(spec, representation="voxel", touch=replace(spec.touch, mode="mask"))
    scene = open_scene(source, spec.source)
    finest = prepare(scene, replace(asked, nw=max(search.nw)))
    pairs = _pairs(len(finest.medium))
    reference = _frames(finest, pairs)
    if not any(f.support_count for f in reference):
        raise InvalidArgument("source to plan for", f"{len(reference)} frames without a force", "a force")
    nws = sorted(search.nw)[:1] if finest.device.is_array else sorted(search.nw)
    total = len(nws) * len(search.specs(asked))
    trials: list[PlanTrial] = []
    for trial in in_order(lambda work: work.trial(), _work(scene, asked, nws, search, finest, pairs, reference)):
        trials.append(trial)
        report(len(trials), total)
    return Plan(tuple(trials), spec.touch.k, spec.touch.f0_n, budget_bits_per_s, str(source), len(reference))


@dataclass(frozen=True)
class _Work:
    """One setting to try on the frames of its lattice."""

    spec: EncodeSpec
    is_array: bool
    rate_hz: float
    frame_count: int
    pairs: tuple[tuple[int, ...], ...]
    fields: tuple[ForceField, ...]
    reference: tuple[ForceField, ...]
    mask: tuple[float, float]

    def trial(self) -> PlanTrial:
        """Code, decode and measure."""
        spec = self.spec
        coding = coder(spec.coder).resolve(spec.coding, self.is_array)
        encoder = field_encoder(self.fields[0].grid, coding)
        decoder = field_decoder(spec.coder, self.fields[0].grid, encoder.parameters)
        meter = FidelityMeter(self.mask[0], max(self.mask[1], NO_FLOOR_N))
        coded: list[CodedSegment] = []
        at = 0
        for pair in self.pairs:
            own = slice(at, at + len(pair))
            coded.append(encoder.encode_segment(self.fields[own]))
            for original, decoded in zip(self.reference[own], decoder.frames(coded[-1].body, len(pair)), strict=True):
                meter.add(original, _on_grid(decoded, original.grid))
            at += len(pair)
        length = min(spec.segment_frames_at(self.rate_hz), self.frame_count)
        size = _SEGMENT_BYTES + _FILE_BYTES * length / self.frame_count + _segment_bytes(coded, length)
        nmse = 0.0 if meter.nmse_db is None else 10 ** (meter.nmse_db / 10)
        beyond = meter.mask_violations / max(1, meter.supported_voxels)
        return PlanTrial(spec, round(size), length, nmse, beyond, self.rate_hz, 1 - meter.mask_violation_share)


def _work(
    scene: Scene,
    asked: EncodeSpec,
    nws: Sequence[int],
    search: PlanGrid,
    finest: Prepared,
    pairs: tuple[tuple[int, ...], ...],
    reference: tuple[ForceField, ...],
) -> Iterator[_Work]:
    """Every setting, n_w by n_w, so that the fields of one lattice are made once."""
    mask = asked.touch.k, asked.touch.f0_n
    for nw in nws:
        own = replace(asked, nw=nw)
        is_finest = nw == finest.spec.nw or finest.device.is_array
        prepared = finest if is_finest else prepare(scene, own)
        medium = prepared.medium
        fields = reference if is_finest else _frames(prepared, pairs)
        for spec in search.specs(own):
            yield _Work(spec, prepared.device.is_array, medium.rate_hz, len(medium), pairs, fields, reference, mask)


def _pairs(count: int) -> tuple[tuple[int, ...], ...]:
    """Frames that follow each other, spread over all: pairs, or the one frame that there is."""
    if count == 1:
        return ((0,),)
    places = min(_PLACES, count // 2)
    starts = [(2 * i + 1) * (count - 2) // (2 * places) for i in range(places)]
    return tuple((start, start + 1) for start in starts)


def _frames(prepared: Prepared, pairs: tuple[tuple[int, ...], ...]) -> tuple[ForceField, ...]:
    return tuple(prepared.medium[i] for pair in pairs for i in pair)


def _on_grid(field: ForceField, grid: Grid) -> ForceField:
    return field if field.grid.shape == grid.shape else interpolated(field, grid, border="cell")


def _segment_bytes(coded: Sequence[CodedSegment], length: int) -> float:
    """The body of a segment of `length` frames: one alone, and the others as costly as the second of a pair."""
    total = 0.0
    for one in coded:
        first = 8 * len(one.body) - sum(frame.bits.total for frame in one.frames[1:])
        total += first + (length - 1) * sum(frame.bits.total for frame in one.frames[1:])
    return total / 8 / len(coded)
