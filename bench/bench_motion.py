"""Measures the vibration that errors of coder `touch` cause to a hand that moves or rests.

    python bench/bench_motion.py [--quick] [--effort NAME] [--largest N]

Slides: a simulated hand slides over a ball and over the terrain at 50, 100 and 200 mm/s. The fields are coded
at n_w 7 up to `--largest` (8), with k = 0.1 and F_0 = 0.05 N. The figures are the vibration of the coding
error and of the source itself from 40 to 400 Hz, in millinewtons, and the margin of the error below the
threshold of a hand that holds a stylus, in the worst third of an octave. Another slide is inside the ball,
where the force saturates.

Shares: along the same paths, "source_margin_db" and "decoded_margin_db" are the distances of the source and
of the decoded field to that threshold (negative: felt), and "level_change_db" is by how much the decoded
field vibrates more or less than the source in a third in which either is felt. What the coder adds to a
vibration that is below the threshold is measured against the threshold; where the source is above it, the bar
is on the difference of both margins. "lattice_mn" is the share of the lattice: the vibration of the source
minus the same source on a lattice of half the spacing, up to nw 7 (for the ball, minus the exact field).
These fields pass no haptic filter, so that filters have no share.

Holds: the hand keeps still in falling bodies (voxels at 1 kHz) that are at rest, or that come to rest one
after the other, and in a room at 30 Hz, with the receiver's transition between segments. The source's own
share is "source"; steps where the source makes none are the coder's.

"before" holds the figures of the first coder `touch` (format version 0), which another script measured on
other paths. The bytes before are those of the same commands.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from machine import SHARED, Bar, Figures, at_least, at_most, bench, table, text
from touchfield.codec.touch.spec import TouchSpec
from touchfield.medium import ForceField
from touchfield.perception.hand_motion import HandMotion, Slide, SlideMeter, SlideSpec, in_band, margin_of
from touchfield.perception.human import vibration_threshold
from touchfield.pipeline import compare, encode
from touchfield.pipeline.decoding import open_file
from touchfield.pipeline.encoding import Encoded
from touchfield.pipeline.preparation import prepare
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.options import SourceOptions
from touchfield.sources.scene import Scene
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Sphere

ICL_FOLDER = SHARED / "rgbd_iclnuim_livingroom1"
SOURCES: dict[str, str | Scene] = {
    "ball": AnalyticScene((Sphere((0.0, 0.0, 0.0), 0.03),)),
    "terrain": "sample:terrain",
}

BEFORE: dict[tuple[str, int, float], dict[str, float]] = {
    ("ball", 7, 100.0): {"source_mn": 0.8, "error_mn": 8.5, "error_peak_mn": 39},
    ("ball", 8, 100.0): {"source_mn": 0.3, "error_mn": 20.7, "error_peak_mn": 77},
    ("ball", 8, 200.0): {"source_mn": 0.3, "error_mn": 30, "error_peak_mn": 85},
    ("terrain", 7, 100.0): {"source_mn": 12, "error_mn": 10},
    ("terrain", 8, 100.0): {"source_mn": 23, "error_mn": 21},
}
BYTES_BEFORE = {("ball", 7): 49_708, ("ball", 8): 291_918, ("terrain", 7): 8_613, ("terrain", 8): 22_775}
REST, REST_FRAMES = "bodies at rest, voxels at 1 kHz", (2000, 2300)
SETTLING, SETTLING_FRAMES = "bodies that come to rest, voxels at 1 kHz", (1700, 2000)
REST_BEFORE = {"source_mn": 0.002, "error_mn": 20.5, "step_mn": 249}
JND_DB = 1.6
"""A fifth of an amplitude, the least that Forta, Griffin and Morioka 2012 found (docs/perception.md)."""

FINEST_NW = 8
"""The solid terrain with half the spacing of nw 8 takes 5.4 GB."""

ICL_BEFORE = {"start_error_mn": 123, "error_step_mn": 30}


def encode_and_compare(
    source: str | Scene, spec: EncodeSpec, slides: SlideSpec | None = None
) -> tuple[HandMotion, Encoded]:
    """Encode a source and compare; return the hand's motion figures and the encoding."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "it.touch"
        done = encode(source, path, spec)
        return compare(source, path, slides=slides).hand, done


