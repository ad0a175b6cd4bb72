"""Measures in bits how much information a medium contains, and how much of it each device renders.

See the paper, sections 3 and 3.1, equations 1 to 3.

medium -> Q -> S -> entropies, coding limits, time      the medium as an information source
medium -> M of a device -> Q -> C, WMR, HIL             the information that a device renders and loses
medium -> curl, work around loops                       whether its forces could give energy to a hand
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import count
from pathlib import Path
from typing import Any, Final

import numpy as np

from touchfield.codec.paper.field_quantiser import DEFAULT_QUANTISER, FieldQuantiserSpec
from touchfield.codec.registry import coder
from touchfield.codec.segment import RAW_BITS_PER_VECTOR
from touchfield.compute.threads import Progress, silent
from touchfield.devices import device
from touchfield.errors import InvalidArgument, SourceError, require_kinds, with_notes
from touchfield.measure.capacity import Capacity, capacity, codomain_bits, paired_ratio
from touchfield.measure.counts import Counts
from touchfield.measure.estimators import ESTIMATORS
from touchfield.measure.field_count import field_counts, shared_counts
from touchfield.measure.information import (
    conditional_entropy,
    entropy,
    mutual_information,
    normalised_mutual_information,
    total_correlation,
    variation_of_information,
)
from touchfield.measure.interaction import contact_counts
from touchfield.measure.limits import CodingLimits, coding_limits
from touchfield.measure.passivity import Passivity, passivity
from touchfield.measure.quantity import FewSamplesWarning, Quantity
from touchfield.medium import HapticMedium
from touchfield.medium.trace import Trace, read_trace
from touchfield.options import option
from touchfield.pipeline.partition import SymbolFrames, map_to_device
from touchfield.pipeline.preparation import prepare
from touchfield.pipeline.source import StreamScene, is_stream
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.scene import Scene
from touchfield.viewer.information import Bar, draw_information

_IN_TIME: Final[tuple[tuple[Callable[..., Quantity], str], ...]] = (
    (conditional_entropy, "H(S_t|S_t-1)"),
    (mutual_information, "I(S_t;S_t-1)"),
    (normalised_mutual_information, "NMI(S_t;S_t-1)"),
    (variation_of_information, "VI(S_t,S_t-1)"),
)


@dataclass(frozen=True)
class Measurement:
    """The result of `measure_medium`.

    `quantiser` is Q as text; `alphabet` is K, the number of its symbols with "no force". `voxels` is the
    number of voxels of one frame, `supported_voxels` the number of voxels with a force after Q in all frames.
    `entropy` is H(S) with the requested weighting, `voxel` over all voxels and `object` over the object
    alone: for the plug-in estimates H_voxel = h2(p) + p H_object holds exactly. `corrected` is `voxel` with
    the correction of Miller and Madow, which shows how reliable the estimate is. `per_frame` is H(W), H_voxel
    times the voxels of a frame. `in_time` has the quantities of consecutive frames, over voxels: H(S_t |
    S_t-1), I(S_t; S_t-1), NMI and the variation of information; it is empty for one frame. `capacities` are
    by device, `passivity` is that of the frame with the largest support, `file_bits` counts all bits of the
    ``.touch`` file. `contacts` is empty unless several traces were measured together; then `entropy` is what
    all of them receive, and `contacts` has the entropy of each ("S1", ...) and "total_correlation", what they
    receive more than once.
    """

    name: str
    quantiser: str
    alphabet: int
    frames: int
    voxels: int
    supported_voxels: int
    entropy: Quantity
    voxel: Quantity
    object: Quantity
    corrected: Quantity
    per_frame: Quantity
    in_time: dict[str, Quantity]
    limits: CodingLimits | None
    capacities: dict[str, Capacity]
    passivity: Passivity | None
    file_bits: int | None
    notes: tuple[str, ...]
    contacts: dict[str, Quantity] = field(default_factory=dict)

    @cached_property
    def occupancy(self) -> float:
        """p, the fraction of voxels whose quantised force is not zero."""
        return self.supported_voxels / (self.frames * self.voxels)

    def summary(self) -> dict[str, Any]:
        """Return the results as a dictionary; its keys are stable."""
        return {
            "medium": self.name,
            **{key: getattr(self, key) for key in ("quantiser", "alphabet", "frames")},
            "voxels_per_frame": self.voxels,
            "supported_voxels": self.supported_voxels,
            "occupancy": self.occupancy,
            "entropy": self.entropy.summary(),
            "entropy_voxel": self.voxel.summary(),
            "entropy_object": self.object.summary(),
            "entropy_voxel_miller_madow": self.corrected.summary(),
            "entropy_frame": self.per_frame.summary(),
            "contacts": {name: q.summary() for name, q in self.contacts.items()},
            "in_time": {name: q.summary() for name, q in self.in_time.items()},
            "coding_limits": None if self.limits is None else self.limits.summary(),
            "capacity": {name: c.summary() for name, c in self.capacities.items()},
            "passivity": None if self.passivity is None else self.passivity.summary(),
            "file_bits": self.file_bits,
        }

    def draw(self, path: str | Path) -> None:
        """Draw the bits of the medium, its coding limits, and each device's fraction, as PNG."""
        title = (
            f"{self.name}: {self.frames} frame{'s' * (self.frames > 1)} of {self.voxels:,} voxels, "
            f"{self.occupancy:.2%} with a force; Q {self.quantiser}, H(W) = {self.per_frame.value:,.0f} "
            "bit/frame"
        )
        draw_information(Path(path), title, "bits per supported voxel", self._bars(), self.capacities)

    def _bars(self) -> list[Bar]:
        """Return bits per supported voxel, from raw numbers to the best limit, with the support's cost."""
        voxels_per_supported = self.frames * self.voxels / self.supported_voxels
        i = self.voxel.interval
        interval = None if i is None else (i.low * voxels_per_supported, i.high * voxels_per_supported)
        bars = [
            Bar("three float32 numbers", float(RAW_BITS_PER_VECTOR)),
            Bar("H(S) over voxels: no neighbours", self.voxel.value * voxels_per_supported, interval),
        ]
        if self.limits is not None:
            for c in self.limits.contexts:
                if c.per_voxel.value > 0 and not c.is_diluted:
                    bars.append(Bar(c.per_voxel.name, c.per_voxel.value * voxels_per_supported))
        if self.file_bits is not None:
            bars.append(
                Bar("this file, everything counted", self.file_bits / self.supported_voxels, is_actual=True)
            )
        return bars


