"""Editing stored media: within regions, in time, on another lattice, in levels of detail (paper section 4).

Every result is a new file, coded like any medium; its provenance tells what was done.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import lru_cache, partial, reduce
from pathlib import Path
from typing import Any, Final

import numpy as np

from touchfield.compute.threads import Report, silent
from touchfield.errors import (
    InvalidArgument,
    require_between,
    require_ending,
    require_not_negative,
    require_one_of,
    require_positive,
)
from touchfield.files import keep_sources
from touchfield.filters.device_filter import NW_RANGE, limited
from touchfield.filters.edit import (
    COMPOSITIONS,
    Composed,
    EditOperator,
    Erased,
    Gain,
    Limited,
    Moved,
    cross_faded,
    edited_medium,
)
from touchfield.filters.region import Ball, Box, Everywhere, ForceRange, HalfSpace, Region, RigidMotion
from touchfield.filters.registry import field_filters, filter_of, length_m, noted
from touchfield.filters.resample import (
    LOW_PASSES,
    halved,
    interpolated,
    most_levels,
    pyramid,
    rebuilt,
    resample,
)
from touchfield.measure.fidelity import FidelityMeter
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.medium.selection import evenly_spaced
from touchfield.pipeline.decoding import FILTERED, write_field
from touchfield.pipeline.encoding import encode_prepared, provenance_of
from touchfield.pipeline.preparation import Prepared, is_stream, open_scene, prepare
from touchfield.pipeline.result import Result
from touchfield.pipeline.spec import EncodeSpec
from touchfield.render.point_device import axes_matrix
from touchfield.sources.options import SourceOptions

KERNELS: Final = (*LOW_PASSES, "trilinear")


def read_medium(path: str | Path, spec: EncodeSpec | None = None) -> Prepared:
    """A .touch file, or a stored field on its own lattice; SourceError (InvalidArgument of a sample) if none."""
    if is_stream(path):
        return prepare(path, spec)
    stored = getattr(open_scene(path, SourceOptions(kind="field")), "medium", None)
    if not isinstance(stored, HapticMedium):
        raise InvalidArgument(str(path), "a scene", "a stored field", "Make it a medium: touchfield encode.")
    return prepare(stored, spec)


def fidelity_of(prepared: Prepared, received: HapticMedium) -> FidelityMeter:
    """A few frames of a medium, evenly spaced, against what a receiver of another has, by the coder's mask."""
    meter, medium = FidelityMeter(prepared.spec.k, prepared.spec.f0_n or EncodeSpec().f0_n), prepared.medium
    for n in evenly_spaced(len(medium), _LOOKED_AT):
        back = received[n]
        meter.add(medium[n], back if back.grid == medium.grid else rebuilt(back, medium.grid))
    return meter


def retimed(medium: HapticMedium, rate_hz: float) -> HapticMedium:
    """The medium at another rate, linear between its frames; its duration stays to within half a frame."""
    if medium.rate_hz == rate_hz:
        return medium
    require_positive(rate_hz=rate_hz)
    near = replace(
        medium, make_frame=lru_cache(2)(medium.__getitem__)
    )  # a frame serves several that are asked for
    count = max(1, round(len(medium) * rate_hz / medium.rate_hz))
    words = noted(medium.provenance, "resampled", f"{medium.rate_hz:g} Hz to {rate_hz:g} Hz")
    timed = replace(
        medium, rate_hz=rate_hz, frame_count=count, vibration=None, segments=None, provenance=words
    )
    return replace(timed, make_frame=lambda i: near.at(i / rate_hz))


def resampled(medium: HapticMedium, grid: Grid, kernel: str = "spline") -> HapticMedium:
    """The medium on another lattice through a low-pass, or "trilinear" between its samples."""
    require_one_of("kernel", kernel, KERNELS)
    if grid == medium.grid:
        return medium

    def make(i: int) -> ForceField:
        return interpolated(medium[i], grid) if kernel == "trilinear" else resample(medium[i], grid, kernel)

    words = noted(medium.provenance, "resampled", f"{medium.grid.words} to {grid.words}, {kernel}")
    return replace(medium, grid=grid, make_frame=make, vibration=None, segments=None, provenance=words)