def slides_on(surface: ForceField, field: ForceField, less: ForceField | None = None) -> tuple[Slide, ...]:
    """Return the vibration of a field, or of the field minus `less`, as error on the paths of `compare`."""
    meter = SlideMeter()
    meter.add(surface, np.zeros_like if less is None else less.sample_n, field.sample_n)
    return meter.slides()


def level_change_db(source_mn: Any, decoded_mn: Any) -> float:
    """Return the largest change of a level in a third of an octave in which a hand feels either, decibels."""
    is_felt = np.maximum(source_mn, decoded_mn) > vibration_threshold().force_rms_mn()
    changes_db = 20 * np.abs(np.log10(np.maximum(decoded_mn, 1e-9) / np.maximum(source_mn, 1e-9)))
    return float(changes_db[is_felt].max(initial=0.0))


def inside_ball(nw: int, touch: TouchSpec) -> Figures:
    """Return the error on sixteen circles of 20 mm radius inside the ball.

    The force saturates there. The hand moves at 100 mm/s; lengths are hand metres.
    """
    rate_hz, radius_m, speed_m_s, rng = 1000.0, 0.02, 0.1, np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "it.touch"
        source = encode(SOURCES["ball"], path, EncodeSpec(nw=nw, touch=touch)).prepared.medium[0]
        with open_file(path) as stream:
            decoded = stream.medium[0]
    angle = np.arange(700)[:, None] / rate_hz * speed_m_s / radius_m
    errors = []
    for plane in rng.normal(size=(16, 3, 2)):
        first, second = np.linalg.qr(plane)[0].T
        points = radius_m * (np.cos(angle) * first + np.sin(angle) * second)
        error = decoded.sample_n(points).astype(np.float64) - source.sample_n(points).astype(np.float64)
        errors.append((in_band(error, rate_hz) ** 2).sum(axis=1))
    return {
        "field": "ball, inside",
        "nw": nw,
        "speed_mm_s": 1e3 * speed_m_s,
        "error_mn": 1e3 * np.sqrt(np.mean(errors)),
        "error_peak_mn": 1e3 * np.sqrt(np.max(errors)),
        "before": {"error_mn": 53},
    }