@dataclass(frozen=True)
class MeasureSpec:
    """Options of `measure_medium`; InvalidArgument if one is invalid.

    `quantiser` None selects "distinct" for a ``.touch`` file of coder `paper`, whose forces are codewords,
    and "weber:0.1" otherwise and whenever a device is named. (Coder `touch` has no codewords, and a receiver
    interpolates between those of an object.) `devices` are the profiles whose capacity, WMR and HIL are
    measured; `limits` turns on the coding limits, which take most of the time. `encode` has the options that
    make a medium of a scene; its device is the reference space in which W is sampled. `density` is the number
    of samples of W per axis for one sample of a point device; None is that of the data sheet, no finer than
    W. The paper's W of 10^12 samples has 5 per sample of its device, of 8 10^9.
    """

    quantiser: str | None = option(
        None, "Q: weber:K, uniform:NEWTONS or lloyd-max:BITS, each with /DIRECTIONS; components:NEWTONS."
    )
    over: str = option(
        "voxel",
        "mu: voxel, object, or interaction:TRACE.csv (t_s,x_m,y_m,z_m); of several contacts of a hand: "
        "interaction:ONE.csv,TWO.csv.",
    )
    estimator: str = option("plug-in", f"Estimator of entropy: {', '.join(ESTIMATORS)}.")
    devices: tuple[str, ...] = ()
    limits: bool = True
    encode: EncodeSpec = field(default_factory=EncodeSpec)
    density: float | None = option(
        None, "Samples of W per axis for one of a point device; the paper's has 5. [default: data sheet]"
    )

    def __post_init__(self) -> None:
        require_kinds(self, estimator=ESTIMATORS)
        kind, _, _ = self.over.partition(":")
        is_complete = all(self.trace_paths) and (kind == "interaction") == bool(self.trace_paths)
        if kind not in ("voxel", "object", "interaction") or not is_complete:
            raise InvalidArgument("over", repr(self.over), "voxel, object, or interaction:TRACE.csv")
        if self.density is not None and not 1 <= self.density < 1e6:
            raise InvalidArgument(
                "density", f"{self.density:g}", "1 or more samples of W for one of the device"
            )
        if self.quantiser is not None:
            FieldQuantiserSpec.parse(self.quantiser)

    @property
    def trace_paths(self) -> tuple[str, ...]:
        """The traces of ``interaction:``, separated by commas; a file whose name has commas is one trace."""
        _, _, texts = self.over.partition(":")
        if not texts:
            return ()
        return (texts,) if Path(texts).exists() else tuple(texts.split(","))


