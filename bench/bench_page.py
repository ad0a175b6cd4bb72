"""Measures the page of `touchfield view` in headless Chromium: waiting times, size, memory.

    python bench/bench_page.py [--quick] [--minutes N] [--rounds N]

The waiting times are those from opening a file to its first force, and from requesting a page to its figures
and its first picture (median of `--rounds` rounds). The decoder of the page, `c/touch.h` as WebAssembly, runs
in node and is compared with that of the native module on one thread, on the same files. A moving file is
played for `--minutes` minutes, and another for an hour of media time, as fast as the browser draws; the
growth of memory is reported.
"""

from __future__ import annotations

import base64
import gzip
import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from machine import Bar, Figures, at_least, at_most, bench, figure, leave_out
from touchfield.pipeline import encode
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.options import SourceOptions
from touchfield.tasks.view import view
from touchfield.viewer.browser import empty_page

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests" / "viewer"))
from browser import drive, hour_played, why_not  # noqa: E402

WASM_SPEED = """
import fs from "node:fs";
const [, , wasm, file] = process.argv;
const module = new WebAssembly.Module(fs.readFileSync(wasm));
const { exports: c } = new WebAssembly.Instance(module, { page: Math });
const data = fs.readFileSync(file);
const times = [];
for (let n = 0; n < 12; n++) {
  new Uint8Array(c.memory.buffer).set(data, c.room(data.length));
  const begin = performance.now();
  if (c.open() || c.show(0)) throw new Error("it does not decode");
  times.push(performance.now() - begin);
}
console.log(JSON.stringify(times));
"""
MODULE_SPEED = """
import json, sys
from time import perf_counter
import touchfield as tf
times = []
for _ in range(12):
    with tf.open_stream(sys.argv[1]) as stream:
        began = perf_counter()
        stream.medium[0]
        times.append(1e3 * (perf_counter() - began))
print(json.dumps(times))
"""
SAMPLED = (
    "window.heap = []; setInterval(() => { gc(); heap.push(performance.memory.usedJSHeapSize); }, 500); 0"
)


def decoder() -> bytes:
    """Return the WebAssembly of the page, gzip-compressed as embedded."""
    packed = re.search(r'id="decoder">([^<]+)<', empty_page())
    assert packed is not None
    return base64.b64decode(packed[1])


def decode_ms(folder: Path, stream: Path) -> tuple[float, float]:
    """Return milliseconds to decode a first frame in WebAssembly and with the native module.

    Each is the fastest of twelve runs.
    """
    wasm, script = folder / "touch.wasm", folder / "speed.mjs"
    wasm.write_bytes(gzip.decompress(decoder()))
    script.write_text(WASM_SPEED)
    environment = {**os.environ, "TOUCHFIELD_THREADS": "1"}
    ours = subprocess.run(["node", script, wasm, stream], check=True, capture_output=True, text=True)
    peer = subprocess.run(
        [sys.executable, "-c", MODULE_SPEED, str(stream)],
        check=True,
        capture_output=True,
        text=True,
        env=environment,
    )
    return min(json.loads(ours.stdout)), min(json.loads(peer.stdout))


def opened_ms(folder: Path, name: str, stream: Path, rounds: int) -> dict[str, float]:
    """Return milliseconds to the first force of a file, and to a page's figures and first picture."""
    empty, page = folder / "page.html", view(stream).save(folder / f"{name}.html")
    empty.write_text(empty_page(), encoding="utf-8")
    forces, figures, pictures = [], [], []
    for _ in range(rounds):
        steps: list[dict[str, Any]] = [{"do": "goto", "url": empty.as_uri()}, {"do": "wait", "ms": 1000}]
        steps += [{"do": "open", "file": str(stream)}, {"do": "state"}]
        marks = drive(folder, *steps).answers[3]["marks"]
        forces.append(marks["felt"] - marks["open"])
        answers = drive(
            folder, {"do": "goto", "url": page.as_uri()}, {"do": "wait", "ms": 500}, {"do": "state"}
        )
        figures.append(answers.answers[2]["marks"]["described"])
        pictures.append(answers.answers[2]["marks"]["drawn"])
    return {
        f"{name}_force_ms": median(forces),
        f"{name}_figures_ms": median(figures),
        f"{name}_first_picture_ms": median(pictures),
    }


