"""Measures tactile maps: distances on the pins of every zoom level, labels, the time of a pan, and of making.

    python bench/bench_map.py [--quick] [--views N] [--moves N] [--features N]

Three extracts of OpenStreetMap and three school diagrams (``tests/maps/inputs``), on 60 x 40 pins. Of each
level, up to `views` random views are drawn, checked against the guidelines, pair by pair of raised pins, and
compared with the pins in the file. Labels are read back from the pins of the file and compared with what
liblouis gives for their text; without liblouis they are left out.

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

from machine import Bar, Figures, at_least, at_most, bench, figure
from touchfield.container import TouchReader
from touchfield.devices import device
from touchfield.errors import InvalidArgument, MissingExtra
from touchfield.maps.braille import Braille, cells_of
from touchfield.maps.check import check
from touchfield.maps.guidelines import PinRules
from touchfield.maps.layout import draw
from touchfield.maps.pins import Window
from touchfield.maps.reader import box_of, read_map
from touchfield.maps.zooms import draw_levels
from touchfield.pipeline.stored_map import Position, StoredMap
from touchfield.tasks.map import MapSpec, make_map
from touchfield.tasks.map_play import MapWalk, SimulatedDisplay

INPUTS = Path(__file__).resolve().parents[1] / "tests" / "maps" / "inputs"
SOURCES = (
    "crossing.osm.pbf", "park.osm.pbf", "floor_plan.geojson", "triangle.svg", "parabola.svg", "cell.svg",
)  # fmt: skip
LEVELS, ROWS, COLUMNS, PITCH_MM = 4, 40, 60, 2.5
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
    return {name: source(INPUTS / name, folder / f"{name}.touch", views) for name in SOURCES}


def source(path: Path, out: Path, views: int) -> Figures:
    """Check up to `views` views of each level of a source, drawn anew and as stored."""
    braille, rng = translator(), random.Random(1)
    try:
        make_map(path, out, MapSpec(zooms=LEVELS, has_labels=braille is not None))
    except MissingExtra as error:
        return {"absent": str(error)}
    stored, read = stored_map(out), read_map(path)
    box = box_of(read, None)
    window = Window.around(*box, ROWS, COLUMNS)
    whole = draw(read.features, window, PinRules(PITCH_MM), braille)
    levels, _ = draw_levels(read.features, box, (window, whole), braille, LEVELS)
    row: Figures = {"levels": len(levels), "views": 0, "violations": 0, "views that differ": 0}
    gaps_mm, agree, labels = [], 0, 0
    for n, level in enumerate(levels):
        indices = rng.sample(range(len(level.views)), min(views, len(level.views)))
        for index in indices:
            position = Position(n, *divmod(index, level.grid.view_columns))
            found = check(level.views[index].layout)
            same = np.array_equal(level.views[index].layout.raised, stored.view(position).raised)
            row["views"] += 1
            row["violations"] += len(found.violations)
            row["views that differ"] += not same
            gaps_mm += [] if found.min_gap_mm is None else [found.min_gap_mm]
            if braille is not None:
                right, count = labels_read(stored, position, braille)
                agree, labels = agree + right, labels + count
    return row | {
        "least gap, mm": min(gaps_mm),
        "labels": labels,
        "labels as liblouis": agree,
        "map bytes": out.stat().st_size,
    }


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


def bars(figures: Figures) -> list[Bar]:
    """Require the guidelines on every view, the labels of liblouis, and the time of a pan."""
    rows = [row for row in figures["pins"].values() if "absent" not in row]
    labels = sum(row["labels"] for row in rows)
    agreeing = sum(row["labels as liblouis"] for row in rows) / labels if labels else None
    worst = max(row["update_ms worst"] for row in figures["pans"].values())
    return [
        at_most("symbols closer than the guideline", sum(row["violations"] for row in rows), 0),
        at_most("stored views other than those checked", sum(row["views that differ"] for row in rows), 0),
        at_least("sources checked", len(rows), len(SOURCES)),
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