def measure_medium(
    source: str | Path | Scene | HapticMedium, spec: MeasureSpec | None = None, report: Progress = silent
) -> Measurement:
    """Measure a medium as an information source, and what devices render of it.

    A ``.touch`` file and a medium are measured as they are; a scene is first made a medium by
    ``spec.encode``. Every entropy is of one random variable, the symbol of a voxel of any frame; `in_time`
    pairs a voxel with itself one frame later. ``report(done, total)`` is called after each step.
    """
    spec = spec or MeasureSpec()
    for profile_name in spec.devices:
        device(profile_name)  # unknown devices are reported before the work starts
    probes = read_contacts(spec.trace_paths)
    medium, name, notes, file_bits, is_of_codewords = _medium(source, spec)
    is_distinct = is_of_codewords and not spec.devices
    quantiser_spec = FieldQuantiserSpec.parse(
        spec.quantiser or ("distinct" if is_distinct else DEFAULT_QUANTISER)
    )
    total = 3 + (len(medium) > 1) + spec.limits + len(spec.devices)
    steps = count()

    def on_step(counts: bool = True) -> None:
        if counts:
            report(next(steps), total)

    on_step()
    quantise = quantiser_spec.fit(medium)
    frames = SymbolFrames(medium, quantise)
    on_step()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FewSamplesWarning)  # each quantity carries the note
        counts = field_counts(frames)
        voxel = entropy(counts["voxel"], estimator=spec.estimator)
        supported = sum(frames.object_counts.values())
        if not supported:
            found, hint = "a medium without any force", "Take other frames, or look at the source."
            if quantise.top_n > 0:
                found, hint = (
                    f"a medium without any force under {quantise.text}",
                    "Take a finer --quantiser.",
                )
            raise with_notes(InvalidArgument(name, found, "a support of at least one voxel", hint), notes)
        on_object = entropy(counts["object"], estimator=spec.estimator)
        corrected = entropy(counts["voxel"], estimator="miller-madow", interval=False)
        entropy_over = on_object if spec.over == "object" else voxel
        contacts: dict[str, Quantity] = {}
        if probes:
            entropy_over, contacts = _met(probes, frames, spec)
        on_step()
        in_time = {}
        if len(frames) > 1:
            both = field_counts(frames[1:], frames[:-1], ("voxel",))["voxel"]  # pairs of frames
            in_time = {
                quantity.__name__: quantity(both, estimator=spec.estimator).of(name=label)
                for quantity, label in _IN_TIME
            }
        on_step(len(frames) > 1)
        limits = coding_limits(frames) if spec.limits else None
        on_step(spec.limits)
        per_frame = voxel.times(medium.grid.voxel_count, "bit/frame", "H(W)")
        capacities = {}
        for device_name in spec.devices:
            capacities[device_name], more = _capacity(
                frames, counts["voxel"], per_frame, device_name, quantiser_spec, spec
            )
            notes += tuple(f"{device_name}: {note}" for note in more)
            on_step()
    energy = passivity(medium[max(sorted(frames.object_counts), key=frames.object_counts.__getitem__)])
    if quantise.text == "distinct" and spec.limits:
        notes += (f"the limits do not count the table of the {quantise.alphabet - 1:,} vectors",)
    on_step()
    return Measurement(
        name, quantise.text, quantise.alphabet, len(medium), medium.grid.voxel_count, supported, entropy_over,
        voxel, on_object, corrected, per_frame, in_time, limits, capacities, energy, file_bits, notes,
        contacts,
    )  # fmt: skip


