"""A size or an error to reach: the control of coder `touch` is searched, on a few segments first.

In mode "nmse" the control is the step of the lattice; in the other modes it is k, with F_0 in proportion.
Bytes are those of the whole file and a budget, of which at least 97 % are used where the control allows; the
NMSE is reached within 0.13 dB, which is 3 % of the error's energy. With a promise and a size, k is only ever
raised.
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
from touchfield.compute.threads import Report, silent
from touchfield.errors import InvalidArgument, require_ending
from touchfield.measure.fidelity import FidelityMeter
from touchfield.medium import ForceField
from touchfield.medium.selection import select_frames
from touchfield.pipeline.decoding import open_stream
from touchfield.pipeline.encoding import Encoded, encode_prepared, provenance_of
from touchfield.pipeline.preparation import Prepared, prepare
from touchfield.pipeline.spec import NO_FLOOR_N, EncodeSpec
from touchfield.sources.scene import Scene

MOST_ENCODES: Final = 8
NMSE_WITHIN_DB: Final = 0.13  # 3 % of the error's energy
LEAST_SHARE: Final = 0.97
_AIM: Final = 0.985  # of the bytes asked for: what is aimed at, between the least share and all of them
_SUBSET_ENCODES: Final = 4
_SUBSET_SEGMENTS: Final = 2
_K_BOUNDS: Final = (0.001, 0.99)
_STEPS: Final = 1 << 15  # the finest step of mode "nmse" is the device's F_max over this
_MOST_BYTES_KEPT: Final = 1 << 30
_LARGEST_MOVE: Final = 2.1  # of a logarithm, beyond what is known: a factor of 8
_WITHIN: Final = 0.05  # a guess keeps this share of a bracket away from its ends


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
        """If a file is near enough to what is aimed at; with `fits` any size within the target is."""
        if self.bytes is None:
            return abs(excess) <= NMSE_WITHIN_DB
        return excess <= math.log(1 / _AIM) and (fits or excess >= math.log(LEAST_SHARE / _AIM))


@dataclass
class RootSearch:
    """Search for the x in `low` to `high` where a falling y(x) is zero, each value of which is dear.

    `slope` is dy/dx where nothing better is known, negative; `points` are x and y known so far, the last the
    latest.
    """

    low: float
    high: float
    slope: float
    points: list[tuple[float, float]] = field(default_factory=list)

    def run(
        self, value: Callable[[float], float], start: float, is_near: Callable[[float], bool], most: int
    ) -> bool:
        """Evaluate from `start` on until `is_near(y)`, no guess is left or `most` values are known; if it is
        near.
        """
        x: float | None = min(max(start, self.low), self.high)
        while x is not None and len(self.points) < most:
            self.points.append((x, value(x)))
            if is_near(self.points[-1][1]):
                return True
            x = self.guess()
        return False

    def guess(self) -> float | None:
        """The next x worth a value; None where the curve does not reach zero within the bounds."""
        above = max((p for p in self.points if p[1] > 0), default=None)
        below = min((p for p in self.points if p[1] <= 0), default=None)
        if above is not None and below is not None:
            (a, up), (b, down) = above, below
            x = a + min(max(up / (up - down), _WITHIN), 1 - _WITHIN) * (b - a)
        else:
            near, y = above or below or self.points[-1]  # the last on that side, also where the curve is flat
            x = near + min(max(-y / self.measured_slope(), -_LARGEST_MOVE), _LARGEST_MOVE)
        x = min(max(x, self.low), self.high)
        return None if any(abs(x - known) < 1e-6 for known, _ in self.points) else x

    def measured_slope(self) -> float:
        """dy/dx between the two points that are nearest to zero; `slope` where they tell none."""
        if len(self.points) < 2:
            return self.slope
        (a, ya), (b, yb) = sorted(self.points, key=lambda p: abs(p[1]))[:2]
        slope = (yb - ya) / (b - a) if b != a else 0.0
        return slope if 4 * self.slope < slope < self.slope / 8 else self.slope


@dataclass
class _Tries:
    """The encodings so far, of all frames or of a part that is `1 / whole` of them; each goes to `temporary`."""

    source: str | Path | Scene
    prepared: Prepared
    target: Target
    temporary: Path
    report: Report
    count: int = 0
    whole: float = 1.0
    last: Encoded | None = None
    reached: dict[float, tuple[int, float | None]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        touch = self.prepared.spec.touch
        self.is_step = touch.mode == "nmse"
        self.asked = touch.step_n if self.is_step else touch.k
        # a promise that was asked for is not made sharper to fill a file
        self.only_up = self.target.bytes is not None and not self.is_step
        top = self.prepared.device.force_max_n
        low, high = (top / _STEPS, top) if self.is_step else _K_BOUNDS
        if self.only_up:
            low, high = self.asked, max(self.asked, high)
        usual = (
            -0.6 if self.target.bytes is not None else -8.7
        )  # bytes fall slower than the step; 20 dB a decade
        self.search = RootSearch(math.log(low), math.log(high), usual)

    def spec(self, log_control: float) -> EncodeSpec:
        """The spec with its control set, exactly as it was asked for where the search begins; F_0 goes with
        k.
        """
        spec, touch = self.prepared.spec, self.prepared.spec.touch
        control = self.asked if log_control == math.log(self.asked) else math.exp(log_control)
        if self.is_step:
            return replace(spec, touch=replace(touch, step_n=control))
        return replace(spec, touch=replace(touch, k=control, f0_n=touch.f0_n * control / touch.k))

    def encode(self, log_control: float) -> Encoded:
        """Encode with a control."""
        self.count += 1
        prepared = replace(self.prepared, spec=self.spec(log_control))
        self.last = encode_prepared(
            prepared, self.temporary, provenance_of(self.source, prepared), self.report
        )
        return self.last

    def excess(self, log_control: float) -> float:
        """Encode with a control; how far that is from what is aimed at, above 0 where it must be raised."""
        done, medium = self.encode(log_control), self.prepared.medium
        if not done.supported_voxels and self.target.bytes is None:
            raise InvalidArgument(
                self.target.option, "frames without a force", "a force to measure the error by"
            )
        with open_stream(self.temporary) as opened:
            reader, head = opened.reader, opened.reader.head
            coded = sum(
                e.length + len(reader.read_vibration(i) or b"") for i, e in enumerate(reader.segments)
            )
            size = done.file_bytes + (self.whole - 1) * coded
            if self.target.bytes is not None:
                self.reached[log_control] = round(size), None
                return math.log(size / (_AIM * self.target.bytes))
            meter = FidelityMeter(head.weber_fraction, max(head.force_threshold_n, NO_FLOOR_N))
            for i, decoded in enumerate(opened.medium):
                meter.add(medium[i], decoded)
        nmse_db = -math.inf if meter.nmse_db is None else meter.nmse_db
        self.reached[log_control] = round(size), nmse_db
        assert self.target.nmse_db is not None
        return self.target.nmse_db - nmse_db

    def words(self, log_control: float) -> str:
        """The size or the error of a file."""
        size, nmse_db = self.reached[log_control]
        return f"{size} bytes" if nmse_db is None else f"{nmse_db:.2f} dB"


def encode_to_target(
    source: str | Path | Scene,
    out: str | Path,
    spec: EncodeSpec | None,
    target: Target,
    report: Report = silent,
) -> Encoded:
    """Turn a source into a ``.touch`` file of a given size or error, in at most 8 encodings.

    `spec` is of coder `touch`, in any mode but "lossless"; `report` gets ``(done, total)`` in frames, for one
    encoding after another. InvalidArgument says what the nearest is; nothing is then left under the name
    `out`.
    """
    began = time.perf_counter()
    spec = spec or EncodeSpec()
    require_ending(out, "OUT.touch")
    if spec.coder != "touch" or spec.touch.mode == "lossless":
        asked = f"coder {spec.coder}" + (", lossless" if spec.coder == "touch" else "")
        raise InvalidArgument(target.option, asked, "coder touch in mode mask, mask-direction or nmse")
    with atomic_path(Path(out)) as temporary:
        tries = _Tries(source, _kept(prepare(source, spec)), target, temporary, report)
        control = _on_all(tries, _first_guess(tries))
        assert tries.last is not None
    figures, note = _wording(tries, control)
    return replace(
        tries.last, encode_s=time.perf_counter() - began, told=(*tries.last.told, note), search=figures
    )


def _first_guess(tries: _Tries) -> float:
    """The logarithm of the control to begin with: from two whole segments, where there are enough of them."""
    prepared, start = tries.prepared, math.log(tries.asked)
    length = prepared.spec.segment_frames_at(prepared.medium.rate_hz)
    count = len(prepared.medium) // length
    if prepared.scene is not None or count < 2 * _SUBSET_SEGMENTS:  # hardly more than a part, or objects
        return start
    firsts = [length * (count * (2 * i + 1) // (2 * _SUBSET_SEGMENTS)) for i in range(_SUBSET_SEGMENTS)]
    part = replace(
        prepared, medium=select_frames(prepared.medium, [n + j for n in firsts for j in range(length)])
    )
    of_part = replace(tries, prepared=part, whole=len(prepared.medium) / len(part.medium), reached={})
    search, within = of_part.search, NMSE_WITHIN_DB if tries.target.bytes is None else 1 - LEAST_SHARE

    def is_near(excess: float) -> bool:
        return (tries.only_up and len(search.points) == 1 and excess <= 0) or abs(excess) <= within / 4

    search.run(of_part.excess, start, is_near, _SUBSET_ENCODES)
    tries.count, tries.search.slope = of_part.count, search.measured_slope()
    best = min(search.points, key=lambda p: abs(p[1]))
    following = None if is_near(best[1]) else search.guess()
    return best[0] if following is None else following


def _on_all(tries: _Tries, start: float) -> float:
    """All frames, coded until the target is reached; the logarithm of the control of the temporary file."""
    search, target = tries.search, tries.target

    def is_near(excess: float) -> bool:
        return target.is_reached(excess, fits=tries.only_up and search.points[-1][0] <= search.low)

    if search.run(tries.excess, start, is_near, MOST_ENCODES - 1 - tries.count):
        return search.points[-1][0]
    fitting = [p for p in search.points if target.is_reached(p[1], fits=True)]
    nearest = min(search.points, key=lambda p: abs(p[1]))
    is_finest = nearest[0] <= search.low and target.bytes is not None
    if not fitting or (is_finest and nearest[1] < 0):
        control = f"{'step_n' if tries.is_step else 'k'} was {math.exp(nearest[0]):.4g}"
        mend = f"Ask for that, or change the mode, --effort or --nw ({control})."
        wanted = target.bytes if target.bytes is not None else target.nmse_db
        raise InvalidArgument(target.option, f"{wanted:g}", f"{tries.words(nearest[0])}, the nearest", mend)
    best = max(fitting, key=lambda p: p[1])
    if best is not search.points[-1]:
        tries.encode(best[0])
    return best[0]


def _wording(tries: _Tries, log_control: float) -> tuple[dict[str, Any], str]:
    """Keys of the summary that tell of the search, and a note for people."""
    asked, chosen, target = tries.prepared.spec.touch, tries.spec(log_control).touch, tries.target
    figures: dict[str, Any] = {"target_bytes": target.bytes, "target_nmse_db": target.nmse_db}
    figures |= {"nmse_db": tries.reached[log_control][1], "encodes": tries.count}
    figures |= {"asked_k": asked.k, "asked_f0_n": asked.f0_n}
    reached = tries.words(log_control)
    if tries.is_step:
        return figures, f"{reached} with a step of {chosen.step_n:.4g} N, found in {tries.count} encodings"
    if chosen.k == asked.k:
        return figures, f"{reached} with the k that was asked for, {chosen.k:g}"
    way = "raised" if chosen.k > asked.k else "lowered"
    of_k, of_f0 = f"{asked.k:g} to {chosen.k:.4g}", f"{asked.f0_n:g} to {chosen.f0_n:.4g} N"
    weaker = "; this weaker promise is the one that is kept" if way == "raised" else ""
    return figures, f"{reached}: k was {way} from {of_k}, and F_0 from {of_f0}{weaker}"


def _kept(prepared: Prepared) -> Prepared:
    """The same, whose frames are kept once they are made, as far as memory allows; all of a vibration's."""
    kept: dict[int, ForceField] = {}
    room = _MOST_BYTES_KEPT
    make, band = prepared.medium.make_frame, prepared.medium.vibration

    def frame(i: int) -> ForceField:
        nonlocal room
        if i in kept:
            return kept[i]
        fresh = make(i)
        if fresh.forces_n.nbytes <= room:
            kept[i] = fresh
            room -= fresh.forces_n.nbytes
        return fresh

    return replace(
        prepared, medium=replace(prepared.medium, make_frame=frame, vibration=band and cache(band))
    )
