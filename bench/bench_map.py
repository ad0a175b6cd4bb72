"""Measures tactile maps: distances on the pins of every zoom level, labels, the time of a pan, and of making.

    python bench/bench_map.py [--quick] [--views N] [--moves N] [--features N]

Three extracts of OpenStreetMap and three school diagrams (``tests/maps/inputs``), on 60 x 40 pins. Of each
level, up to `views` random views are drawn, checked against the guidelines, pair by pair of raised pins, and
compared with the pins in the file. Labels are read back from the pins of the file and compared with what
liblouis gives for their text; without liblouis they are left out. The first two are drawn again above hills,
a GeoTIFF of 256 x 256 samples, with contour lines every 10 m.

A pan is a random move: find the view, expand it, and give it to the display. Its time is processor time.
Making is measured in a process of its own: a town of blocks, and a hostile file of random streets, each of
which crosses the whole map.
"""

from __future__ import annotations

import json
import random
import resource
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any

import numpy as np

from machine import Bar, Figures, at_least, at_most, bench, figure, not_measured
from touchfield.container import TouchReader
from touchfield.devices import device
from touchfield.errors import InvalidArgument, MissingExtra
from touchfield.maps.braille import Braille, cells_of
from touchfield.maps.check import check
from touchfield.maps.features import MapSource
from touchfield.maps.guidelines import PinRules
from touchfield.maps.layout import draw
from touchfield.maps.pins import Window
from touchfield.maps.reader import box_of, metres_of_degree, read_map
from touchfield.maps.relief import read_relief
from touchfield.maps.zooms import draw_levels
from touchfield.pipeline.stored_map import Position, StoredMap
from touchfield.tasks.map import MapSpec, make_map
from touchfield.tasks.map_play import MapWalk, SimulatedDisplay

INPUTS = Path(__file__).resolve().parents[1] / "tests" / "maps" / "inputs"
SOURCES = (
    "crossing.osm.pbf", "park.osm.pbf", "floor_plan.geojson", "triangle.svg", "parabola.svg", "cell.svg",
)  # fmt: skip
LEVELS, ROWS, COLUMNS, PITCH_MM = 4, 40, 60, 2.5
RELIEF_SAMPLES, INTERVAL_M = 256, 10.0
MOVES = ("left", "right", "up", "down", "in", "out")
MAKE = """
import json, sys
from touchfield.tasks.map import MapSpec, make_map
made = make_map(sys.argv[1], sys.argv[2], MapSpec(has_labels=sys.argv[3] == "labels"))
print(json.dumps({"levels": made.figures["zoom_levels"], "views": made.figures["views"]}))
"""


def translator() -> Braille | None:
    """Return the translator of liblouis, None where it is missing."""
    try:
        return Braille("en")
    except InvalidArgument:
        return None


def stored_map(path: Path) -> StoredMap:
    """Return the map of a file."""
    with TouchReader(path) as reader:
        record = reader.read_map()
    assert record is not None
    return StoredMap(record, path.name)


# -- the pins ----------------------------------------------------------------------------------------------
def sources(folder: Path, views: int) -> Figures:
    """Draw, check and read back the views of each source."""
    figures = {name: source(INPUTS / name, folder / f"{name}.touch", views) for name in SOURCES}
    for name in SOURCES[:2]:
        out = folder / f"{name}.relief.touch"
        figures[f"{name}, relief"] = source(INPUTS / name, out, views, has_relief=True)
    return figures


def source(path: Path, out: Path, views: int, *, has_relief: bool = False) -> Figures | str:
    """Check up to `views` views of each level of a source, drawn anew and as stored."""
    braille, rng = translator(), random.Random(1)
    try:
        read = read_map(path)
        box = box_of(read, None)
        window = Window.around(*box, ROWS, COLUMNS)
        heights = hills(out.with_suffix(".tif"), read, window) if has_relief else None
        spec = MapSpec(
            zooms=LEVELS,
            has_labels=braille is not None,
            relief=heights,
            interval_m=INTERVAL_M if has_relief else None,
        )
        make_map(path, out, spec)
    except MissingExtra as error:
        return not_measured(str(error))
    stored = stored_map(out)
    relief = None
    if heights is not None:
        relief, _ = read_relief(heights, read, window)
        relief.use_interval(INTERVAL_M)
    whole = draw(read.features, window, PinRules(PITCH_MM), braille, relief)
    levels, _ = draw_levels(read.features, box, (window, whole), braille, LEVELS, relief)
    row: Figures = {"levels": len(levels), "views": 0, "violations": 0, "views that differ": 0}
    gaps_mm, agree, labels = [], 0, 0
    contour_pins = np.zeros(2, np.int64)
    for n, level in enumerate(levels):
        indices = rng.sample(range(len(level.views)), min(views, len(level.views)))
        for index in indices:
            position = Position(n, *divmod(index, level.grid.view_columns))
            found = check(level.views[index].layout)
            same = np.array_equal(level.views[index].layout.raised, stored.view(position).raised)
            row["views"] += 1
            row["violations"] += len(found.violations)
            row["views that differ"] += not same
            contour_pins += level.views[index].contour_pins
            gaps_mm += [] if found.min_gap_mm is None else [found.min_gap_mm]
            if braille is not None:
                right, count = labels_read(stored, position, braille)
                agree, labels = agree + right, labels + count
    if has_relief:
        row |= {"pins on contour lines": int(contour_pins[0]), "of them drawn": int(contour_pins[1])}
    return row | {
        "least gap, mm": min(gaps_mm),
        "labels": labels,
        "labels as liblouis": agree,
        # Without labels the file is another one.
        "map bytes": out.stat().st_size if braille is not None else not_measured("liblouis is missing"),
    }


