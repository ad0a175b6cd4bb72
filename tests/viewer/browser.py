"""Drives the page in a real browser: finds the browser, runs steps and returns the answers."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

import touchfield as tf

ROOT = Path(__file__).resolve().parents[2]
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
NODE = shutil.which("node")
SECONDS = 240


def why_not() -> str:
    """The reason for a missing browser; empty if there is one."""
    if NODE is None:
        return "there is no node here"
    if not (ROOT / "web" / "node_modules" / "playwright-core").is_dir():
        return "web/node_modules is not there: make browser-tests"
    return "" if CHROMIUM else "there is no Chromium here: make browser-tests"


needs_browser = pytest.mark.skipif(bool(why_not()), reason=why_not())


class Result(NamedTuple):
    """Answers to the steps, requested addresses, and errors of the page."""

    answers: list[Any]
    requests: list[str]
    errors: list[str]


def step(do: str, **arguments: Any) -> dict[str, Any]:
    """A step of `drive`, by its name in ``drive.mjs``."""
    return {"do": do, **arguments}


WITHOUT_WEBGL = ("--disable-gpu", "--disable-3d-apis")
"""Flags of a Chromium that has no WebGL."""


def drive(folder: Path, *steps: dict[str, Any], flags: tuple[str, ...] = (), **context: Any) -> Result:
    """Run steps in a browser without a network."""
    input_path, output_path = folder / "steps.json", folder / "answers.json"
    seconds = SECONDS + sum(step.get("ms", 0) for step in steps) / 1000
    input_path.write_text(json.dumps({"steps": steps, "context": context, "flags": flags}, default=str))
    command = [
        str(NODE),
        str(ROOT / "tests" / "viewer" / "drive.mjs"),
        str(CHROMIUM),
        str(input_path),
        str(output_path),
    ]
    done = subprocess.run(
        command, cwd=ROOT / "web", capture_output=True, text=True, check=False, timeout=seconds
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return Result(**json.loads(output_path.read_text()))


FAST = """(() => {
  const speed = document.getElementById("speed");
  speed.add(new Option("fast", "240"));
  speed.value = "240";
  window.samples = [];
  let played = 0, last = 0;
  setInterval(() => {
    const now = touchfield.state();
    played += (now.time - last + 60) % 60;
    last = now.time;
    gc();
    samples.push([played, performance.memory.usedJSHeapSize, now.memory, now.graphicsObjects]);
  }, 100);
})()"""


def hour_played(folder: Path, page: str) -> np.ndarray:
    """A minute of a moving floor, played sixty times, as fast as the browser draws.

    Ten times a second: seconds of the medium, bytes of the page, bytes of its decoder, objects on the
    graphics card.
    """
    dense = np.zeros((1200, 16, 16, 16, 3), np.float32)
    for i in range(1200):
        dense[i, :, : 4 + int(4 + 4 * np.sin(i / 9))] = (0, 1 + np.sin(i / 31), 0)
    medium = tf.HapticMedium.from_array(dense, tf.Grid((16, 16, 16), (0.005,) * 3, (-0.0375,) * 3), 20.0)
    tf.encode(medium, folder / "minute.touch")
    steps = [{"do": "goto", "url": page}, {"do": "open", "file": str(folder / "minute.touch")}]
    steps += [{"do": "click", "id": "play"}, {"do": "run", "code": FAST}]
    steps += [{"do": "until", "code": "samples.at(-1)?.[0] >= 3600"}, {"do": "run", "code": "samples"}]
    result = drive(folder, *steps)
    assert result.errors == []
    return np.array(result.answers[5])
