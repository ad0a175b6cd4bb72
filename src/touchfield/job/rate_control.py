"""A size or an error to reach: the control of coder `touch` is searched, on a few segments first.

In mode "nmse" the control is the step of the lattice; in the other modes it is k, with F_0 in proportion. Bytes are
those of the whole file and a budget, of which at least 97 % are used where the control allows; the NMSE is reached
within 0.13 dB, which is 3 % of the error's energy. With a promise and a size, k is only ever raised.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, Final

from touchfield.errors import InvalidArgument
from touchfield.job.encode import Encoded, encode_prepared, provenance_of
from touchfield.job.prepare import Prepared, prepare
from touchfield.job.root_search import RootSearch
from touchfield.job.spec import NO_FLOOR_N, EncodeSpec, Report, silent
from touchfield.job.stream import open_stream
from touchfield.measure.fidelity import FidelityMeter
from touchfield.medium import ForceField, HapticMedium
from touchfield.medium.atomic import atomic_path
from touchfield.medium.vibration import VibrationBand
from touchfield.sources.scene import Scene

__all__ = ["MOST_ENCODES", "Target", "encode_to_target"]

MOST_ENCODES: Final = 8
NMSE_WITHIN_DB: Final = 0.13
"""3 % of the error's energy."""
LEAST_SHARE: Final = 0.97
_AIM: Final = 0.985
"""Of the bytes asked for: the least that is used, and what is aimed at between that and all of them."""
_SUBSET_ENCODES: Final = 4
_SUBSET_SEGMENTS: Final = 2
_K_BOUNDS: Final = (0.001, 0.99)
_STEPS: Final = 1 << 15
"""The finest step of mode "nmse" is the device's F_max over this."""
_MOST_BYTES_KEPT: Final = 1 << 30


@dataclass(frozen=True)
class Target:
    """What to reach: the bytes of the file or the NMSE in dB, one of both.

    Raises
    ------
    InvalidArgument
        If both or none are given, or the bytes are not positive.
    """

    bytes: int | None = None
    nmse_db: float | None = None

    def __post_init__(self) -> None:
        if (self.bytes is None) == (self.nmse_db is None):
            found = "none" if self.bytes is None else "both"
            raise InvalidArgument("target", found, "bytes (--target-bytes) or an NMSE (--target-nmse-db)")
        if self.bytes is not None and self.bytes < 1:
            raise InvalidArgument("--target-bytes", repr(self.bytes), "a number of bytes, such as 60000")
        if self.nmse_db is not None and not math.isfinite(self.nmse_db):
            raise InvalidArgument("--target-nmse-db", repr(self.nmse_db), "decibels, such as -25")

    @property
    def option(self) -> str:
        """How the command line calls it."""
        return "--target-bytes" if self.bytes is not None else "--target-nmse-db"

    def excess(self, file_bytes: float, nmse_db: float) -> float:
        """How far a file is from what is aimed at: above 0 where the control must be raised."""
        if self.bytes is not None:
            return math.log(file_bytes / (_AIM * self.bytes))
        assert self.nmse_db is not None
        return self.nmse_db - nmse_db

    def is_reached(self, excess: float, fits: bool = False) -> bool:
        """Whether that is near enough; with `fits` any size within the target is."""
        if self.bytes is None:
            return abs(excess) <= NMSE_WITHIN_DB
        return excess <= math.log(1 / _AIM) and (fits or excess >= math.log(LEAST_SHARE / _AIM))

    def said(self, file_bytes: int, nmse_db: float) -> str:
        """What a file reaches, in the target's unit."""
        return f"{file_bytes} bytes" if self.bytes is not None else f"{nmse_db:.2f} dB"