def hills(path: Path, read: MapSource, window: Window) -> Path:
    """Write hills of 120 m beneath a map as GeoTIFF in degrees, a tenth larger than the map all around."""
    import tifffile

    size_m = 1.2 * window.step * np.array([window.columns, window.rows])
    middle_m = np.array([window.west, window.north]) + window.step / 2 * np.array(
        [window.columns - 1, 1 - window.rows]
    )
    origin_deg = np.array(read.origin_deg)
    degree_m = metres_of_degree(origin_deg[1])
    west, north = (middle_m + size_m * (-0.5, 0.5)) / degree_m + origin_deg
    cell_deg = size_m / degree_m / RELIEF_SAMPLES
    x, y = np.meshgrid(*[np.linspace(0, 1, RELIEF_SAMPLES)] * 2)
    heights = 400 + 60 * x + 30 * np.sin(9 * x + 4 * y) * np.cos(7 * y - 3 * x)
    geo_keys = (1, 1, 0, 3, 1024, 0, 1, 2, 1025, 0, 1, 1, 2048, 0, 1, 4326)
    tags = [
        (33550, 12, 3, (*map(float, cell_deg), 0.0), True),
        (33922, 12, 6, (0.0, 0.0, 0.0, float(west), float(north), 0.0), True),
        (34735, 3, len(geo_keys), geo_keys, True),
    ]
    tifffile.imwrite(path, heights.astype(np.float32), extratags=tags, metadata=None)
    return path


def labels_read(stored: StoredMap, position: Position, braille: Braille) -> tuple[int, int]:
    """Return how many labels of a stored view read back as liblouis writes them, and their number."""
    raised, cell_pins = stored.view(position).raised, PinRules(PITCH_MM).cell_pins
    labels = stored.labels(position)
    right = 0
    for label in labels:
        width = cell_pins * (len(label.cells) - 1) + 2
        pins = raised[label.row : label.row + 3, label.column : label.column + width]
        right += cells_of(pins, cell_pins) == braille.cells(label.text)
    return right, len(labels)


# -- a pan -------------------------------------------------------------------------------------------------
def pans(folder: Path, count: int) -> Figures:
    """Measure random moves over each map."""
    figures: Figures = {}
    for path in sorted(folder.glob("*.touch")):
        if ".legend-" in path.name:
            continue
        walk, rng = MapWalk(stored_map(path)), random.Random(2)
        display, times_ms = SimulatedDisplay(device("graphiti")), []
        for _ in range(count):
            start_s = process_time()
            walk.do(rng.choice(MOVES))
            display.put_drives(walk.pins()[None].astype(np.float32), None, 1.0)
            times_ms.append(1e3 * (process_time() - start_s))
        figures[path.name] = {
            "pans": count,
            "update_ms p50": float(np.percentile(times_ms, 50)),
            "update_ms worst": max(times_ms),
        }
    return figures


# -- making ------------------------------------------------------------------------------------------------
def town(features: int) -> list[dict[str, Any]]:
    """Blocks of streets, with houses, parks and stops in them, as in a town."""
    side = max(2, round((features / 8) ** 0.5))
    found = []
    for row in range(side):
        for column in range(side):
            x, y = 0.001 * column, 0.001 * row
            found.append(line([[x, y], [x + 0.001, y]], highway="residential", name=f"Row {row}"))
            found.append(line([[x, y], [x, y + 0.001]], highway="residential", name=f"Lane {column}"))
            found.append(area(x + 0.0006, y + 0.0006, 0.0003, leisure="park", name=f"Park {row} {column}"))
            found += [area(x + 0.0002, y + 0.0002 * n, 0.0001, building="yes") for n in range(1, 5)]
            found.append(feature("Point", [x + 0.0005, y], highway="bus_stop", name=f"Stop {row} {column}"))
    return found


