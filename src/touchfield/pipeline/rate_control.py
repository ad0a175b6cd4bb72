"""Encodes a source to a requested file size or error: searches the setting of coder `touch` that gives it.

The control is the step of the lattice in mode "nmse", and k, with F_0 in proportion, in the other modes. The
search starts on a few segments. A size in bytes is a budget for the whole file, of which at least 97 % are
used if the control allows it. An NMSE is reached to within 0.13 dB, which is 3 % of the error's energy. With
an error bound and a size, k is only ever raised.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, Final

from touchfield.atomic import atomic_path
from touchfield.compute.threads import Progress, silent
from touchfield.errors import InvalidArgument, require_ending, with_notes
from touchfield.measure.fidelity import FidelityMeter
from touchfield.medium import ForceField
from touchfield.medium.selection import select_frames
from touchfield.pipeline.decoding import open_file
from touchfield.pipeline.empty_result import refuse_empty
from touchfield.pipeline.encoding import Encoded, encode_prepared
from touchfield.pipeline.preparation import Prepared, prepare
from touchfield.pipeline.provenance import file_provenance
from touchfield.pipeline.spec import NO_FLOOR_N, EncodeSpec
from touchfield.sources.scene import Scene

MAX_ENCODES: Final = 8
NMSE_WITHIN_DB: Final = 0.13  # 3 % of the error's energy
MIN_FILL: Final = 0.97
"""Smallest fraction of the requested bytes that a file may take."""
_AIM: Final = 0.985  # fraction of the requested bytes that is aimed at, between MIN_FILL and 1
_SUBSET_ENCODES: Final = 4
_SUBSET_SEGMENTS: Final = 2
_K_BOUNDS: Final = (0.001, 0.99)
_STEPS: Final = 1 << 15  # the finest step of mode "nmse" is the device's F_max over this
_MAX_CACHE_BYTES: Final = 1 << 30
_LARGEST_MOVE: Final = 2.1  # of a logarithm, beyond the known points: a factor of 8
_BRACKET_MARGIN: Final = 0.05  # distance of the next x from the ends of a bracket, as a fraction of it


@dataclass(frozen=True)
class Target:
    """A target: the bytes of the file or the NMSE in dB; InvalidArgument for both, none, or bytes below 1."""

    bytes: int | None = None
    nmse_db: float | None = None

    def __post_init__(self) -> None:
        if (self.bytes is None) == (self.nmse_db is None):
            raise InvalidArgument(
                "--target-bytes and --target-nmse-db are one target: name one, not none or both"
            )
        if self.bytes is not None and self.bytes < 1:
            raise InvalidArgument("--target-bytes", repr(self.bytes), "a number of bytes, such as 60000")
        if self.nmse_db is not None and not math.isfinite(self.nmse_db):
            raise InvalidArgument("--target-nmse-db", repr(self.nmse_db), "decibels, such as -25")

    @property
    def option(self) -> str:
        """Its option on the command line."""
        return "--target-bytes" if self.bytes is not None else "--target-nmse-db"

    def is_reached(self, excess: float, fits: bool = False) -> bool:
        """True if the excess over the aim is small enough; with `fits`, if the size is within the target."""
        if self.bytes is None:
            return abs(excess) <= NMSE_WITHIN_DB
        return excess <= math.log(1 / _AIM) and (fits or excess >= math.log(MIN_FILL / _AIM))


@dataclass
class RootSearch:
    """Search for the zero of a falling y(x) in `low` to `high`, with few evaluations.

    `slope` is the default for dy/dx, negative; `points` are the evaluated x and y, in order of evaluation.
    """

    low: float
    high: float
    slope: float
    points: list[tuple[float, float]] = field(default_factory=list)

    def run(
        self,
        value: Callable[[float], float],
        start: float,
        is_close: Callable[[float], bool],
        max_values: int,
    ) -> bool:
        """Evaluate y from `start` on; True as soon as ``is_close(y)``.

        False if no further x is worth a value, or after `max_values` values.
        """
        x: float | None = min(max(start, self.low), self.high)
        while x is not None and len(self.points) < max_values:
            self.points.append((x, value(x)))
            if is_close(self.points[-1][1]):
                return True
            x = self.next_x()
        return False

    def next_x(self) -> float | None:
        """The next x to evaluate; None if the curve does not reach zero within the bounds."""
        above = max((p for p in self.points if p[1] > 0), default=None)
        below = min((p for p in self.points if p[1] <= 0), default=None)
        if above is not None and below is not None:
            (a, up), (b, down) = above, below
            x = a + min(max(up / (up - down), _BRACKET_MARGIN), 1 - _BRACKET_MARGIN) * (b - a)
        else:
            # the last point on that side, also where the curve is flat
            latest_x, y = above or below or self.points[-1]
            x = latest_x + min(max(-y / self.measured_slope(), -_LARGEST_MOVE), _LARGEST_MOVE)
        x = min(max(x, self.low), self.high)
        return None if any(abs(x - evaluated) < 1e-6 for evaluated, _ in self.points) else x

    def measured_slope(self) -> float:
        """dy/dx between the two points that are closest to zero; `slope` if that is not plausible."""
        if len(self.points) < 2:
            return self.slope
        (a, ya), (b, yb) = sorted(self.points, key=lambda p: abs(p[1]))[:2]
        slope = (yb - ya) / (b - a) if b != a else 0.0
        return slope if 4 * self.slope < slope < self.slope / 8 else self.slope


@dataclass
class _Trials:
    """Trial encodings of all frames, or of a part of them; each is written to `temporary`.

    `total_over_part` is the number of all frames over that of the part. `reached` has the size in bytes and
    the NMSE in dB of each trial, by the logarithm of its control; `count` includes those of the part.
    """

    source: str | Path | Scene
    prepared: Prepared
    target: Target
    temporary: Path
    report: Progress
    count: int = 0
    total_over_part: float = 1.0
    last: Encoded | None = None
    reached: dict[float, tuple[int, float | None]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        touch = self.prepared.spec.touch
        self.is_step = touch.mode == "nmse"
        self.requested = touch.step_n if self.is_step else touch.k
        # a requested error bound is not made stricter to fill a file
        self.only_raise = self.target.bytes is not None and not self.is_step
        top = self.prepared.device.force_max_n
        low, high = (top / _STEPS, top) if self.is_step else _K_BOUNDS
        if self.only_raise:
            low, high = self.requested, max(self.requested, high)
        # bytes fall more slowly than the step grows; an NMSE changes by 20 dB per decade
        default_slope = -0.6 if self.target.bytes is not None else -8.7
        self.search = RootSearch(math.log(low), math.log(high), default_slope)

    def spec(self, log_control: float) -> EncodeSpec:
        """The spec with its control set, F_0 in proportion to k; exactly the requested one at the start."""
        spec, touch = self.prepared.spec, self.prepared.spec.touch
        control = self.requested if log_control == math.log(self.requested) else math.exp(log_control)
        if self.is_step:
            return replace(spec, touch=replace(touch, step_n=control))
        return replace(spec, touch=replace(touch, k=control, f0_n=touch.f0_n * control / touch.k))

    def encode(self, log_control: float) -> Encoded:
        """Encode with a control, given as its logarithm."""
        self.count += 1
        prepared = replace(self.prepared, spec=self.spec(log_control))
        self.last = encode_prepared(
            prepared, self.temporary, file_provenance(self.source, prepared), self.report
        )
        return self.last

    def excess(self, log_control: float) -> float:
        """Encode with a control; the distance from the aim, above 0 if the control must be raised."""
        encoded, medium = self.encode(log_control), self.prepared.medium
        if not encoded.supported_voxels and self.target.bytes is None:
            error = InvalidArgument(
                self.target.option, "frames without a force", "a force to measure the error by"
            )
            raise with_notes(error, encoded.notes)
        with open_file(self.temporary) as opened:
            reader, head = opened.reader, opened.reader.head
            segment_bytes = sum(
                e.length + len(reader.read_vibration(i) or b"") for i, e in enumerate(reader.segments)
            )
            size = encoded.file_bytes + (self.total_over_part - 1) * segment_bytes
            if self.target.bytes is not None:
                self.reached[log_control] = round(size), None
                return math.log(size / (_AIM * self.target.bytes))
            meter = FidelityMeter(opened.weber, max(head.force_threshold_n, NO_FLOOR_N))
            for i, decoded in enumerate(opened.medium):
                meter.add(medium[i], decoded)
        nmse_db = -math.inf if meter.nmse_db is None else meter.nmse_db
        self.reached[log_control] = round(size), nmse_db
        assert self.target.nmse_db is not None
        return self.target.nmse_db - nmse_db

    def measured_text(self, log_control: float) -> str:
        """The size or the error of a trial, as text."""
        size, nmse_db = self.reached[log_control]
        return f"{size} bytes" if nmse_db is None else f"{nmse_db:.2f} dB"


def encode_to_target(
    source: str | Path | Scene,
    out: str | Path,
    spec: EncodeSpec | None,
    target: Target,
    report: Progress = silent,
) -> Encoded:
    """Turn a source into a ``.touch`` file of a given size or error, in at most 8 encodings.

    `spec` is of coder `touch`, in any mode but "lossless"; `report` gets ``(done, total)`` in frames, for one
    encoding after another. InvalidArgument names the nearest size or error that was reached; no file `out` is
    then left.
    """
    start_s = time.perf_counter()
    spec = spec or EncodeSpec()
    require_ending(out, "OUT.touch")
    if spec.coder != "touch" or spec.touch.mode == "lossless":
        found = f"coder {spec.coder}" + (", lossless" if spec.coder == "touch" else "")
        raise InvalidArgument(target.option, found, "coder touch in mode mask, mask-direction or nmse")
    if spec.touch.k_by_force:
        found = "it together with a Weber fraction by force (--profile), which no search may raise"
        raise InvalidArgument(target.option, found, "one of both", "Give --k and --f0-n instead.")
    with atomic_path(Path(out)) as temporary:
        trials = _Trials(source, _with_frame_cache(prepare(source, spec)), target, temporary, report)
        control = _search_all_frames(trials, _start_from_subset(trials))
        assert trials.last is not None
        refuse_empty(trials.prepared, trials.last.supported_voxels)
    figures, note = _search_report(trials, control)
    return replace(
        trials.last,
        encode_s=time.perf_counter() - start_s,
        coding_notes=(*trials.last.coding_notes, note),
        search=figures,
    )


def _start_from_subset(trials: _Trials) -> float:
    """The logarithm of the first control: from a search on two whole segments, if there are enough."""
    prepared, start = trials.prepared, math.log(trials.requested)
    length = prepared.spec.segment_frames_at(prepared.medium.rate_hz)
    count = len(prepared.medium) // length
    if (
        prepared.objects is not None or count < 2 * _SUBSET_SEGMENTS
    ):  # objects, or hardly more than the subset
        return start
    firsts = [length * (count * (2 * i + 1) // (2 * _SUBSET_SEGMENTS)) for i in range(_SUBSET_SEGMENTS)]
    indices = [first + i for first in firsts for i in range(length)]
    part = replace(prepared, medium=select_frames(prepared.medium, indices))
    total_over_part = len(prepared.medium) / len(part.medium)
    subset_trials = replace(trials, prepared=part, total_over_part=total_over_part, reached={})
    search = subset_trials.search
    tolerance = NMSE_WITHIN_DB if trials.target.bytes is None else 1 - MIN_FILL

    def is_close(excess: float) -> bool:
        return (trials.only_raise and len(search.points) == 1 and excess <= 0) or abs(excess) <= tolerance / 4

    search.run(subset_trials.excess, start, is_close, _SUBSET_ENCODES)
    trials.count, trials.search.slope = subset_trials.count, search.measured_slope()
    best = min(search.points, key=lambda p: abs(p[1]))
    following = None if is_close(best[1]) else search.next_x()
    return best[0] if following is None else following


def _search_all_frames(trials: _Trials, start: float) -> float:
    """Encode all frames until the target is reached; the logarithm of the temporary file's control."""
    search, target = trials.search, trials.target

    def is_close(excess: float) -> bool:
        return target.is_reached(excess, fits=trials.only_raise and search.points[-1][0] <= search.low)

    if search.run(trials.excess, start, is_close, MAX_ENCODES - 1 - trials.count):
        return search.points[-1][0]
    fitting = [p for p in search.points if target.is_reached(p[1], fits=True)]
    nearest = min(search.points, key=lambda p: abs(p[1]))
    is_finest = nearest[0] <= search.low and target.bytes is not None
    if not fitting or (is_finest and nearest[1] < 0):
        control = f"{'step_n' if trials.is_step else 'k'} was {math.exp(nearest[0]):.4g}"
        hint = f"Request that, or change the mode, --effort or --nw ({control})."
        target_value = target.bytes if target.bytes is not None else target.nmse_db
        raise InvalidArgument(
            target.option, f"{target_value:g}", f"{trials.measured_text(nearest[0])}, the nearest", hint
        )
    best = max(fitting, key=lambda p: p[1])
    if best is not search.points[-1]:
        trials.encode(best[0])
    return best[0]