def read_contacts(paths: Sequence[str]) -> tuple[Trace, ...]:
    """Read the traces of contacts that are sampled at the same times; `SourceError` if they are not."""
    traces = tuple(read_trace(path) for path in paths)
    for path, trace in zip(paths[1:], traces[1:]):
        if not np.array_equal(trace.times_s, traces[0].times_s):
            found = f"{len(trace)} samples from {trace.times_s[0]:.6g} to {trace.times_s[-1]:.6g} s"
            expected = f"the {len(traces[0])} times of {paths[0]}"
            raise SourceError(path, found, expected, "Sample all contacts at the same times.")
    return traces


def _met(
    probes: Sequence[Trace], frames: SymbolFrames, spec: MeasureSpec
) -> tuple[Quantity, dict[str, Quantity]]:
    """Return the entropy of what the contacts meet together, and the quantities of several contacts."""
    range_, rate_hz = spec.encode.frames, frames.medium.rate_hz
    start_s = (range_[0] if range_ else 0) / rate_hz  # times relative to the first measured frame
    moved = [Trace(probe.times_s - start_s, probe.positions_m) for probe in probes]
    is_static = len(frames) == 1 and range_ is None  # a static medium exists at all times
    if is_static:
        met = contact_counts(moved, frames[0])
    else:
        met = contact_counts(moved, frames, rate_hz=rate_hz)
    joint = entropy(met, estimator=spec.estimator)
    if len(probes) == 1:
        return joint, {}
    each = [entropy(met, column=i, estimator=spec.estimator) for i in range(len(probes))]
    shared = total_correlation(met, estimator=spec.estimator)
    return joint, {**{f"S{i}": q for i, q in enumerate(each, 1)}, "total_correlation": shared}


def _medium(
    source: str | Path | Scene | HapticMedium, spec: MeasureSpec
) -> tuple[HapticMedium, str, tuple[str, ...], int | None, bool]:
    """Return W, its name, notes, the bits of its file, and whether its forces are codewords."""
    if isinstance(source, HapticMedium):
        return source, "medium", (), None, False
    stream = StreamScene(source) if isinstance(source, str | Path) and is_stream(source) else None
    if stream is not None and not spec.encode.changed_options():
        stream.notes = ()  # drop notes on options that have no effect
    prepared = prepare(stream or source, spec.encode)
    name = Path(source).name if isinstance(source, str | Path) else "scene"
    if stream is not None:
        # some of the frames do not take the whole file
        file_bits = None if spec.encode.frames else 8 * stream.file_bytes
        return prepared.medium, name, prepared.notes, file_bits, coder(stream.head.coder).has_codewords
    note = (
        f"W is sampled on {'x'.join(map(str, prepared.medium.grid.shape))} voxels for {prepared.device.name}"
    )
    return prepared.medium, name, (*prepared.notes, note), None, False


def _capacity(
    reference: SymbolFrames,
    counts: Counts,
    per_frame: Quantity,
    name: str,
    quantiser: FieldQuantiserSpec,
    spec: MeasureSpec,
) -> tuple[Capacity, tuple[str, ...]]:
    """Evaluate equations 1 to 3 for one device."""
    on_device = map_to_device(reference.medium, name, quantiser, spec.encode, spec.density)
    quantise = on_device.quantiser.fit(on_device.medium, on_device.device.force_max_n)
    frames = SymbolFrames(on_device.medium, quantise)
    voxels = on_device.medium.grid.voxel_count
    rendered_counts = field_counts(frames, overs=("voxel",))["voxel"]
    rendered = entropy(rendered_counts, estimator=spec.estimator).times(voxels, "bit/frame", "H(M(W))")
    max_bits = codomain_bits(voxels, quantise.alphabet)
    both = shared_counts(
        (reference, frames), (on_device.source_grid, on_device.medium.grid), (counts, rendered_counts)
    )
    per_lattice = reference.medium.grid.voxel_count, voxels
    ratio = None if both is None else paired_ratio(both, per_lattice, max_bits, spec.estimator)
    result = capacity(per_frame, rendered, max_bits, ratio=ratio)
    return result, (*on_device.notes, *result.notes, f"its Q is {quantise.text}")
