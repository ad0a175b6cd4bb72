"""`make_map`: a tactile map of a file of geographic data or a drawing, for a pin display or a force-feedback
device, with a legend, and on request for swell paper and printers."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import count, takewhile
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy import ndimage

from touchfield.arrays import Bools, Float64s
from touchfield.atomic import atomic_path
from touchfield.codec.touch.spec import TouchSpec
from touchfield.container.map_record import TactileMap
from touchfield.container.writer import with_map
from touchfield.devices import Device, device
from touchfield.errors import InvalidArgument, SourceError, require_between, require_ending
from touchfield.exchange.symbolic import ArrayEffect, effect_medium
from touchfield.filters.device_spec import device_grid
from touchfield.maps.braille import Braille
from touchfield.maps.check import Checked, check
from touchfield.maps.drawing import draw_report, plate_mm, write_stl
from touchfield.maps.features import MapSource
from touchfield.maps.guidelines import PinRules, guidelines
from touchfield.maps.labels import LegendLine, class_titles, legend_lines, legend_pages
from touchfield.maps.layout import Drawn, draw
from touchfield.maps.paper import paper_of, refuse_sheets_over, sheet_path, sheet_paths, write_svg
from touchfield.maps.pins import Window
from touchfield.maps.reader import box_of, on_level, read_map
from touchfield.maps.relief import MAX_HEIGHTS, Relief, read_relief
from touchfield.maps.symbols import symbol_of
from touchfield.maps.zooms import MAX_LEVELS, Level, draw_levels
from touchfield.pipeline.encoding import encode_prepared
from touchfield.pipeline.map_index import MapTexts, map_record
from touchfield.pipeline.preparation import prepare
from touchfield.pipeline.provenance import file_provenance
from touchfield.pipeline.source import FixedLatticeScene
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.terrain.height_scene import HeightScene

POINT_PITCH_MM: Final = 2.5
"""Distance of the virtual pins on a device that is a point: that of pin displays."""
POINT_HEIGHT_MM: Final = 4.0
"""Height of symbols under the point of a device: our choice, above the spacing of its lattice of 2^6."""
FRAME_RATE_HZ: Final = 1.0
"""Of a medium of one frame."""


@dataclass(frozen=True)
class MapSpec:
    """What is requested of a map.

    device : str; Name of a profile, or the path of one.
    box : four floats or None; West, south, east and north in degrees, or left, top, right and bottom of a
        drawing; None is everything.
    level : str or None; The floor of a building.
    language : str; Of the Braille: a key of `touchfield.maps.braille.TABLES`, or a table of liblouis.
    has_labels : bool; False draws symbols only.
    relief : path or None; Heights of the land beneath the map, such as a GeoTIFF in degrees.
    interval_m : float or None; Difference in height of neighbouring contour lines. None takes one that gives
        few lines.
    zooms : int or None; Zoom levels for a display, 1 to `touchfield.maps.zooms.MAX_LEVELS`. None makes
        as many as show every feature and name, at most `touchfield.maps.zooms.DEFAULT_LEVELS`.
    """

    device: str = "graphiti"
    box: tuple[float, float, float, float] | None = None
    level: str | None = None
    language: str = "en"
    has_labels: bool = True
    zooms: int | None = None
    relief: str | Path | None = None
    interval_m: float | None = None

    def __post_init__(self) -> None:
        if self.interval_m is not None and self.relief is None:
            found = f"{self.interval_m:g} m without a relief"
            raise InvalidArgument("--interval-m", found, "heights for contour lines: --relief DEM.tif")
        if self.zooms is not None:
            require_between(1, MAX_LEVELS, zooms=self.zooms)


@dataclass(frozen=True)
class MadeMap:
    """A map that was made.

    drawn : Drawn; What is on the pins.
    checked : Checked; What the guidelines' check found.
    pages : tuple of bool [rows, columns]; The legend.
    lines : tuple of LegendLine; Its lines.
    files : tuple of Path; Every file that was written.
    figures : dict; Stable keys for people and programs.
    notes : tuple of str
    """

    drawn: Drawn
    checked: Checked
    pages: tuple[Bools, ...]
    lines: tuple[LegendLine, ...]
    files: tuple[Path, ...]
    figures: dict[str, Any]
    notes: tuple[str, ...]

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        return dict(self.figures)

    def draw(self, path: Path) -> None:
        """Draw the pins and the legend as PNG; needs matplotlib."""
        draw_report(path, self.drawn.layout, self.pages, self.lines, self.figures["title"])


def legend_path(out: Path, page: int) -> Path:
    """Return the file of a page of the legend, counted from 1, beside that of its map."""
    return out.with_name(f"{out.stem}.legend-{page}{out.suffix}")


def _earlier_parts(
    part_path: Callable[[Path, int], Path], path: Path, first: int, source: str | Path
) -> tuple[str, ...]:
    """Return a note on parts from number `first` on: an earlier map of this name had more than this one.

    The drawing that was read is none of them, whatever its name is.
    """
    found = takewhile(Path.exists, (part_path(path, n) for n in count(first)))
    files = [file for file in found if file.absolute() != Path(source).absolute()]
    if not files:
        return ()
    names = ", ".join(file.name for file in files)
    return (f"Of an earlier map, not of this one: {names}. Remove {'them' if files[1:] else 'it'}.",)


def make_map(
    source: str | Path,
    out: str | Path,
    spec: MapSpec | None = None,
    *,
    svg: str | Path | None = None,
    stl: str | Path | None = None,
) -> MadeMap:
    """Make a tactile map.

    `source` is GeoJSON, an extract of OpenStreetMap (``.osm``, ``.osm.pbf``), an SVG drawing, or the sample
    ``sample:park``. `out` is a
    medium of one frame for the device, with zoom levels and an index of names for a display; the pages of its
    legend are ``OUT.legend-1.touch`` and so on. `svg` is a drawing for swell paper, with the legend, on as
    many sheets as it takes (`touchfield.maps.paper`); `stl` a plate for printers.

    Raises TouchfieldError if the source cannot be read, nothing can be drawn, or labels are requested and
    liblouis is missing; no file is then left.
    """
    spec, path = spec or MapSpec(), Path(out)
    require_ending(path, "OUT.touch")
    if svg is not None:
        require_ending(svg, "DRAWING.svg")
    if stl is not None:
        require_ending(stl, "PLATE.stl")
    target = device(spec.device)
    rows, columns, rules = _pins_of(target)
    read = read_map(source)
    read = on_level(read, spec.level) if spec.level is not None else read
    box = box_of(read, spec.box)
    window = Window.around(*box, rows, columns)
    braille = _braille(read, spec, rules)
    relief, relief_notes = _relief(read, window, spec)
    drawn = draw(read.features, window, rules, braille, relief)
    if not drawn.layout.symbols:
        found = f"nothing that is large enough for {rows} x {columns} pins"
        raise SourceError(str(source), found, "a feature of a line's or a symbol's size", _SMALLER)
    titles = class_titles(spec.language, relief.interval_m if relief else None)
    lines = legend_lines(drawn.layout, drawn.labels, titles) if braille else ()
    pages, page_notes = legend_pages(lines, braille, rows, columns, rules) if braille else ((), ())
    title = read.title or Path(source).name
    levels, zoom_notes = _levels(read, box, (window, drawn), braille, spec, target, relief)
    record, index_notes = map_record(read, box, levels, MapTexts(title, spec.language, titles), braille)
    heights_m = relief.under_m(window) if relief else None
    if svg is not None:
        refuse_sheets_over(source, sheet_paths(Path(svg), drawn.layout, len(pages)))
    files = _write(path, drawn, pages, target, source, record, heights_m)
    page_notes += _earlier_parts(legend_path, path, len(files), source)
    if svg is not None:
        sheets = write_svg(Path(svg), drawn.layout, pages, lines, title, read.attribution)
        page_notes += _earlier_parts(sheet_path, Path(svg), len(sheets) + 1, source)
        files += sheets
    if stl is not None:
        write_stl(Path(stl), drawn.layout, _land_mm(heights_m, "print_relief_mm"))
        files += (Path(stl),)
    checked = check(drawn.layout)
    figures = _figures(read, window, target, drawn, checked, lines, files) | {"title": title}
    if svg is not None:
        figures["paper"] = paper_of(drawn.layout)[0] or None
        if figures["paper"] is None:
            page_notes += (f"{svg} is larger than A3: a map for another display fits on it (--device).",)
    if relief is not None:
        figures |= {"relief": _relief_figures(relief, drawn)}
        has_land = stl is not None or not target.is_array
        relief_notes += _relief_notes(relief, levels, has_land=has_land)
    if target.is_array:
        figures |= _level_figures(levels, record)
    elsewhere = figures["violations"] - len(checked.violations)
    if elsewhere:
        zoom_notes += (f"Against the guidelines: {elsewhere} violations in the views of the zoom levels.",)
    pages_left_out = bool(pages) and not target.is_array
    notes = _notes(read, drawn, checked, braille, pages_left_out=pages_left_out)
    notes += (*relief_notes, *zoom_notes, *index_notes, *page_notes)
    return MadeMap(drawn, checked, pages, lines, files, figures, notes)


_SMALLER: Final = "Draw a smaller part: --box."


def _pins_of(target: Device) -> tuple[int, int, PinRules]:
    """Return rows and columns of pins of a device and the rules for them; virtual pins under a point."""
    if not target.is_array:
        columns, rows = (1 + math.floor(side / POINT_PITCH_MM) for side in target.workspace_mm[:2])
        return rows, columns, PinRules(POINT_PITCH_MM)
    if target.shows != "height" or target.pitch_mm is None:
        raise InvalidArgument(
            "device", f"{target.name}, an array of motors", "a pin display, or a point device"
        )
    return target.lattice[1], target.lattice[0], PinRules(target.pitch_mm)


def _braille(read: MapSource, spec: MapSpec, rules: PinRules) -> Braille | None:
    """Return the translator, or None if no labels are requested."""
    if not spec.has_labels:
        return None
    if not rules.can_write_braille:
        found = f"pins {rules.pitch_mm:g} mm apart"
        raise InvalidArgument("labels", found, "the pitch of Braille, about 2.5 mm", "Use --no-labels.")
    return Braille(spec.language)


def _levels(
    read: MapSource,
    box: tuple[Float64s, Float64s],
    whole: tuple[Window, Drawn],
    braille: Braille | None,
    spec: MapSpec,
    target: Device,
    relief: Relief | None,
) -> tuple[tuple[Level, ...], tuple[str, ...]]:
    """Draw the zoom levels of a map for a display; a point device shows the whole map only."""
    if target.is_array:
        return draw_levels(read.features, box, whole, braille, spec.zooms, relief)
    levels, _ = draw_levels(read.features, box, whole, braille, 1)
    note = f"{target.name}, a point device, shows the whole map: zoom levels are for pin displays."
    return levels, (note,) if (spec.zooms or 1) > 1 else ()


def _write(
    path: Path,
    drawn: Drawn,
    pages: tuple[Bools, ...],
    target: Device,
    source: str | Path,
    record: TactileMap,
    heights_m: Float64s | None,
) -> tuple[Path, ...]:
    if not target.is_array:
        land_mm = _land_mm(heights_m, "point_relief_mm")
        heights_mm, spacing_mm = plate_mm(drawn.layout, POINT_HEIGHT_MM, land_mm, 0.0)
        scene = HeightScene(heights_mm / 1000, (spacing_mm / 1000,) * 2, name=Path(source).name)
        prepared = prepare(scene, EncodeSpec(device=target.name))
        encode_prepared(prepared, path, file_provenance(source, prepared))
        return (path,)
    files = [path, *(legend_path(path, n + 1) for n in range(len(pages)))]
    with atomic_path(path) as temporary:
        _write_pins(temporary, drawn.layout.raised, target, source)
        temporary.write_bytes(with_map(temporary.read_bytes(), record))
        for file, pins in zip(files[1:], pages):
            _write_pins(file, pins, target, source)
    return tuple(files)


def _write_pins(path: Path, pins: Bools, target: Device, source: str | Path) -> None:
    """Write pins that are up or down as a medium of one frame."""
    effect = ArrayEffect(FRAME_RATE_HZ, pins[None].astype(np.float32))
    medium = effect_medium(effect, device_grid(target), target.force_max_n, {"format": "map"})
    scene = FixedLatticeScene(medium, target, ())
    spec = EncodeSpec(device=target.name, nw=None, touch=TouchSpec(mode="lossless"))
    prepared = prepare(scene, spec)
    encode_prepared(prepared, path, file_provenance(source, prepared))


# -- relief ------------------------------------------------------------------------------------------------
def _relief(read: MapSource, window: Window, spec: MapSpec) -> tuple[Relief | None, tuple[str, ...]]:
    if spec.relief is None:
        return None, ()
    relief, notes = read_relief(spec.relief, read, window)
    if spec.interval_m is not None:
        relief.use_interval(spec.interval_m)
    return relief, notes


def _land_mm(heights_m: Float64s | None, rule: str) -> Float64s | None:
    """Return heights under the pins as those of a plate, from 0 to the height of a rule, [rows, columns].

    Where the land is unknown it has the height of the nearest pin that is known: an edge would be felt.
    """
    if heights_m is None:
        return None
    nearest = ndimage.distance_transform_edt(np.isnan(heights_m), return_distances=False, return_indices=True)
    heights_m = heights_m[tuple(nearest)]
    above_m = heights_m - heights_m.min()
    range_m = max(float(above_m.max()), float(guidelines()["min_interval_m"].value))  # plains stay flat
    return np.asarray(above_m * (float(guidelines()[rule].value) / range_m))


def _relief_figures(relief: Relief, drawn: Drawn) -> dict[str, Any]:
    pins, drawn_pins = drawn.contour_pins
    return {
        "low_m": relief.low_m,
        "high_m": relief.high_m,
        "interval_m": relief.interval_m,
        "known_fraction": relief.known_fraction,
        "contour_pins": f"{drawn_pins} of {pins}",
    }


def _relief_notes(relief: Relief, levels: tuple[Level, ...], *, has_land: bool) -> tuple[str, ...]:
    notes = []
    unknown, (pins, drawn_pins) = 1 - relief.known_fraction, levels[0].views[0].contour_pins
    if unknown > 0:
        instead = ", and the land is level with its edge" if has_land else ""
        notes.append(
            f"The relief is unknown under {_percent(unknown)} of the pins: no contour lines{instead}."
        )
    if not pins:
        notes.append(
            f"No contour line: heights of {relief.low_m:.6g} to {relief.high_m:.6g} m, an interval of "
            f"{relief.interval_m:g} m (--interval-m)."
        )
    elif drawn_pins < pins:
        notes.append(
            f"{_percent(1 - drawn_pins / pins)} of the contour lines are left out on the whole map: they are "
            "where symbols are, too close to others, or too short."
        )
    if relief.steep_views:
        notes.append(
            f"{relief.steep_views} views have no contour lines: more than {MAX_HEIGHTS} would cross them "
            "(--interval-m)."
        )
    return tuple(notes)


def _percent(fraction: float) -> str:
    return f"{max(1, round(100 * fraction))} %"


# -- report ------------------------------------------------------------------------------------------------
def _figures(
    read: MapSource,
    window: Window,
    target: Device,
    drawn: Drawn,
    checked: Checked,
    lines: tuple[LegendLine, ...],
    files: tuple[Path, ...],
) -> dict[str, Any]:
    pitch_mm = drawn.layout.rules.pitch_mm
    scale = (
        {} if read.unit_m is None else {"scale": f"1:{round(1000 * read.unit_m * window.step / pitch_mm)}"}
    )
    return {
        "device": target.name,
        "pins": f"{window.columns} x {window.rows}, {pitch_mm:g} mm apart",
        **scale,
        "features": len(read.features),
        "drawn": {kind: f"{count} of {seen}" for kind, (seen, count) in drawn.counts.items()},
        "pins_up": int(drawn.layout.raised.sum()),
        "min_gap_mm": checked.min_gap_mm,
        "required_gap_mm": float(guidelines()["gap_mm"].value),
        "violations": len(checked.violations),
        "labels": len(drawn.labels),
        "legend": [{"shows": line.shows, "text": line.text} for line in lines],
        "unlabelled": list(drawn.unlabelled),
        "attribution": read.attribution or None,
        "files": [str(file) for file in files],
    }


def _level_figures(levels: tuple[Level, ...], record: TactileMap) -> dict[str, Any]:
    """Return what the zoom levels and the index have, and what a check of every view finds."""
    checked = [check(drawn.layout) for level in levels for drawn in level.views]
    return {
        "zoom_levels": len(levels),
        "views": len(record.views),
        "violations": sum(len(found.violations) for found in checked),
        "named_features": len(record.places),
        "names_on_no_level": sum(place.first_level == len(levels) for place in record.places),
    }


def _title(kind: str) -> str:
    symbol = symbol_of(kind)
    return kind if symbol is None else symbol.titled("en")


def _notes(
    read: MapSource,
    drawn: Drawn,
    checked: Checked,
    braille: Braille | None,
    *,
    pages_left_out: bool,
) -> tuple[str, ...]:
    notes = [*read.notes, *drawn.notes]
    notes += [
        f"Not drawn on the whole map: {seen - count} of {seen} ({_title(kind)}): too small, too close to "
        "others, or outside."
        for kind, (seen, count) in drawn.counts.items()
        if count < seen
    ]
    names = sum(bool(feature.name) for feature in read.features)
    if braille is None and names:
        notes.append(f"{names} {'name is' if names == 1 else 'names are'} not shown: --no-labels.")
    if drawn.unlabelled:
        shown = ", ".join(drawn.unlabelled[:8])
        notes.append(f"No label on the whole map, for want of room or of letters: {shown}.")
    if braille is not None and braille.unknown:
        unknown = ", ".join(sorted(braille.unknown)[:5])
        notes.append(
            f"{braille.table} lacks letters of these texts, which are left out: {unknown}. --language takes "
            "any table of liblouis."
        )
    if pages_left_out:
        notes.append("A point device gets no pages of the legend: it is in this report, and in the --svg.")
    notes += [f"Against the guidelines: {text}" for text in checked.violations]
    return tuple(dict.fromkeys(notes))
