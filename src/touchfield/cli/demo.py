"""`touchfield demo`: the main job on real scenes that come with the libraries, and a hand that feels them.

Where a library is missing its scene is left out, and where none is there a tray of shapes takes their place. At last
a hand that a plate of 2 mm holds, beside one that goes through: the proxy, and the stored field alone.
"""

from __future__ import annotations

import csv
import json
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.cli.show import progress, show
from touchfield.errors import InvalidArgument, MissingExtra, TouchfieldError
from touchfield.job import EncodeSpec, compare, encode
from touchfield.job.play import PlaySpec, play
from touchfield.job.view import view
from touchfield.medium.atomic import atomic_path
from touchfield.render.spec import RenderSpec
from touchfield.sources.analytic_scene import AnalyticScene
from touchfield.sources.options import SourceOptions
from touchfield.sources.shapes import Box
from touchfield.viewer.page import titled_figure, write_png

FRICTION: Final = 0.4

SCENES: Final = {
    "motorcycle": ("a real motorcycle, seen by a stereo camera, for a Phantom Omni", EncodeSpec(friction=FRICTION)),
    "terrain": (
        "the Jacksboro fault, Tennessee, heights times 5, for a Phantom Omni",
        EncodeSpec(source=SourceOptions(exaggeration=5.0), friction=FRICTION),
    ),
}
SHAPES: Final = ("six shapes on a tray, for a Phantom Omni", EncodeSpec(friction=FRICTION))
"""The scene that needs no library beside the core."""

HALF_M: Final = (0.03, 0.02, 0.001)
ABOVE_M, BELOW_M = 0.006, -0.0024
PRESS_S, HOLD_S = 0.6, 0.6
_WAYS: Final = (("proxy", "held by the proxy", "tab:blue"), ("field", "the field as it is stored", "tab:red"))


def run_demo(folder: Path, as_json: bool) -> None:
    """Encode, decode, measure, draw and touch each scene; what a library does not carry is said and left out."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InvalidArgument(str(folder), error.strerror or str(error), "a folder", "Name another one.") from None
    results: dict[str, Any] = {}
    missing: list[TouchfieldError] = []
    draws = find_spec("matplotlib") is not None
    for name, (what, spec) in [*SCENES.items(), ("shapes", SHAPES)]:
        if name == "shapes" and results:
            break
        try:
            results[name] = _one(folder / name, f"sample:{name}", spec, draws)
        except MissingExtra as error:
            missing.append(error)
            continue
        if not as_json:
            show(results[name], f"{name}: {what}", False)
            _point_at(folder / name, draws)
    results["plate"] = _press_a_plate(folder / "plate", draws)
    if as_json:
        show(results, "demo", True, tuple(str(error) for error in missing))
        return
    proxy, plain = results["plate"]["proxy"], results["plate"]["field"]
    sys.stdout.write(
        f"plate: a hand pressed into a plate of 2 mm is held at {proxy['hand_mm']:.1f} mm by "
        f"{proxy['force_n']:.1f} N (--render auto), and goes through to {plain['hand_mm']:.1f} mm "
        f"without the proxy (--render field)\n"
    )
    if draws:
        sys.stdout.write(f"look at {folder / 'plate'}.png\n")
    for fault in missing:
        sys.stdout.write(f"left out: {fault}\n")


def _point_at(stem: Path, draws: bool) -> None:
    """Say what there is to look at."""
    sys.stdout.write(f"stream: {stem}.touch, report: {stem}.json\n")
    if draws:
        sys.stdout.write(f"look at {stem}.png\n")
    sys.stdout.write(f"open {stem}.html in a browser: see it, cut it open, probe it, hear it\n")
    if draws:
        sys.stdout.write(f"and at {stem}.forces.png: a simulated hand comes, presses, slides and leaves\n")
    sys.stdout.write("\n")


def _one(stem: Path, source: str, spec: EncodeSpec, draws: bool) -> dict[str, Any]:
    stream, picture = stem.with_suffix(".touch"), stem.with_suffix(".png")
    with progress(f"encode {stem.name}") as report:
        encode(source, stream, spec, report)
    with progress(f"compare {stem.name}") as report:
        compared = compare(source, stream, report=report)
    if draws:
        compared.draw(picture)
    summary = compared.summary()
    view(stream).save(stem.with_suffix(".html"))
    with progress(f"play {stem.name}", "s") as report:
        played = play(stream, PlaySpec(offline=True, is_logged=True, is_drawn=draws), report).checked()
    played.write_log(stem.with_suffix(".forces.csv"))
    if draws:
        played.draw(stem.with_suffix(".forces.png"))
    with atomic_path(stem.with_suffix(".json")) as temporary:
        temporary.write_text(json.dumps(summary, indent=1) + "\n")
    return summary


def _press_a_plate(stem: Path, draws: bool) -> dict[str, Any]:
    """Code a plate of 60 x 40 x 2 mm, press a simulated hand on it twice, and draw both where that can be.

    Of ``proxy`` and ``field``: where the hand comes to rest, millimetres above the middle of the plate, and the force
    that holds it there, newtons. STEM.csv is where the hand wants to be.
    """
    stream, path = stem.with_suffix(".touch"), stem.with_suffix(".csv")
    encode(AnalyticScene((Box((0.0, 0.0, 0.0), HALF_M),)), stream, EncodeSpec(mapping="1"))
    with atomic_path(path) as temporary, temporary.open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(("t_s", "x_m", "y_m", "z_m"))
        rows.writerows([(0, 0, 0, ABOVE_M), (PRESS_S, 0, 0, BELOW_M), (PRESS_S + HOLD_S, 0, 0, BELOW_M)])
    logs = {}
    for way, _, _ in _WAYS:
        spec = PlaySpec(
            device="sim:spring", trajectory=path, offline=True, is_logged=True, render=RenderSpec(render=way)
        )
        log = play(stream, spec).rows
        assert log is not None  # of a point device there always is one
        logs[way] = log[log["time_s"] <= PRESS_S + HOLD_S - 0.05]
    if draws:
        _draw(stem.with_suffix(".png"), logs)
    return {
        way: {"hand_mm": 1e3 * float(log["position_m"][-1, 2]), "force_n": float(log["force_n"][-1, 2])}
        for way, log in logs.items()
    }


def _draw(path: Path, logs: dict[str, NDArray[Any]]) -> None:
    title = "A hand pressed into a plate of 2 mm: the proxy holds it, the stored field alone lets it through"
    figure = titled_figure("the picture of the plate", title, 9.0, 4.2)
    height, force = figure.subplots(1, 2)
    thickness_mm = 2e3 * HALF_M[2]
    height.axhspan(-thickness_mm / 2, thickness_mm / 2, color="0.8", label=f"a plate of {thickness_mm:g} mm")
    times = np.array([0.0, PRESS_S, PRESS_S + HOLD_S])
    height.plot(times, 1e3 * np.array([ABOVE_M, BELOW_M, BELOW_M]), "k:", label="where the hand wants to be")
    for way, words, colour in _WAYS:
        log = logs[way]
        height.plot(log["time_s"], 1e3 * log["position_m"][:, 2], color=colour, label=words)
        force.plot(log["time_s"], log["force_n"][:, 2], color=colour, label=words)
    height.set(xlabel="seconds", ylabel="hand, mm above the middle of the plate")
    force.set(xlabel="seconds", ylabel="force on the hand, upwards, N")
    height.legend(fontsize="small")
    write_png(figure, path)