def slide_rows(name: str, nw: int, touch: TouchSpec) -> list[Figures]:
    """Return one row for each speed."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "it.touch"
        done = encode(SOURCES[name], path, EncodeSpec(nw=nw, touch=touch))
        found = compare(SOURCES[name], path).hand
        with open_file(path) as stream:
            decoded = stream.medium[0]
    source = done.prepared.medium[0]
    lattice_mn = [slide.lattice_mn for slide in found.slides]
    if None in lattice_mn and nw < FINEST_NW:
        finer = prepare(SOURCES[name], EncodeSpec(nw=nw + 1)).medium[0]
        lattice_mn = [slide.error_mn for slide in slides_on(source, source, finer)]
    rows = []
    for slide, own, coded, lattice in zip(
        found.slides, slides_on(source, source), slides_on(source, decoded), lattice_mn, strict=True
    ):
        source_mn, decoded_mn = own.error_thirds_mn, coded.error_thirds_mn
        margin = margin_of(slide.error_thirds_mn)
        row = {
            "field": name,
            "nw": nw,
            **slide.summary(),
            "lattice_mn": lattice,
            "margin_db": margin.db,
            "margin_third_hz": margin.third_hz,
            "source_margin_db": margin_of(source_mn).db,
            "decoded_margin_db": margin_of(decoded_mn).db,
            "level_change_db": level_change_db(source_mn, decoded_mn),
        }
        row |= {"bytes": done.file_bytes, "bytes_before": BYTES_BEFORE[name, nw]}
        rows.append(row | {"before": BEFORE.get((name, nw, slide.speed_mm_s), {})})
    return rows


def hold_row(name: str, source: str, spec: EncodeSpec, before: Mapping[str, float]) -> Figures:
    """Return the figures of a hold on a medium of many frames."""
    found, done = encode_and_compare(source, spec, SlideSpec(paths=1, duration_s=0.25))
    assert found.hold is not None
    return {"medium": name, "bytes": done.file_bytes, "before": before, **found.hold.summary()}


def falling_spec(frames: tuple[int, int], touch: TouchSpec) -> EncodeSpec:
    """Return the options of frames, at 1 kHz, of falling bodies as voxels."""
    options = SourceOptions(seconds=max(2.0, frames[1] / 1000))
    return EncodeSpec(nw=6, representation="voxel", frames=frames, source=options, touch=touch)


def measure(effort: str, largest: int) -> Figures:
    """Measure slides and holds."""
    touch = TouchSpec(effort=effort)
    slides = [row for name in SOURCES for nw in range(7, largest + 1) for row in slide_rows(name, nw, touch)]
    print_shares(slides)
    holds = [
        hold_row(name, "sample:falling-7", falling_spec(frames, touch), REST_BEFORE)
        for name, frames in ((REST, REST_FRAMES), (SETTLING, SETTLING_FRAMES))
    ]
    if ICL_FOLDER.is_dir():
        icl_spec = EncodeSpec(nw=6, representation="voxel", source=SourceOptions(world="frames"), touch=touch)
        holds.append(hold_row("room at 30 Hz", str(ICL_FOLDER), icl_spec, ICL_BEFORE))
    settings = {"effort": effort, "hand": vibration_threshold().title, "k": touch.k, "f0_n": touch.f0_n}
    return {**settings, "slides": slides, "inside": inside_ball(largest, touch), "holds": holds}


def print_shares(slides: list[Figures]) -> None:
    """Print what the source, its lattice and the coder have of the vibration of each row."""
    columns = {
        "source mN": "source_mn", "lattice mN": "lattice_mn", "error mN": "error_mn",
        "source dB": "source_margin_db", "decoded dB": "decoded_margin_db", "error dB": "margin_db",
        "change dB": "level_change_db",
    }  # fmt: skip
    head = ("", *columns)
    rows = [[slide_name(row), *(text(row[key]) for key in columns.values())] for row in slides]
    print(table("shares: vibration, and margins below the threshold of a hand", head, rows), flush=True)


def slide_name(row: Figures) -> str:
    """Return the field, the lattice and the speed of a row."""
    return f"{row['field']}, nw {row['nw']}, {row['speed_mm_s']:.0f} mm/s"


def threshold_bar(row: Figures) -> Bar:
    """Limit the error by the threshold, or the decoded field by the source where that is felt itself."""
    name, source_db = slide_name(row), row.get("source_margin_db")
    if source_db is None or source_db >= 0:
        return at_least(f"{name}: below the threshold of a hand", row["margin_db"], 6.0, "dB")
    decoded_db = row.get("decoded_margin_db")
    beyond_db = None if decoded_db is None else source_db - decoded_db
    return at_most(f"{name}: above the threshold, beyond the source's own", beyond_db, JND_DB, "dB")


def bars(figures: Figures) -> list[Bar]:
    """Limit the error relative to the source and the threshold, the bytes, and steps."""
    found: list[Bar] = []
    for row in figures["slides"]:
        name = slide_name(row)
        found += [
            at_most(f"{name}: error over the source's own", row["error_mn"] / row["source_mn"], 2.0),
            threshold_bar(row),
            at_most(
                f"{name}: change of the level that a hand feels", row.get("level_change_db"), JND_DB, "dB"
            ),
            at_most(f"{name}: bytes over those before", row["bytes"] / row["bytes_before"], 1.1),
        ]
    for row in figures["holds"]:
        name = row["medium"]
        starts = row["start_error_mn"] / row["error_step_mn"] if row["start_error_mn"] else 0.0
        found += [
            at_most(f"{name}: steps where the source makes none, of the mask", row["still_step_ratio"], 1.0),
            at_most(f"{name}: steps where a segment starts over those elsewhere", starts, 1.0),
        ]
        if name == REST:
            found.append(at_most(f"{name}: largest step", row["still_step_mn"], 0.01, "mN"))
            error_mn, source_mn = row["error_mn"] or 0.0, row["source_mn"] or 0.0
            found.append(at_most(f"{name}: vibration beyond the source's", error_mn - source_mn, 0.01, "mN"))
    return found


if __name__ == "__main__":
    bench("motion", __doc__, measure, bars, effort=("default", "fast"), largest=(8, 7))