def growth(folder: Path, minutes: float) -> dict[str, float]:
    """Return the growth of memory during playback.

    It is the minimum of the last third of the samples minus that of the first third. Each sample includes
    garbage that has not been collected yet, among it a block of 2.8 MB that comes and goes within 10 to 40
    seconds: the minimum of a third of five minutes is nearly free of it, that of one minute is not.
    """
    moving = folder / "falling.touch"
    encode("sample:falling-4", moving, EncodeSpec(frames=(0, 30)))
    page = view(moving).save(folder / "falling.html")
    steps = [{"do": "goto", "url": page.as_uri()}, {"do": "click", "id": "play"}, {"do": "wait", "ms": 4000}]
    steps += [{"do": "state"}, {"do": "run", "code": SAMPLED}, {"do": "wait", "ms": round(60_000 * minutes)}]
    answers = drive(folder, *steps, {"do": "run", "code": "window.heap"}, {"do": "state"}).answers
    heap, third = answers[6], len(answers[6]) // 3
    grown = min(heap[-third:]) - min(heap[:third])
    return {
        "played_minutes": minutes,
        "heap_bytes": min(heap),
        "heap_growth_bytes": grown,
        "wasm_growth_bytes": answers[7]["memory"] - answers[3]["memory"],
    }


def hour(folder: Path) -> dict[str, float]:
    """Return the growth of memory over an hour of media time.

    It is the median after minute 40 minus that of minutes 10 to 30.
    """
    page = folder / "hour.html"
    page.write_text(empty_page(), encoding="utf-8")
    rows = hour_played(folder, page.as_uri())
    played = rows[:, 0]
    first, last = rows[(played > 600) & (played < 1800)], rows[played > 2400]
    heap, wasm, graphics = (np.median(last, axis=0) - np.median(first, axis=0))[1:]
    return {
        "hour_media_s": float(played[-1]),
        "hour_heap_growth_bytes": float(heap),
        "hour_wasm_growth_bytes": float(wasm),
        "hour_graphics_growth": float(graphics),
    }


def measure(minutes: float, rounds: int) -> Figures:
    """Measure the page's size, decoder, waiting times and memory."""
    if why_not():
        leave_out(str(why_not()))
    figures: dict[str, float] = {
        "page_gz_bytes": len(gzip.compress(empty_page().encode(), 9)),
        "wasm_gz_bytes": len(decoder()),
    }
    scenes = {"terrain": EncodeSpec(source=SourceOptions(exaggeration=5.0)), "motorcycle": EncodeSpec()}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for scene, spec in scenes.items():
            stream = folder / f"{scene}.touch"
            encode(f"sample:{scene}", stream, spec)
            ours, peer = decode_ms(folder, stream)
            figures |= {
                f"{scene}_wasm_ms": ours,
                f"{scene}_module_ms": peer,
                f"{scene}_decode_of_module": peer / ours,
            }
            figures |= opened_ms(folder, scene, stream, rounds)
        return figures | growth(folder, minutes) | hour(folder)


def bars(figures: Figures) -> list[Bar]:
    """Require a small page, short waits, a fast decoder, and no growth of memory."""
    waits = {
        f"{scene}, {label}": (figure(figures, f"{scene}_{key}_ms"), limit)
        for scene in ("terrain", "motorcycle")
        for key, label, limit in (
            ("force", "file to force", 300.0),
            ("figures", "page to figures", 1000.0),
            ("first_picture", "page to picture", 1500.0),
        )
    }
    return [
        at_most("page, gzip", figures["page_gz_bytes"], 204_000, "bytes"),
        at_most("module, gzip", figures["wasm_gz_bytes"], 91_000, "bytes"),
        *(at_most(name, ms, limit, "ms") for name, (ms, limit) in waits.items()),
        at_least(
            "terrain, decoding over the native module's", figure(figures, "terrain_decode_of_module"), 0.6
        ),
        at_least(
            "motorcycle, decoding over the native module's",
            figure(figures, "motorcycle_decode_of_module"),
            0.6,
        ),
        at_most(
            "growth of the heap while it plays", figure(figures, "heap_growth_bytes"), 2_000_000, "bytes"
        ),
        at_most("growth of the decoder while it plays", figure(figures, "wasm_growth_bytes"), 0, "bytes"),
        at_most("growth of the heap in an hour", figure(figures, "hour_heap_growth_bytes"), 500_000, "bytes"),
        at_most("growth of the decoder in an hour", figure(figures, "hour_wasm_growth_bytes"), 0, "bytes"),
        at_most(
            "growth on the graphics card in an hour", figure(figures, "hour_graphics_growth"), 0, "things"
        ),
    ]


if __name__ == "__main__":
    bench("page", __doc__, measure, bars, minutes=(5.0, 0.1), rounds=(5, 1))
