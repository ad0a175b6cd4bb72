"""`touchfield demo`: the main job on real scenes that come with the libraries, and a hand that feels them."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any, Final

from touchfield.cli.demo_plate import press_a_plate
from touchfield.cli.show import progress, show
from touchfield.errors import InvalidArgument, MissingExtra, TouchfieldError
from touchfield.job import EncodeSpec, compare, encode
from touchfield.job.play import PlaySpec, play
from touchfield.medium.atomic import atomic_path
from touchfield.sources.options import SourceOptions

__all__ = ["run_demo"]

FRICTION: Final = 0.4

SCENES: Final = {
    "motorcycle": ("a real motorcycle, seen by a stereo camera, for a Phantom Omni", EncodeSpec(friction=FRICTION)),
    "terrain": (
        "the Jacksboro fault, Tennessee, heights times 5, for a Phantom Omni",
        EncodeSpec(source=SourceOptions(exaggeration=5.0), friction=FRICTION),
    ),
}


def run_demo(folder: Path, as_json: bool) -> None:
    """Encode, decode, measure, draw and touch each scene; what a library does not carry is said and left out."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InvalidArgument(str(folder), error.strerror or str(error), "a folder", "Name another one.") from None
    results: dict[str, Any] = {}
    missing: list[TouchfieldError] = []
    for name, (what, spec) in SCENES.items():
        try:
            results[name] = _one(folder / name, f"sample:{name}", spec)
        except MissingExtra as error:
            missing.append(error)
            continue
        if not as_json:
            show(results[name], f"{name}: {what}", False)
            made = folder / name
            sys.stdout.write(f"look at {made}.png; stream: {made}.touch, report: {made}.json\n")
            sys.stdout.write(f"and at {made}.forces.png: a simulated hand comes, presses, slides and leaves\n\n")
    if not results:
        raise missing[-1]  # the terrain's: its library draws the pictures, too
    results["plate"] = press_a_plate(folder / "plate")
    if not as_json:
        held, plain = results["plate"]["proxy"], results["plate"]["field"]
        sys.stdout.write(
            f"plate: a hand pressed into a plate of 2 mm is held at {held['hand_mm']:.1f} mm by "
            f"{held['force_n']:.1f} N (--render auto), and goes through to {plain['hand_mm']:.1f} mm "
            f"without the proxy (--render field)\nlook at {folder / 'plate'}.png\n"
        )
    if as_json:
        show(results, "demo", True, tuple(str(error) for error in missing))


def _one(stem: Path, source: str, spec: EncodeSpec) -> dict[str, Any]:
    stream, picture = stem.with_suffix(".touch"), stem.with_suffix(".png")
    with progress(f"encode {stem.name}") as report:
        encode(source, stream, spec, report)
    with progress(f"compare {stem.name}") as report:
        compared = compare(source, stream, report=report)
    compared.draw(picture)
    summary = compared.summary()
    with progress(f"play {stem.name}", "s") as report:
        played = play(stream, PlaySpec(offline=True, is_logged=True, is_drawn=True), report).checked()
    played.write_log(stem.with_suffix(".forces.csv"))
    played.draw(stem.with_suffix(".forces.png"))
    with atomic_path(stem.with_suffix(".json")) as temporary:
        temporary.write_text(json.dumps(summary, indent=1) + "\n")
    return summary
