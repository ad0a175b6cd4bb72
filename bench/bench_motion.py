"""What a hand that moves feels of coder `touch`, beside what the source itself does: the figures, and the bars.

    python bench/bench_motion.py [EFFORT]

Slides: a ball and the terrain at n_w 7 and 8, k 0.1, F_0 0.05 N, at 50, 100 and 200 mm/s; millinewtons from 40 to 400
Hz, and the margin to the threshold of a hand that holds a stylus in its worst third of an octave; inside the ball
too, where the force saturates. Holds: bodies at rest as voxels at 1 kHz, and a room at 30 Hz, as a receiver plays
them that goes over from segment to segment; "decoded" is without that. "before" is the first coder `touch` (format
version 0), measured by a script of its own on other paths; the bytes before are those of the same commands. Keeps
results/motion.json; exits with 0 whether bars are met or not.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from machine import keep
from touchfield.codec.touch.spec import TouchSpec
from touchfield.job import Encoded, EncodeSpec, encode, hand_motion, open_stream
from touchfield.perception.hand_motion import HandMotion, SlideSpec, margin_of
from touchfield.perception.human import vibration_threshold
from touchfield.perception.slides import in_band
from touchfield.sources.analytic_scene import AnalyticScene
from touchfield.sources.options import SourceOptions
from touchfield.sources.scene import Scene
from touchfield.sources.shapes import Sphere

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"
ROOM = SHARED / "rgbd_iclnuim_livingroom1"
SOURCES: dict[str, str | Scene] = {
    "ball": AnalyticScene((Sphere((0.0, 0.0, 0.0), 0.03),)),
    "terrain": "sample:terrain",
}

MOST_OF_SOURCE = 2.0
LEAST_MARGIN_DB = 6.0
MOST_BYTES = 1.10
AT_REST_MN = 0.01

BEFORE: dict[tuple[str, int, float], dict[str, float]] = {
    ("ball", 7, 100.0): {"source_mn": 0.8, "error_mn": 8.5, "error_peak_mn": 39},
    ("ball", 8, 100.0): {"source_mn": 0.3, "error_mn": 20.7, "error_peak_mn": 77},
    ("ball", 8, 200.0): {"source_mn": 0.3, "error_mn": 30, "error_peak_mn": 85},
    ("terrain", 7, 100.0): {"source_mn": 12, "error_mn": 10},
    ("terrain", 8, 100.0): {"source_mn": 23, "error_mn": 21},
}
BYTES_BEFORE = {("ball", 7): 49_708, ("ball", 8): 291_918, ("terrain", 7): 8_613, ("terrain", 8): 22_775}
REST_BEFORE = {"source_mn": 0.002, "error_mn": 20.5, "step_mn": 249}
ROOM_BEFORE = {"start_error_mn": 123, "error_step_mn": 30}


def measured(source: str | Scene, spec: EncodeSpec, slides: SlideSpec | None = None) -> tuple[HandMotion, Encoded]:
    """The hand of a source and its stream."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "it.touch"
        done = encode(source, path, spec)
        return hand_motion(done.prepared, path, slides), done


def inside_ball(nw: int, touch: TouchSpec) -> dict[str, Any]:
    """Sixteen great circles of 20 mm in the ball of 35 mm (hand metres) at 100 mm/s, where the force saturates."""
    rate_hz, radius_m, speed_m_s, rng = 1000.0, 0.02, 0.1, np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "it.touch"
        source = encode(SOURCES["ball"], path, EncodeSpec(nw=nw, touch=touch)).prepared.medium[0]
        with open_stream(path) as stream:
            decoded = stream.medium[0]
    angle = np.arange(700)[:, None] / rate_hz * speed_m_s / radius_m
    errors = []
    for plane in rng.normal(size=(16, 3, 2)):
        one, other = np.linalg.qr(plane)[0].T
        points = radius_m * (np.cos(angle) * one + np.sin(angle) * other)
        error = decoded.sample_n(points).astype(float) - source.sample_n(points)
        errors.append((in_band(error, rate_hz) ** 2).sum(axis=1))
    row = {
        "field": "ball, inside", "nw": nw, "speed_mm_s": 1e3 * speed_m_s, "error_mn": 1e3 * np.sqrt(np.mean(errors)),
        "error_peak_mn": 1e3 * np.sqrt(np.max(errors)), "before": {"error_mn": 53},
    }  # fmt: skip
    now, peak = row["error_mn"], row["error_peak_mn"]
    print(f"ball, inside, 3.3 N, nw {nw}, 100 mm/s: before 53, now {now:.2f}, peak {peak:.1f}")
    return row