def hostile(features: int) -> list[dict[str, Any]]:
    """Random streets across the whole map, each with a name."""
    rng = np.random.default_rng(3)
    ends = rng.uniform(0, 0.01, (features, 2, 2))
    return [line(pair.tolist(), highway="primary", name=f"Way {n}") for n, pair in enumerate(ends)]


def feature(kind: str, coordinates: Any, **tags: str) -> dict[str, Any]:
    """A feature of GeoJSON."""
    return {
        "type": "Feature",
        "properties": tags,
        "geometry": {"type": kind, "coordinates": coordinates},
    }


def line(points: Any, **tags: str) -> dict[str, Any]:
    """A street."""
    return feature("LineString", points, **tags)


def area(west: float, south: float, side: float, **tags: str) -> dict[str, Any]:
    """A square."""
    east, north = west + side, south + side
    ring = [[west, south], [east, south], [east, north], [west, north], [west, south]]
    return feature("Polygon", [ring], **tags)


def making(folder: Path, features: int) -> Figures:
    """Measure the map of a town and that of a hostile file, each in a process of its own."""
    figures: Figures = {}
    for name, made in (("town", town(features)), ("hostile", hostile(features))):
        path = folder / f"{name}.geojson"
        path.write_text(json.dumps({"type": "FeatureCollection", "features": made}))
        labels = "labels" if translator() is not None else "none"
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        code = f"{MAKE}\nsys.path.insert(0, {str(Path(__file__).parent)!r})\n"
        code += "from peak_memory import peak_bytes; print(peak_bytes())"
        done = subprocess.run(
            [sys.executable, "-c", code, str(path), str(folder / f"{name}.made.touch"), labels],
            capture_output=True, text=True, check=False, timeout=1800,
        )  # fmt: skip
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        if done.returncode:
            raise SystemExit(done.stderr)
        answer, peak = done.stdout.splitlines()
        values = json.loads(answer)
        figures[name] = {
            "features": len(made),
            "source_mb": path.stat().st_size / 1e6,
            "levels": values["levels"],
            "views": values["views"],
            "processor_s": after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime,
            "peak_mb": int(peak) / 1e6,
        }
    return figures


def measure(views: int, moves: int, features: int) -> Figures:
    """Measure pins and labels, pans, and making."""
    with TemporaryDirectory() as folder:
        checked = sources(Path(folder), views)
        moved = pans(Path(folder), moves)
        made = making(Path(folder), features)
    return {"pins": checked, "pans": moved, "making": made}


def _contour_fraction(rows: list[Figures]) -> float | None:
    """Return the least fraction of the pins on contour lines that is drawn above a relief."""
    fractions = [
        row["of them drawn"] / row["pins on contour lines"] for row in rows if "of them drawn" in row
    ]
    return min(fractions, default=None)


def bars(figures: Figures) -> list[Bar]:
    """Require the guidelines on every view, the labels of liblouis, and the time of a pan."""
    rows = [row for row in figures["pins"].values() if isinstance(row, dict)]
    labels = sum(row["labels"] for row in rows)
    agreeing = sum(row["labels as liblouis"] for row in rows) / labels if labels else None
    worst = max(row["update_ms worst"] for row in figures["pans"].values())
    return [
        at_most("symbols closer than the guideline", sum(row["violations"] for row in rows), 0),
        at_most("stored views other than those checked", sum(row["views that differ"] for row in rows), 0),
        at_least("sources checked", len(rows), len(SOURCES) + 2),
        at_least("contour lines drawn with relief", _contour_fraction(rows), 0.1),
        at_least("labels as liblouis writes them", agreeing, 1.0),
        at_most("a pan of 60 x 40 pins, worst, processor time", worst, 50.0, "ms"),
        at_most(
            "the hostile map, processor time", figure(figures, "making", "hostile", "processor_s"), 180.0, "s"
        ),
        at_most("the hostile map, memory", figure(figures, "making", "hostile", "peak_mb"), 4000.0, "MB"),
    ]


if __name__ == "__main__":
    bench(
        "map", __doc__, measure, bars,
        reads=["tests/maps/inputs/*"], without=["*views*"],
        views=(50, 5), moves=(1000, 50), features=(20_000, 100),
    )  # fmt: skip