@dataclass
class _Tries:
    """The encodings made so far, of a part of the frames or of all."""

    source: str | Path | Scene
    prepared: Prepared
    target: Target
    temporary: Path
    report: Report
    count: int = 0
    last: Encoded | None = None
    by_control: dict[float, tuple[int, float]] = field(default_factory=dict)
    whole: float = 1.0

    def spec(self, control: float) -> EncodeSpec:
        """The spec with its control set."""
        spec = self.prepared.spec
        asked = spec.touch
        if asked.mode == "nmse":
            return replace(spec, touch=replace(asked, step_n=control))
        return replace(spec, touch=replace(asked, k=control, f0_n=asked.f0_n * control / asked.k))

    def control(self, log_control: float) -> float:
        """k or the step of a logarithm; exactly what was asked for where the search begins."""
        spec = self.prepared.spec.touch
        asked = spec.step_n if spec.mode == "nmse" else spec.k
        return asked if log_control == math.log(asked) else math.exp(log_control)

    def excess(self, log_control: float) -> float:
        """Encode with a control, and see how far it is from the target."""
        control = self.control(log_control)
        self.last = self.encoded(control)
        with open_stream(self.temporary) as opened:
            reader = opened.reader
            coded = sum(e.length + len(reader.read_vibration(i) or b"") for i, e in enumerate(reader.segments))
        size = self.last.file_bytes + (self.whole - 1) * coded
        nmse_db = _nmse_db(self.temporary, self.prepared.medium) if self.target.bytes is None else math.nan
        self.by_control[log_control] = (round(size), nmse_db)
        return self.target.excess(size, nmse_db)

    def encoded(self, control: float) -> Encoded:
        """Encode with a control, into the temporary file."""
        self.count += 1
        prepared = replace(self.prepared, spec=self.spec(control))
        done = encode_prepared(prepared, self.temporary, provenance_of(self.source, prepared), self.report)
        if not done.supported_voxels and self.target.bytes is None:
            raise InvalidArgument(self.target.option, "frames without a force", "a force to measure the error by")
        return done


def encode_to_target(
    source: str | Path | Scene,
    out: str | Path,
    spec: EncodeSpec | None,
    target: Target,
    report: Report = silent,
) -> Encoded:
    """Turn a source into a ``.touch`` file of a given size or error, in at most 8 encodings.

    Parameters
    ----------
    spec : EncodeSpec
        Of coder `touch`, in any mode but "lossless".
    report : callable
        ``report(done, total)`` in frames, for one encoding after another.

    Raises
    ------
    InvalidArgument
        If the target cannot be reached; it says what the nearest is. Nothing is then left under the name `out`.
    """
    began = time.perf_counter()
    spec = spec or EncodeSpec()
    if spec.coder != "touch" or spec.touch.mode == "lossless":
        found = f"coder {spec.coder}" + (", lossless" if spec.coder == "touch" else "")
        raise InvalidArgument(target.option, found, "coder touch in mode mask, mask-direction or nmse")
    prepared = _kept(prepare(source, spec))
    with atomic_path(Path(out)) as temporary:
        tries = _Tries(source, prepared, target, temporary, report)
        control, slope = _first_guess(tries)
        done, log_control = _on_all(tries, control, slope)
    reached = tries.by_control[log_control]
    told, note = _told(tries, tries.control(log_control), reached)
    return replace(done, encode_s=time.perf_counter() - began, told=(*done.told, note), search=told)


def _search(tries: _Tries, slope: float | None) -> RootSearch:
    spec = tries.prepared.spec.touch
    top = tries.prepared.device.force_max_n
    bounds = (top / _STEPS, top) if spec.mode == "nmse" else _K_BOUNDS
    if _only_up(tries):
        bounds = (spec.k, max(spec.k, _K_BOUNDS[1]))
    usual = -0.6 if tries.target.bytes is not None else -8.7  # bytes fall slower than the step grows; 20 dB a decade
    return RootSearch(math.log(bounds[0]), math.log(bounds[1]), usual if slope is None else slope)


def _only_up(tries: _Tries) -> bool:
    """A promise that was asked for is not made sharper to fill a file."""
    return tries.target.bytes is not None and tries.prepared.spec.touch.mode != "nmse"


def _first_guess(tries: _Tries) -> tuple[float, float | None]:
    """The logarithm of the control to begin with, and how the target goes with it where a part of the frames told."""
    asked = tries.prepared.spec.touch
    start = math.log(asked.step_n if asked.mode == "nmse" else asked.k)
    part = _part(tries.prepared)
    if part is None:
        return start, None
    ratio = len(tries.prepared.medium) / len(part.medium)
    of_part = replace(tries, prepared=part, whole=ratio, by_control={})
    search = _search(of_part, None)
    within = 0.25

    def is_near(excess: float) -> bool:
        fits = _only_up(tries) and len(search.points) == 1 and excess <= 0
        return fits or abs(excess) <= within * (NMSE_WITHIN_DB if tries.target.bytes is None else 1 - LEAST_SHARE)

    search.run(of_part.excess, start, is_near, _SUBSET_ENCODES)
    tries.count = of_part.count
    best = min(search.points, key=lambda p: abs(p[1]))
    following = search.guess() if not is_near(best[1]) else None
    return following if following is not None else best[0], search.measured_slope()


