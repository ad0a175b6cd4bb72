"""Size of the package: lines and files by room, functions that are too wide, docstrings that open badly.

    python bench/bench_house.py [--quick]

Lines are those of the files that git knows, with docstrings, blank lines and imports. The bar of 48,000 was set
before the page, the broadcast, the cluster and section 6 of the paper were built. What these brought counts apart:
all lines of the files that were made for them, and of other files those of their commits that nobody changed since.
"""

from __future__ import annotations

import ast
import re
import subprocess
from collections import Counter
from pathlib import Path

from machine import Bar, Figures, at_most, bench

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = "src/touchfield"
MOST_PARAMETERS, MOST_LINES = 10, 80
OPENINGS = ("What ", "Which ", "That ", "Whether ")
LATER_FILES = {
    "page": "viewer/browser viewer/page job/view stream/native stream/bridge",
    "broadcast": "stream/access stream/live stream/live_medium stream/live_client stream/live_server "
    "stream/datagrams stream/udp stream/server stream/mux container/remote job/live cli/broadcast sources/capture "
    "sources/recording",
    "cluster, zarr and GPU": "job/coding job/tiles job/executors medium/zarr_store codec/zarr_codec cuda",
    "section 6": "reduction/__init__ reduction/modes reduction/reach reduction/snapshots reduction/kernel_points "
    "reduction/kernels job/reduction job/deformation job/texture medium/deformation render/material "
    "perception/vibrotactile",
}
LATER_COMMITS = (
    *("0a98e570", "2629218a", "b8a7cf5b", "4062c90f", "6996066b"),  # page
    *("c6a98e56", "241f45ed", "6de27bb3", "fe9788e2", "4b98a28b", "e04fd08d"),  # broadcast
    *("e0e2208b", "a2ac06f2", "14e3ec80", "b5d594d2", "21b11e64"),
    *("30b14e57", "61af81a2", "e09c62b9", "615d668d", "cbaa2d51"),  # cluster, zarr and GPU
    *("52bbdc70", "d76d06a2", "d069f95c", "ac28671d", "c9dc7433", "c47dde8d"),  # section 6
    *("c425bb07", "6342d343", "7cc3c9c2", "aef9e7e5", "0a3b8399"),
)
PARTICIPLES = re.compile(r"\b(?:found|held|made|given|told)\b")


def texts() -> dict[Path, str]:
    """Text of every Python file of the package, by its path below it."""
    told = subprocess.run(["git", "ls-files", PACKAGE], cwd=ROOT, check=True, capture_output=True, text=True)
    names = [name for name in told.stdout.split() if name.endswith(".py")]
    return {Path(name).relative_to(PACKAGE): (ROOT / name).read_text(encoding="utf-8") for name in names}


def later(files: dict[Path, str]) -> dict[str, int]:
    """Lines that were asked for after the bar was set, by what asked for them."""
    lines = {path.with_suffix("").as_posix(): text.count("\n") for path, text in files.items()}
    counts = {name: sum(lines.pop(file) for file in words.split()) for name, words in LATER_FILES.items()}
    counts["in other files"] = 0
    for name in lines:
        blame = ["git", "blame", "-w", "-s", "--abbrev=8", f"{PACKAGE}/{name}.py"]
        told = subprocess.run(blame, cwd=ROOT, check=True, capture_output=True, text=True, encoding="utf-8")
        counts["in other files"] += sum(line.startswith(LATER_COMMITS) for line in told.stdout.splitlines())
    return counts


def measure() -> Figures:
    """Rooms, parts of the coder, and what a reader would trip over."""
    rooms, wide, openings = dict[str, Counter[str]](), list[str](), 0
    names: Counter[str] = Counter()
    files = texts()
    for path, text in files.items():
        lines = text.count("\n")
        room = path.parts[0] if len(path.parts) > 1 else "(top)"
        for part in ["all", room, *["/".join(path.parts[:2])] * (room == "codec" and len(path.parts) > 2)]:
            rooms.setdefault(part, Counter()).update(lines=lines, files=1)
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, (ast.FunctionDef, ast.ClassDef, ast.Module)):
                openings += (ast.get_docstring(node) or "").startswith(OPENINGS)
            if isinstance(node, ast.FunctionDef):
                count = len(node.args.args) + len(node.args.kwonlyargs)
                length = (node.end_lineno or node.lineno) - node.lineno + 1
                if count > MOST_PARAMETERS or length > MOST_LINES:
                    wide.append(f"{path}: {node.name}, {count} parameters, {length} lines")
            if isinstance(node, ast.Name) and PARTICIPLES.fullmatch(node.id):
                names[node.id] += isinstance(node.ctx, ast.Store)
    ordered = dict(sorted(rooms.items(), key=lambda row: -row[1]["lines"]))
    asked_later = later(files)
    return {
        "asked_later": asked_later,
        "lines_without": rooms["all"]["lines"] - sum(asked_later.values()),
        "rooms": {name: dict(row) for name, row in ordered.items()},
        "wide": sorted(wide),
        "docstrings_that_open_badly": openings,
        "participles": dict(names.most_common()),
    }


def bars(figures: Figures) -> list[Bar]:
    """Sizes that a stranger can take over."""
    rooms = figures["rooms"]
    return [
        at_most("lines", rooms["all"]["lines"], 48_000),
        at_most("lines without what was asked for later", figures["lines_without"], 48_000),
        at_most("files", rooms["all"]["files"], 280),
        at_most("lines of measure", rooms["measure"]["lines"], 5_500),
        at_most("lines of the coder", rooms["codec"]["lines"], 10_000),
        at_most("lines of the coder touch", rooms["codec/touch"]["lines"], 3_500),
        at_most("docstrings that open with What, Which, That or Whether", figures["docstrings_that_open_badly"], 0),
    ]


if __name__ == "__main__":
    bench("house", __doc__, measure, bars, reads=("src/touchfield/**/*.py",))
