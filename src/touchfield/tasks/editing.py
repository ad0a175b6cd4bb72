"""Makes new files from stored media: edits a region, joins or resamples them, or makes levels of detail
(paper section 4).

Every result is a new file, coded like any medium; its provenance records the edits.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial, reduce
from pathlib import Path
from typing import Any, Final

from touchfield.compute.threads import Progress, silent
from touchfield.container import TouchReader
from touchfield.container.map_record import MAP_LEFT_OUT
from touchfield.errors import InvalidArgument, require_between, require_ending, require_not_negative
from touchfield.files import refuse_overwriting
from touchfield.filters.edit import cross_fade, edit_medium
from touchfield.filters.limit import limit_forces
from touchfield.filters.region import Everywhere
from touchfield.filters.registry import add_note
from touchfield.filters.resample import half_grid, max_levels, pyramid, rebuild_level
from touchfield.measure.fidelity import FidelityMeter
from touchfield.medium import ForceField, HapticMedium
from touchfield.medium.selection import evenly_spaced
from touchfield.pipeline.decoding import write_field
from touchfield.pipeline.encoding import encode_prepared
from touchfield.pipeline.preparation import Prepared
from touchfield.pipeline.provenance import file_provenance
from touchfield.pipeline.result import Result
from touchfield.pipeline.source import is_stream
from touchfield.pipeline.spec import EncodeSpec
from touchfield.pipeline.stream import FILTERED
from touchfield.tasks.edit_syntax import operator_of, region_of
from touchfield.tasks.matching import change_lattice, change_rate, lattice_of, match_medium, read_medium


def fidelity_of(prepared: Prepared, received: HapticMedium) -> FidelityMeter:
    """Compare some evenly spaced frames of a medium with a received one.

    The mask is that of the coder.
    """
    spec, medium = prepared.spec, prepared.medium
    meter = FidelityMeter(spec.weber, spec.f0_n or EncodeSpec().f0_n)
    for n in evenly_spaced(len(medium), _COMPARED_FRAMES):
        decoded = received[n]
        meter.add(medium[n], decoded if decoded.grid == medium.grid else rebuild_level(decoded, medium.grid))
    return meter


_HISTORY_KEYS: Final = ("edits", "splices", "resampled")
_MAX_HISTORY: Final = 1000  # maximum characters of a history in a file's provenance
_COMPARED_FRAMES: Final = 8


@dataclass(frozen=True, kw_only=True)
class WrittenMedium(Result):
    """A written file and its medium."""

    path: Path
    medium: HapticMedium


def write_result(
    like: Prepared,
    sources: Sequence[str | Path],
    medium: HapticMedium,
    to: str | Path,
    report: Progress,
    **extra_figures: Any,
) -> WrittenMedium:
    """Write a medium that was derived from `like`, coded by its spec.

    `sources` are the files it was made of, which are not overwritten. `extra_figures` are added to the
    figures of the result, whose notes are those of the coder.
    """
    out = Path(to)
    refuse_overwriting(out, *sources)
    require_ending(out, "OUT.touch", "FIELD.npz", "FIELD.vti")
    notes: tuple[str, ...] = ()
    map_notes = _map_notes(sources)
    bound: Mapping[str, Any] = {}
    if out.suffix.lower() != ".touch":
        out = write_field(out, medium, report, like.placement)
    else:
        result = replace(
            like, medium=medium, objects=None, exact=None, source=None, reference=FILTERED, notes=()
        )
        history = {
            key: medium.provenance[key][:_MAX_HISTORY] for key in _HISTORY_KEYS if key in medium.provenance
        }
        done = encode_prepared(result, out, {**file_provenance(sources[0], result), **history}, report)
        notes, bound = done.notes, done.bound
    figures = {"file": str(out), "frames": len(medium), "rate_hz": medium.rate_hz}
    figures |= {
        "grid_shape": list(medium.grid.shape),
        **extra_figures,
        **bound,
        "file_bytes": out.stat().st_size,
    }
    return WrittenMedium(figures, (*notes, *map_notes), path=out, medium=medium)


def _map_notes(sources: Sequence[str | Path]) -> tuple[str, ...]:
    """Return a note for each source that is a tactile map, of which the frame alone is edited."""
    paths = [Path(source) for source in sources]
    files = [path for path in paths if path.suffix.lower() == ".touch" and path.is_file()]
    notes = []
    for path in files:
        with TouchReader(path) as reader:
            if reader.has_map:
                notes.append(f"{path.name}: {MAP_LEFT_OUT}")
    return tuple(notes)


def edit(
    source: str | Path,
    out: str | Path,
    region: str = "everywhere",
    operators: Sequence[str] = (),
    feather_m: float = 0.0,
    frames: tuple[int, int | None] | None = None,
    spec: EncodeSpec | None = None,
    report: Progress = silent,
) -> WrittenMedium:
    """Apply operators to a region of a medium, in order.

    Samples outside the region are unchanged.

    `region` and `operators` have the syntax of `region_of` and `operator_of`. `feather_m` is the width in
    metres of the transition outside the region, `frames` the (start, stop) of the edited frames, `spec` that
    of the coder. Raises TouchfieldError; no file `out` is then left.
    """
    if not operators:
        raise InvalidArgument("--operator", "none", "at least one")
    prepared, selection = read_medium(source, spec), region_of(region)
    medium = prepared.medium
    for operator in operators:
        medium = edit_medium(medium, selection, operator_of(operator, prepared), feather_m, frames)
    start, stop = frames or (0, None)
    middle = (start + (len(medium) if stop is None else stop)) // 2
    before, after = prepared.medium[middle], medium[middle]
    written = write_result(
        prepared, [source], medium, out, report,
        region=selection.text, operators=list(operators), looked_at_frame=middle,
        samples_changed=(before.scaled(-1.0) + after).support_count,
    )  # fmt: skip
    is_lossy = prepared.spec.coder == "touch" and prepared.spec.touch.mode != "lossless"
    if is_lossy and selection != Everywhere() and written.path.suffix == ".touch":
        note = "the field outside the region is unchanged, but coded again: --mode lossless keeps its bits"
        return replace(written, notes=(*written.notes, note))
    return written


def splice(
    sources: Sequence[str],
    out: str | Path,
    fade_s: float = 0.0,
    kernel: str = "spline",
    spec: EncodeSpec | None = None,
    report: Progress = silent,
) -> WrittenMedium:
    """Join media in time, on the lattice and at the rate of the first (`match_medium`).

    Each source is FILE, or FILE@START:STOP for some of its frames. `fade_s` is the duration in seconds of a
    cross-fade, `kernel` the resampler, and `spec` that of the coder, whose friction and damping apply to all.
    Raises TouchfieldError; no file `out` is then left.
    """
    if not sources:
        raise InvalidArgument("media to splice", "none", "at least one")
    parts: list[tuple[Path, tuple[int, int | None] | None]] = []
    for text in sources:
        name, separator, frames_text = text.rpartition("@")
        start, colon, stop = frames_text.partition(":")
        if not separator or Path(text).exists():
            parts.append((Path(text), None))
        elif colon and all(n.isdecimal() or not n for n in (start, stop)):
            parts.append((Path(name), (int(start or 0), int(stop) if stop else None)))
        else:
            raise InvalidArgument(text, f"frames {frames_text!r}", "FILE@START:STOP, such as room.touch@0:30")
    media: list[HapticMedium] = []
    notes: tuple[str, ...] = ()
    for path, frames in parts:
        prepared = read_medium(
            path, replace(spec or EncodeSpec(), frames=frames) if is_stream(path) else spec
        )
        medium = prepared.medium
        if frames is not None and not is_stream(path):
            medium = medium.between(frames[0], len(medium) if frames[1] is None else frames[1])
        if not media:
            first = prepared
        else:
            medium, more = match_medium(medium, media[0], kernel, path.name)
            notes += more
            if prepared.device.force_max_n > first.device.force_max_n:
                force_max_n = first.device.force_max_n
                medium = replace(medium, make_frame=partial(_limited, medium, force_max_n))
                notes += (f"{path.name}: forces above {force_max_n:g} N are clipped to it",)
        if medium.vibration is not None and len(parts) > 1:
            notes += (f"{path.name}: the vibration is left out",)
        media.append(medium)
    require_not_negative(fade_s=fade_s)
    spliced = reduce(lambda a, b: cross_fade(a, b, round(fade_s * a.rate_hz)), media)
    figures = {"parts": [len(m) for m in media], "seconds": len(spliced) / spliced.rate_hz}
    written = write_result(first, [path for path, _ in parts], spliced, out, report, **figures)
    return replace(written, notes=(*notes, *written.notes))


def _limited(medium: HapticMedium, force_max_n: float, frame: int) -> ForceField:
    return limit_forces(medium[frame], force_max_n)


def resample_file(
    source: str | Path,
    out: str | Path,
    lattice: tuple[int | None, Sequence[int] | None, float | None] = (None, None, None),
    rate_hz: float | None = None,
    kernel: str = "spline",
    spec: EncodeSpec | None = None,
    report: Progress = silent,
) -> WrittenMedium:
    """Write a medium on another lattice over its box (`lattice_of`), or at another rate.

    The figures include the error of a receiver that interpolates back to the old lattice. Raises
    TouchfieldError; no file `out` is then left.
    """
    prepared = read_medium(source, spec)
    grid = lattice_of(prepared.medium.grid, *lattice)
    if grid == prepared.medium.grid and rate_hz in (None, prepared.medium.rate_hz):
        raise InvalidArgument(
            "touchfield resample", "the lattice and the rate it has", "another lattice or rate"
        )
    on_grid = change_lattice(prepared.medium, grid, kernel)
    medium = change_rate(on_grid, prepared.medium.rate_hz if rate_hz is None else rate_hz)
    meter = fidelity_of(prepared, on_grid)
    spacing, violations = [1e3 * h for h in grid.spacing_m], meter.mask_violation_share
    figures = {
        "spacing_mm": spacing,
        "kernel": kernel,
        "nmse_db": meter.nmse_db,
        "mask_violation_share": violations,
    }
    written = write_result(prepared, [source], medium, out, report, **figures)
    if prepared.medium.vibration is None:
        return written
    return replace(written, notes=(*written.notes, "the vibration is left out"))


def levels_of_detail(
    source: str | Path,
    out: str | Path | None = None,
    levels: int | None = None,
    max_bytes: int | None = None,
    spec: EncodeSpec | None = None,
    report: Progress = silent,
) -> Result:
    """Write each level of detail of a medium as a file; report its size and error.

    `out` is a folder for level-0.touch, level-1.touch, ..., or OUT.zarr, a store of all levels (extra
    ``zarr``); without it the levels are only measured. `levels` is the number of times that the lattice is
    halved (default: until 8 samples are left). In the result, ``levels`` has a row of figures for each level,
    the finest first, and ``level`` is the finest level of `max_bytes` or less.
    """
    prepared = read_medium(source, spec)
    medium, max_level = prepared.medium, max_levels(prepared.medium.grid)
    last_level = max(0, max_level - 3) if levels is None else levels
    require_between(0, max_level, levels=last_level)
    store = Path(out) if out is not None and Path(out).suffix == ".zarr" else None
    out_folder = None if out is None or store else Path(out)
    if out_folder and out_folder.is_file():
        raise InvalidArgument(str(out), "a file", "a folder, or OUT.zarr")
    rows: list[dict[str, Any]] = []
    with ExitStack() as cleanup:
        folder = out_folder or Path(cleanup.enter_context(tempfile.TemporaryDirectory()))
        if not folder.is_dir():
            folder.mkdir()
            cleanup.callback(shutil.rmtree, folder, ignore_errors=True)  # after an error no folder is left
        for level in range(last_level + 1):
            level_medium = detail_level(medium, level)
            path = write_result(
                prepared, [source], level_medium, folder / f"level-{level}.touch", silent
            ).path
            meter = fidelity_of(prepared, level_medium)
            row = {
                "level": level,
                "grid_shape": list(level_medium.grid.shape),
                "file_bytes": path.stat().st_size,
            }
            violations = meter.mask_violations / max(1, meter.supported_voxels)
            row |= {"nmse_db": meter.nmse_db, "mask_violations_per_supported_voxel": violations}
            rows.append(row | ({"file": str(path)} if out_folder else {}))
            report(level + 1, last_level + 1)
        if store is not None:
            from touchfield.medium.stores.zarr_store import write_zarr

            coarser = [detail_level(medium, n) for n in range(1, last_level + 1)]
            write_zarr(store, medium, attributes=prepared.placement.to_dict(), levels=coarser)
        if out_folder:
            cleanup.pop_all()
    fits = [row["level"] for row in rows if max_bytes is None or row["file_bytes"] <= max_bytes]
    best = min(fits, default=None)
    notes: tuple[str, ...] = ()
    if max_bytes is not None and best is None:
        notes = (f"no level takes {max_bytes} bytes or less",)
    elif max_bytes is not None:
        notes = (f"level {best} is the finest that fits",)
    lost = [str(row["level"]) for row in rows if row["nmse_db"] is not None and row["nmse_db"] > 0]
    if lost:
        numbers = f"level {lost[0]}" if len(lost) == 1 else f"levels {', '.join(lost)}"
        notes += (f"{numbers}: farther from the medium than no force at all; it is finer than this lattice",)
    if medium.vibration is not None and last_level > 0:
        notes += ("levels from 1 on: the vibration is left out",)
    return Result({"level": best, "levels": rows}, notes)


def detail_level(medium: HapticMedium, level: int) -> HapticMedium:
    """Return the medium on its lattice halved `level` times."""
    if level == 0:
        return medium
    grid = reduce(lambda g, _: half_grid(g), range(level), medium.grid)

    def make(frame: int) -> ForceField:
        return pyramid(medium[frame], level)[-1]

    provenance = add_note(medium.provenance, "resampled", f"level of detail {level}")
    return replace(medium, grid=grid, make_frame=make, vibration=None, segments=None, provenance=provenance)