def joined(
    medium: HapticMedium, like: HapticMedium, kernel: str = "spline", name: str = "the medium"
) -> tuple[HapticMedium, tuple[str, ...]]:
    """A medium in the axes, on the lattice and at the rate of another one, and notes on what that took."""
    notes: list[str] = []
    result = medium
    turn = axes_matrix(medium.axes, like.axes)
    if (turn != np.eye(3)).any():
        motion, before = RigidMotion(tuple(map(tuple, turn.tolist()))), result  # type: ignore[arg-type]
        box = np.sort(motion.points_m(np.stack(medium.grid.box_m)), axis=0)
        shape = tuple(np.abs(turn @ np.array(medium.grid.shape)).astype(int).tolist())
        grid = Grid.over_box(box[0], box[1], shape)
        result = replace(
            result, grid=grid, axes=like.axes, make_frame=lambda i: interpolated(before[i], grid, motion),
            vibration=None, segments=None,
        )  # fmt: skip
        notes.append(f"{name}: turned from {medium.axes} to {like.axes}")
    if result.grid != like.grid:
        notes.append(f"{name}: {result.grid.words} resampled to {like.grid.words}")
        places, (low, high) = result.grid.to_m(result[len(result) // 2].positions()), like.grid.box_m
        is_outside = ((places < low) | (places > high)).any(axis=1)
        if is_outside.any():
            notes.append(
                f"{name}: {100 * is_outside.mean():.3g} % of its samples lie outside, and are left out"
            )
        result = resampled(result, like.grid, kernel)
    if result.rate_hz != like.rate_hz:
        notes.append(f"{name}: {result.rate_hz:g} Hz to {like.rate_hz:g} Hz")
        result = retimed(result, like.rate_hz)
    return replace(result, axes=like.axes), tuple(notes)


def lattice_of(grid: Grid, nw: int | None, shape: Sequence[int] | None, spacing_m: float | None) -> Grid:
    """Another lattice over the box of one: 2^nw samples an axis, so many, or at such a spacing."""
    if sum(asked is not None for asked in (nw, shape, spacing_m)) > 1:
        raise InvalidArgument("lattice", "more than one of nw, shape and spacing", "one of them")
    low, high = grid.box_m
    if nw is not None:
        require_between(*NW_RANGE, nw=nw)
        return Grid.over_box(low, high, (1 << nw,) * 3)
    if shape is not None:
        return Grid.over_box(low, high, tuple(shape))  # type: ignore[arg-type]
    if spacing_m is not None:
        require_positive(**{"--spacing": spacing_m})
        x, y, z = np.maximum(1, np.rint((high - low) / spacing_m)).astype(int).tolist()
        return Grid.over_box(low, high, (x, y, z))
    return grid


_TOLD: Final = ("edits", "splices", "resampled")
_MOST_TOLD: Final = 1000  # characters of a history that a file keeps
_LOOKED_AT: Final = 8


@dataclass(frozen=True, kw_only=True)
class Written(Result):
    """A file that was made of a medium."""

    path: Path
    medium: HapticMedium


def _write(
    like: Prepared,
    sources: Sequence[str | Path],
    medium: HapticMedium,
    to: str | Path,
    report: Report,
    **shown: Any,
) -> Written:
    """Write a medium that was made of one, coded as its spec says; with the notes of the coder."""
    out = Path(to)
    keep_sources(out, *sources)
    require_ending(out, "OUT.touch", "FIELD.npz", "FIELD.vti")
    notes: tuple[str, ...] = ()
    bound: Mapping[str, Any] = {}
    if out.suffix.lower() != ".touch":
        out = write_field(out, medium, report, like.placement)
    else:
        made = replace(like, medium=medium, scene=None, exact=None, source=None, reference=FILTERED, notes=())
        history = {key: medium.provenance[key][:_MOST_TOLD] for key in _TOLD if key in medium.provenance}
        done = encode_prepared(made, out, {**provenance_of(sources[0], made), **history}, report)
        notes, bound = done.notes, done.bound
    figures = {"file": str(out), "frames": len(medium), "rate_hz": medium.rate_hz}
    figures |= {"grid_shape": list(medium.grid.shape), **shown, **bound, "file_bytes": out.stat().st_size}
    return Written(figures, notes, path=out, medium=medium)


def edit(
    source: str | Path,
    out: str | Path,
    region: str = "everywhere",
    operators: Sequence[str] = (),
    feather_m: float = 0.0,
    frames: tuple[int, int | None] | None = None,
    spec: EncodeSpec | None = None,
    report: Report = silent,
) -> Written:
    """Operators at work within a region of a medium, one after the other; outside it every sample stays as it
    was.

    `region` and `operators` are in the words of `region_of` and `operator_of`; `feather_m` is the width of
    the transition outside the region, metres, `frames` the (start, stop) of those to be edited, `spec` the
    coder's. TouchfieldError if anything is at fault; nothing is then left under the name `out`.
    """
    if not operators:
        raise InvalidArgument("--operator", "none", "at least one")
    prepared, where = read_medium(source, spec), region_of(region)
    medium = prepared.medium
    for words in operators:
        medium = edited_medium(medium, where, operator_of(words, prepared), feather_m, frames)
    start, stop = frames or (0, None)
    middle = (start + (len(medium) if stop is None else stop)) // 2
    before, after = prepared.medium[middle], medium[middle]
    done = _write(
        prepared, [source], medium, out, report,
        region=where.words, operators=list(operators), looked_at_frame=middle,
        samples_changed=(before.scaled(-1.0) + after).support_count,
    )  # fmt: skip
    is_lossy = prepared.spec.coder == "touch" and prepared.spec.touch.mode != "lossless"
    if is_lossy and where != Everywhere() and done.path.suffix == ".touch":
        note = "outside the region the field is as it was, but coded again: --mode lossless keeps its bits"
        return replace(done, notes=(*done.notes, note))
    return done


def splice(
    sources: Sequence[str],
    out: str | Path,
    fade_s: float = 0.0,
    kernel: str = "spline",
    spec: EncodeSpec | None = None,
    report: Report = silent,
) -> Written:
    """Media one after the other, on the lattice and at the rate of the first; see `joined`.

    Each source is FILE, or FILE@START:STOP for some of its frames; `fade_s` are the seconds in which one
    fades into the next, `kernel` is the resampler's, and `spec` the coder's, whose friction and damping are
    those of all. TouchfieldError if anything is at fault; nothing is then left under the name `out`.
    """
    if not sources:
        raise InvalidArgument("media to splice", "none", "at least one")
    parts: list[tuple[Path, tuple[int, int | None] | None]] = []
    for text in sources:
        name, at, words = text.rpartition("@")
        start, colon, stop = words.partition(":")
        if not at or Path(text).exists():
            parts.append((Path(text), None))
        elif colon and all(n.isdecimal() or not n for n in (start, stop)):
            parts.append((Path(name), (int(start or 0), int(stop) if stop else None)))
        else:
            raise InvalidArgument(text, f"frames {words!r}", "FILE@START:STOP, such as room.touch@0:30")
    media: list[HapticMedium] = []
    notes: tuple[str, ...] = ()
    for path, frames in parts:
        one = read_medium(path, replace(spec or EncodeSpec(), frames=frames) if is_stream(path) else spec)
        medium = one.medium
        if frames is not None and not is_stream(path):
            medium = medium.between(frames[0], len(medium) if frames[1] is None else frames[1])
        if not media:
            first = one
        else:
            medium, more = joined(medium, media[0], kernel, path.name)
            notes += more
            if one.device.force_max_n > first.device.force_max_n:
                most_n = first.device.force_max_n
                medium = replace(medium, make_frame=partial(_limited, medium, most_n))
                notes += (f"{path.name}: forces beyond {most_n:g} N are shortened to that",)
        if medium.vibration is not None and len(parts) > 1:
            notes += (f"{path.name}: the vibration is left out",)
        media.append(medium)
    require_not_negative(fade_s=fade_s)
    whole = reduce(lambda a, b: cross_faded(a, b, round(fade_s * a.rate_hz)), media)
    shown = {"parts": [len(m) for m in media], "seconds": len(whole) / whole.rate_hz}
    done = _write(first, [path for path, _ in parts], whole, out, report, **shown)
    return replace(done, notes=(*notes, *done.notes))


def _limited(medium: HapticMedium, force_max_n: float, frame: int) -> ForceField:
    return limited(medium[frame], force_max_n)


def resample_file(
    source: str | Path,
    out: str | Path,
    lattice: tuple[int | None, Sequence[int] | None, float | None] = (None, None, None),
    rate_hz: float | None = None,
    kernel: str = "spline",
    spec: EncodeSpec | None = None,
    report: Report = silent,
) -> Written:
    """A medium on another lattice over its box (`lattice_of`), or at another rate, and what a receiver then
    lacks.

    TouchfieldError if anything is at fault; nothing is then left under the name `out`.
    """
    prepared = read_medium(source, spec)
    grid = lattice_of(prepared.medium.grid, *lattice)
    if grid == prepared.medium.grid and rate_hz in (None, prepared.medium.rate_hz):
        raise InvalidArgument(
            "touchfield resample", "the lattice and the rate it has", "another lattice or rate"
        )
    on_grid = resampled(prepared.medium, grid, kernel)
    medium = retimed(on_grid, prepared.medium.rate_hz if rate_hz is None else rate_hz)
    meter = fidelity_of(prepared, on_grid)
    spacing, lost = [1e3 * h for h in grid.spacing_m], meter.mask_violation_share
    shown = {"spacing_mm": spacing, "kernel": kernel, "nmse_db": meter.nmse_db, "mask_violation_share": lost}
    done = _write(prepared, [source], medium, out, report, **shown)
    if prepared.medium.vibration is None:
        return done
    return replace(done, notes=(*done.notes, "the vibration is left out"))


def levels_of_detail(
    source: str | Path,
    out: str | Path | None = None,
    levels: int | None = None,
    most_bytes: int | None = None,
    spec: EncodeSpec | None = None,
    report: Report = silent,
) -> Result:
    """Each level of detail of a medium as a file of its own, with its bytes and what a receiver of it lacks.

    `out` is a folder for level-0.touch, level-1.touch, ..., or OUT.zarr, a store of them all (extra
    ``zarr``); without it they are only measured. `levels` is how often the lattice is halved (until 8 samples
    are left). Of the result ``levels`` are rows of figures, the finest first, and ``level`` is the finest of
    `most_bytes` or less.
    """
    prepared = read_medium(source, spec)
    medium, most = prepared.medium, most_levels(prepared.medium.grid)
    wanted = max(0, most - 3) if levels is None else levels
    require_between(0, most, levels=wanted)
    store = Path(out) if out is not None and Path(out).suffix == ".zarr" else None
    kept = None if out is None or store else Path(out)
    if kept and kept.is_file():
        raise InvalidArgument(str(out), "a file", "a folder, or OUT.zarr")
    rows: list[dict[str, Any]] = []
    with ExitStack() as leaving:
        folder = kept or Path(leaving.enter_context(tempfile.TemporaryDirectory()))
        if not folder.is_dir():
            folder.mkdir()
            leaving.callback(
                shutil.rmtree, folder, ignore_errors=True
            )  # what is broken off leaves no folder behind
        for level in range(wanted + 1):
            one = detail_level(medium, level)
            path = _write(prepared, [source], one, folder / f"level-{level}.touch", silent).path
            meter = fidelity_of(prepared, one)
            row = {"level": level, "grid_shape": list(one.grid.shape), "file_bytes": path.stat().st_size}
            beyond = meter.mask_violations / max(1, meter.supported_voxels)
            row |= {"nmse_db": meter.nmse_db, "mask_violations_per_supported_voxel": beyond}
            rows.append(row | ({"file": str(path)} if kept else {}))
            report(level + 1, wanted + 1)
        if store is not None:
            from touchfield.medium.stores.zarr_store import write_zarr

            coarser = [detail_level(medium, n) for n in range(1, wanted + 1)]
            write_zarr(store, medium, told=prepared.placement.told(), levels=coarser)
        if kept:
            leaving.pop_all()
    fits = [row["level"] for row in rows if most_bytes is None or row["file_bytes"] <= most_bytes]
    best = min(fits, default=None)
    note = (
        f"no level takes {most_bytes} bytes or less"
        if best is None
        else f"level {best} is the finest that fits"
    )
    notes: tuple[str, ...] = () if most_bytes is None else (note,)
    if medium.vibration is not None and wanted > 0:
        notes += ("levels from 1 on: the vibration is left out",)
    return Result({"level": best, "levels": rows}, notes)


def detail_level(medium: HapticMedium, level: int) -> HapticMedium:
    """The medium on a lattice that is halved so often."""
    if level == 0:
        return medium
    grid = reduce(lambda g, _: halved(g), range(level), medium.grid)

    def make(frame: int) -> ForceField:
        return pyramid(medium[frame], level)[-1]

    words = noted(medium.provenance, "resampled", f"level of detail {level}")
    return replace(medium, grid=grid, make_frame=make, vibration=None, segments=None, provenance=words)


REGIONS: Final[Mapping[str, tuple[str, Callable[..., Region]]]] = {
    "box": ("LLLLLL", lambda *v: Box(v[:3], v[3:])),
    "ball": ("LLLL", lambda *v: Ball(v[:3], v[3])),
    "half-space": ("NNNLLL", lambda *v: HalfSpace(v[:3], v[3:])),
}  # the form of its numbers, as `_numbers` reads them, and what it is made of them


def region_of(text: str) -> Region:
    """A region in words; `|` is the union, `&` what both share, `~` all that is not in it.

    ``everywhere``; ``box:X,Y,Z,X,Y,Z``, low and high corner; ``ball:X,Y,Z,RADIUS``;
    ``half-space:NX,NY,NZ,X,Y,Z``, the side that the normal points to, and a point; ``force:LOW..HIGH``
    newtons. Lengths have a unit: 2mm, -0.5cm; bounds of a box may be inf. InvalidArgument if the words make
    no sense.
    """
    for sign in "|&":
        parts = text.split(sign)
        if len(parts) > 1:
            return reduce(lambda a, b: a | b if sign == "|" else a & b, map(region_of, parts))
    word = text.strip()
    if word.startswith("~"):
        return ~region_of(word[1:])
    name, _, values = word.partition(":")
    if name == "everywhere" and not values:
        return Everywhere()
    if name == "force":
        least, _, most = values.partition("..")
        return ForceRange(*_numbers("--region force", f"{least},{most or 'inf'}", "NN"))
    if name in REGIONS:
        form, make = REGIONS[name]
        return make(*_numbers(f"--region {name}", values, form))
    raise InvalidArgument(
        "--region", repr(text), "everywhere, box:, ball:, half-space: or force:, with | & ~"
    )


OPERATORS: Final[Mapping[str, tuple[tuple[str, ...], Callable[..., EditOperator]]]] = {
    "gain": (("N",), Gain),
    "limit": (("N",), Limited),
    "move": (("LLL",), lambda *v: Moved(RigidMotion.move(v))),
    "turn": (("NNNN", "NNNNLLL"), lambda *v: Moved(RigidMotion.turn(v[:3], v[3], v[4:] or (0.0, 0.0, 0.0)))),
    "mirror": (("NNN", "NNNLLL"), lambda *v: Moved(RigidMotion.mirror(v[:3], v[3:] or (0.0, 0.0, 0.0)))),
}  # likewise of the operators that are numbers alone


def operator_of(text: str, like: Prepared) -> EditOperator:
    """An operator in words.

    ``gain:2``; ``erase``; ``limit:1.5`` newtons; ``move:DX,DY,DZ``; ``turn:AX,AY,AZ,DEGREES`` and
    ``mirror:NX,NY,NZ``, each with a point ``,X,Y,Z`` that stays; ``over:FILE``, ``add:FILE``, ``max:FILE`` or
    ``replace:FILE``, another medium, frame by frame or a still one; or a haptic filter,
    ``gaussian:sigma=2mm``. `like` is the medium to be edited: another one is brought onto its lattice.
    InvalidArgument if the words make no sense.
    """
    name, _, values = text.strip().partition(":")
    if name == "erase" and not values:
        return Erased()
    if name in OPERATORS:
        forms, make = OPERATORS[name]
        return make(*_numbers(f"--operator {name}", values, *forms))
    if name in COMPOSITIONS:
        other = read_medium(values)
        medium, _ = joined(other.medium, like.medium, name=values)
        return Composed(medium if len(medium) > 1 else medium[0], name)
    if name in field_filters():
        return filter_of(name, values)
    names = ", ".join(("gain", "erase", *list(OPERATORS)[1:], *COMPOSITIONS, *field_filters()))
    raise InvalidArgument("--operator", repr(text), f"one of {names}")


def _numbers(where: str, text: str, *forms: str) -> list[float]:
    """Numbers (N) and lengths (L, with a unit or infinite) between commas, as one of the forms has them."""
    parts = [part.strip() for part in text.split(",")]
    form = next((f for f in forms if len(f) == len(parts)), None)
    if form is None:
        expected = " or ".join(str(len(f)) for f in forms)
        raise InvalidArgument(where, repr(text), f"{expected} numbers between commas")
    numbers = []
    for part, kind in zip(parts, form, strict=True):
        try:
            is_length = kind == "L" and part.lstrip("+-") not in ("inf", "0")
            numbers.append(length_m(part, where) if is_length else float(part))
        except ValueError:
            raise InvalidArgument(where, repr(part), "a number") from None
    return numbers
