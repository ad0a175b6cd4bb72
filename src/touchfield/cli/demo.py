"""Command `touchfield demo`: encodes, compares and plays real scenes that come with optional libraries.

The scene of a missing library is skipped; without any of them a tray of shapes is used instead.
"""

from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from touchfield.atomic import atomic_path
from touchfield.cli.output import Answer, echo, progress
from touchfield.errors import InvalidArgument, MissingExtra, TouchfieldError
from touchfield.pipeline import compare, encode
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.options import SourceOptions
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
    with atomic_path(stem.with_suffix(".json")) as temporary:
        temporary.write_text(json.dumps(summary, indent=1) + "\n")
    return summary