def _on_all(tries: _Tries, start: float, slope: float | None) -> tuple[Encoded, float]:
    """All frames, coded until the target is reached; the file is the temporary one."""
    search, target = _search(tries, slope), tries.target

    def is_near(excess: float) -> bool:
        at_asked = _only_up(tries) and search.points[-1][0] <= search.low
        return target.is_reached(excess, fits=at_asked)

    if search.run(tries.excess, start, is_near, MOST_ENCODES - 1 - tries.count):
        assert tries.last is not None
        return tries.last, search.points[-1][0]
    fitting = [p for p in search.points if target.is_reached(p[1], fits=True)]
    nearest = min(search.points, key=lambda p: abs(p[1]))
    is_finest = nearest[0] <= search.low and target.bytes is not None
    if not fitting or (is_finest and nearest[1] < 0):
        size, nmse_db = tries.by_control[nearest[0]]
        name = _control_name(tries.prepared.spec)
        mend = f"Ask for that, or change the mode, --effort or --nw ({name} was {math.exp(nearest[0]):.4g})."
        wanted = target.bytes if target.bytes is not None else target.nmse_db
        raise InvalidArgument(target.option, f"{wanted:g}", f"{target.said(size, nmse_db)}, the nearest", mend)
    best = max(fitting, key=lambda p: p[1])
    if best is not search.points[-1]:
        tries.last = tries.encoded(tries.control(best[0]))
    assert tries.last is not None
    return tries.last, best[0]


def _control_name(spec: EncodeSpec) -> str:
    return "step_n" if spec.touch.mode == "nmse" else "k"


def _told(tries: _Tries, control: float, reached: tuple[int, float]) -> tuple[dict[str, Any], str]:
    """What the summary tells of the search, and a note for people."""
    target, asked, found = tries.target, tries.prepared.spec.touch, tries.spec(control).touch
    told: dict[str, Any] = {
        "target_bytes": target.bytes,
        "target_nmse_db": target.nmse_db,
        "nmse_db": None if math.isnan(reached[1]) else reached[1],
        "encodes": tries.count,
        "asked_k": asked.k,
        "asked_f0_n": asked.f0_n,
    }
    what = target.said(*reached)
    if asked.mode == "nmse":
        return told, f"{what} with a step of {found.step_n:.4g} N, found in {tries.count} encodings"
    if found.k == asked.k:
        return told, f"{what} with the k that was asked for, {found.k:g}"
    moved = "raised" if found.k > asked.k else "lowered"
    note = (
        f"{what}: k was {moved} from {asked.k:g} to {found.k:.4g}, and F_0 from {asked.f0_n:g} to {found.f0_n:.4g} N"
    )
    return told, f"{note}; this weaker promise is the one that is kept" if moved == "raised" else note


def _nmse_db(path: Path, originals: HapticMedium) -> float:
    with open_stream(path) as opened:
        head = opened.reader.head
        meter = FidelityMeter(head.weber_fraction, max(head.force_threshold_n, NO_FLOOR_N))
        for i, decoded in enumerate(opened.medium):
            meter.add(originals[i], decoded)
    return -math.inf if meter.nmse_db is None else meter.nmse_db


def _part(prepared: Prepared) -> Prepared | None:
    """A few whole segments, spread over the frames; None where there are hardly more, or objects."""
    medium, length = prepared.medium, prepared.spec.segment_frames_at(prepared.medium.rate_hz)
    count = len(medium) // length
    if prepared.scene is not None or count < 2 * _SUBSET_SEGMENTS:
        return None
    numbers = [
        length * (count * (2 * i + 1) // (2 * _SUBSET_SEGMENTS)) + j
        for i in range(_SUBSET_SEGMENTS)
        for j in range(length)
    ]
    frames, band = [medium[i] for i in numbers], medium.vibration
    if band is not None:
        band = replace(band, frame_count=len(numbers), make_frame=[band[i] for i in numbers].__getitem__)
    made = replace(medium, frame_count=len(frames), make_frame=frames.__getitem__, vibration=band)
    return replace(prepared, medium=made)


def _kept(prepared: Prepared) -> Prepared:
    """The same, whose frames are kept once they are made, as far as memory allows."""
    kept: dict[int, ForceField] = {}
    held = 0
    make: Callable[[int], ForceField] = prepared.medium.make_frame

    def frame(i: int) -> ForceField:
        nonlocal held
        if i in kept:
            return kept[i]
        made = make(i)
        if held + made.forces_n.nbytes <= _MOST_BYTES_KEPT:
            kept[i] = made
            held += made.forces_n.nbytes
        return made

    medium = replace(prepared.medium, make_frame=frame)
    band = medium.vibration
    return replace(prepared, medium=medium if band is None else replace(medium, vibration=_kept_band(band)))


def _kept_band(band: VibrationBand) -> VibrationBand:
    """The same, whose frames are kept: they take a fraction of what the forces take."""
    return replace(band, make_frame=cache(band.make_frame))
