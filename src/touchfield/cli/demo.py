"""Command `touchfield demo`: encodes, compares and plays real scenes that come with optional libraries, and
draws a map for fingers.

The scene of a missing library is skipped; without any of them a tray of shapes is used instead. The map needs
no library; without liblouis it has no Braille.
"""

from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from touchfield.atomic import atomic_path
from touchfield.cli.output import Answer, echo, progress
from touchfield.errors import InvalidArgument, MissingExtra, TouchfieldError
from touchfield.maps.braille import has_braille
from touchfield.pipeline import compare, encode
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.options import SourceOptions
from touchfield.tasks.map import MapSpec, make_map
from touchfield.tasks.play import PlaySpec, play
from touchfield.tasks.view import view

FRICTION: Final = 0.4

SCENES: Final = {
    "motorcycle": (
        "a real motorcycle, seen by a stereo camera, for a Phantom Omni",
        EncodeSpec(friction=FRICTION),
    ),
    "terrain": (
        "the Jacksboro fault, Tennessee, heights times 5, for a Phantom Omni",
        EncodeSpec(source=SourceOptions(exaggeration=5.0), friction=FRICTION),
    ),
    "shapes": ("six shapes on a tray, for a Phantom Omni", EncodeSpec(friction=FRICTION)),
}
"""Description and settings of each scene. The last needs no optional library."""
MAP_TITLE: Final = "a map for fingers, Nelson Square in London, for a pin display"


def run_demo(folder: Path, as_json: bool) -> None:
    """Encode, decode, measure, draw and play each scene; report and skip those whose library is missing."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InvalidArgument(
            str(folder), error.strerror or str(error), "a folder", "Name another one."
        ) from None
    results: dict[str, Any] = {}
    missing: list[TouchfieldError] = []
    draws = find_spec("matplotlib") is not None
    for name, (description, spec) in SCENES.items():
        if name == "shapes" and results:
            break
        try:
            results[name] = _run_scene(folder / name, f"sample:{name}", spec, draws)
        except MissingExtra as error:
            missing.append(error)
            continue
        if not as_json:
            Answer(results[name], f"{name}: {description}", _result_notes(folder / name, draws)).show()
    results["map"], map_notes = _draw_map(folder / "map", draws)
    if not as_json:
        Answer(results["map"], f"map: {MAP_TITLE}", map_notes).show()
    if as_json:
        Answer(results, "demo", [str(error) for error in missing]).show(True)
        return
    for fault in missing:
        echo(f"left out: {fault}")


def _result_notes(stem: Path, draws: bool) -> list[str]:
    """Return notes on the files that were written."""
    pictures = (
        f"look at {stem}.png, and at {stem}.forces.png: a simulated hand comes, presses, slides and leaves"
    )
    page = f"open {stem}.html in a browser: see it, cut it open, probe it, hear it"
    return [f"stream: {stem}.touch, report: {stem}.json", page, *([pictures] if draws else [])]


def _run_scene(stem: Path, source: str, spec: EncodeSpec, draws: bool) -> dict[str, Any]:
    stream, picture = stem.with_suffix(".touch"), stem.with_suffix(".png")
    with progress(f"encode {stem.name}") as report:
        encode(source, stream, spec, report)
    with progress(f"compare {stem.name}") as report:
        compared = compare(source, stream, report=report)
    if draws:
        compared.draw(picture)
    summary = compared.summary()
    view(stream).save(stem.with_suffix(".html"))
    with progress(f"play {stem.name}") as report:
        played = play(stream, PlaySpec(offline=True, is_logged=True, is_drawn=draws), report).checked()
    played.write_log(stem.with_suffix(".forces.csv"))
    if draws:
        played.draw(stem.with_suffix(".forces.png"))
    _write_report(stem, summary)
    return summary


def _write_report(stem: Path, figures: dict[str, Any]) -> None:
    with atomic_path(stem.with_suffix(".json")) as temporary:
        temporary.write_text(json.dumps(figures, indent=1) + "\n")


def _draw_map(stem: Path, draws: bool) -> tuple[dict[str, Any], list[str]]:
    """Draw a tactile map; return its figures, and notes on the files that were written."""
    stream, has_labels = stem.with_suffix(".touch"), has_braille()
    with progress("map"):
        made = make_map("sample:park", stream, MapSpec(has_labels=has_labels), svg=stem.with_suffix(".svg"))
    view(stream).save(stem.with_suffix(".html"))
    notes = [
        f"stream: {stream}, report: {stem}.json, for swell paper: {stem}.svg",
        f"open {stem}.html in a browser: explore it by keys or finger, find a place, hear its name",
    ]
    if draws:
        made.draw(stem.with_suffix(".png"))
        notes.append(f"look at {stem}.png: the pins by class, and the legend")
    if not has_labels:
        notes.append(
            "liblouis is not installed, so the map has no Braille: apt install liblouis20 liblouis-data"
        )
    summary = made.summary()
    _write_report(stem, summary)
    return summary, notes