def slide_rows(name: str, nw: int, touch: TouchSpec) -> list[dict[str, Any]]:
    """One row for each speed, with its bars."""
    found, done = measured(SOURCES[name], EncodeSpec(nw=nw, touch=touch))
    size = done.file_bytes
    rows = []
    for slide in found.slides:
        margin = margin_of(slide.error_thirds_mn)
        bars = {
            "at most twice the source's own": slide.error_mn <= MOST_OF_SOURCE * slide.source_mn,
            "at least 6 dB below the threshold": margin.db >= LEAST_MARGIN_DB,
            "at most 10 % more bytes": size <= MOST_BYTES * BYTES_BEFORE[name, nw],
        }
        before = BEFORE.get((name, nw, slide.speed_mm_s), {})
        row = {"field": name, "nw": nw, **slide.summary(), "margin_db": margin.db, "margin_third_hz": margin.third_hz}
        row |= {"bytes": size, "bytes_before": BYTES_BEFORE[name, nw], "before": before, "bars": bars}
        rows.append(row)
        figures = (before.get("source_mn"), before.get("error_mn"), slide.source_mn, slide.lattice_mn, slide.error_mn)
        print(
            f"{name:8} nw {nw} {slide.speed_mm_s:5.0f} mm/s {' '.join(f'{_number(v):>8}' for v in figures)}"
            f" {slide.error_peak_mn:8.1f} {margin.db:+7.1f} dB at {margin.third_hz:4.0f} Hz {size:9,} ",
            _verdict(bars),
            flush=True,
        )
    return rows


def hold_row(name: str, source: str, spec: EncodeSpec, before: dict[str, float]) -> dict[str, Any]:
    """The hold of a medium of many frames, with its bars."""
    found, done = measured(source, spec, SlideSpec(paths=1, duration_s=0.25))
    hold = found.hold
    assert hold is not None
    bars = {
        "no step beyond the mask where the source makes none": hold.still_step_ratio <= 1,
        "no larger step where a segment starts than elsewhere": hold.start_error_mn <= hold.error_step_mn,
    }
    if before is REST_BEFORE:
        vibration_mn = (hold.error_mn or 0.0) <= max(AT_REST_MN, hold.source_mn or 0.0)
        bars["none at all at rest"] = hold.still_step_mn <= AT_REST_MN and vibration_mn
    print(f"{name}: before {before}, bytes {done.file_bytes:,}  {_verdict(bars)}")
    told = hold.summary()
    print("\n".join(f"    {key:22} {_number(told[key])}" for key in told if key != "error_thirds_mn"))
    return {"medium": name, "bytes": done.file_bytes, "before": before, **told, "bars": bars}


def main() -> None:
    """Print and keep the figures."""
    effort = sys.argv[1] if len(sys.argv) > 1 else "default"
    touch = TouchSpec(effort=effort)
    print(f"k {touch.k}, F_0 {touch.f0_n} N, effort {effort}; millinewtons, 40 to 400 Hz, of slides at |F| = 1 N")
    print(
        f"{'':23} {'source':>8} {'coder':>8} {'source':>8} {'lattice':>8} {'coder':>8} {'peak':>8}"
        f" {'margin, worst third':>21} {'bytes':>9}  bars\n{'':23} {'before':>8} {'before':>8}"
    )
    slides = [row for name in SOURCES for nw in (7, 8) for row in slide_rows(name, nw, touch)]
    inside = inside_ball(8, touch)
    rest = EncodeSpec(nw=6, representation="voxel", frames=(1700, 2000), touch=touch)
    holds = [hold_row("bodies at rest, voxels at 1 kHz", "sample:falling-7", rest, REST_BEFORE)]
    if ROOM.is_dir():
        room = EncodeSpec(nw=6, representation="voxel", source=SourceOptions(world="frames"), touch=touch)
        holds.append(hold_row("room at 30 Hz", str(ROOM), room, ROOM_BEFORE))
    verdicts = [met for row in (*slides, *holds) for met in row["bars"].values()]
    print(f"{sum(verdicts)} of {len(verdicts)} bars met")
    told = {"effort": effort, "hand": vibration_threshold().title, "met": sum(verdicts), "bars": len(verdicts)}
    keep("motion", {**told, "slides": slides, "inside": inside, "holds": holds})


def _verdict(bars: dict[str, bool]) -> str:
    unmet = [name for name, met in bars.items() if not met]
    return "met" if not unmet else f"not: {'; '.join(unmet)}"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


if __name__ == "__main__":
    main()
