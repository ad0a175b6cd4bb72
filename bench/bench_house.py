"""Size of the package: lines and files by room, functions that are too wide, docstrings that open badly.

    python bench/bench_house.py [--quick]

Lines are those of the files that git knows, with docstrings, blank lines and imports.
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
PARTICIPLES = re.compile(r"\b(?:found|held|made|given|told)\b")


def texts() -> dict[Path, str]:
    """Text of every Python file of the package, by its path below it."""
    told = subprocess.run(["git", "ls-files", PACKAGE], cwd=ROOT, check=True, capture_output=True, text=True)
    names = [name for name in told.stdout.split() if name.endswith(".py")]
    return {Path(name).relative_to(PACKAGE): (ROOT / name).read_text(encoding="utf-8") for name in names}


def measure() -> Figures:
    """Rooms, parts of the coder, and what a reader would trip over."""
    rooms, wide, openings = dict[str, Counter[str]](), list[str](), 0
    names: Counter[str] = Counter()
    for path, text in texts().items():
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
    return {
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
        at_most("files", rooms["all"]["files"], 280),
        at_most("lines of measure", rooms["measure"]["lines"], 5_500),
        at_most("lines of the coder", rooms["codec"]["lines"], 10_000),
        at_most("lines of the coder touch", rooms["codec/touch"]["lines"], 3_500),
        at_most("docstrings that open with What, Which, That or Whether", figures["docstrings_that_open_badly"], 0),
    ]


if __name__ == "__main__":
    bench("house", __doc__, measure, bars)
