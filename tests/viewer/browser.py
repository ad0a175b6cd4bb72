"""A real browser with the page: where it is, and what it answers to a list of steps."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any, NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[2]
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
NODE = shutil.which("node")
SECONDS = 240


def why_not() -> str:
    """What is missing for a browser; nothing: it is there."""
    if NODE is None:
        return "there is no node here"
    if not (ROOT / "web" / "node_modules" / "playwright-core").is_dir():
        return "web/node_modules is not there: make browser-tests"
    return "" if CHROMIUM else "there is no Chromium here: make browser-tests"


needs_browser = pytest.mark.skipif(bool(why_not()), reason=why_not())


class Told(NamedTuple):
    """Answers to the steps, addresses that were asked, and errors of the page."""

    answers: list[Any]
    requests: list[str]
    errors: list[str]


def drive(folder: Path, *steps: dict[str, Any], **context: Any) -> Told:
    """Do steps in a browser without a network."""
    asked, told = folder / "steps.json", folder / "answers.json"
    seconds = SECONDS + sum(one.get("ms", 0) for one in steps) / 1000
    asked.write_text(json.dumps({"steps": steps, "context": context}, default=str))
    command = [str(NODE), str(ROOT / "tests" / "viewer" / "drive.mjs"), str(CHROMIUM), str(asked), str(told)]
    done = subprocess.run(command, cwd=ROOT / "web", capture_output=True, text=True, check=False, timeout=seconds)
    assert done.returncode == 0, done.stderr[-3000:]
    return Told(**json.loads(told.read_text()))