def _search_report(trials: _Trials, log_control: float) -> tuple[dict[str, Any], str]:
    """Keys of the summary on the search, and a note for people."""
    requested, found, target = trials.prepared.spec.touch, trials.spec(log_control).touch, trials.target
    figures: dict[str, Any] = {"target_bytes": target.bytes, "target_nmse_db": target.nmse_db}
    figures |= {"nmse_db": trials.reached[log_control][1], "encodes": trials.count}
    figures |= {"asked_k": requested.k, "asked_f0_n": requested.f0_n}
    reached = trials.measured_text(log_control)
    if trials.is_step:
        return figures, f"{reached} with a step of {found.step_n:.4g} N, found in {trials.count} encodings"
    if found.k == requested.k:
        return figures, f"{reached} with the requested k, {found.k:g}"
    change = "raised" if found.k > requested.k else "lowered"
    of_k, of_f0 = f"{requested.k:g} to {found.k:.4g}", f"{requested.f0_n:g} to {found.f0_n:.4g} N"
    weaker = "; this weaker error bound is the guaranteed one" if change == "raised" else ""
    return figures, f"{reached}: k was {change} from {of_k}, and F_0 from {of_f0}{weaker}"


def _with_frame_cache(prepared: Prepared) -> Prepared:
    """The same with a cache of its frames, up to 1 GiB, and of all frames of its vibration."""
    cache_by_frame: dict[int, ForceField] = {}
    free_bytes = _MAX_CACHE_BYTES
    make, band = prepared.medium.make_frame, prepared.medium.vibration

    def frame(i: int) -> ForceField:
        nonlocal free_bytes
        if i in cache_by_frame:
            return cache_by_frame[i]
        field = make(i)
        if field.forces_n.nbytes <= free_bytes:
            cache_by_frame[i] = field
            free_bytes -= field.forces_n.nbytes
        return field

    return replace(
        prepared, medium=replace(prepared.medium, make_frame=frame, vibration=band and cache(band))
    )
