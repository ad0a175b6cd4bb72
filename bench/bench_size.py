"""Counts lines and files of each package of the code base, and long functions.

    python bench/bench_size.py [--quick]

The lines are those of the files that git tracks, with docstrings, blank lines and imports. There is no bar.
"""

from __future__ import annotations

import ast
import subprocess
from collections import Counter
from pathlib import Path

from machine import Bar, Figures, bench

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = "src/touchfield"
MAX_PARAMETERS, MAX_LINES, MAX_COLUMNS = 10, 80, 110


def texts() -> dict[Path, str]:
    """Return the text of every Python file of the package, by its path in the package."""
    listed = subprocess.run(
        ["git", "ls-files", PACKAGE], cwd=ROOT, check=True, capture_output=True, text=True
    )
    names = [name for name in listed.stdout.split() if name.endswith(".py")]
    return {Path(name).relative_to(PACKAGE): (ROOT / name).read_text(encoding="utf-8") for name in names}


def large_functions(path: Path, text: str) -> list[str]:
    """List the functions with many parameters or many lines."""
    found = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            parameters = len(node.args.args) + len(node.args.kwonlyargs)
            lines = (node.end_lineno or node.lineno) - node.lineno + 1
            if parameters > MAX_PARAMETERS or lines > MAX_LINES:
                found.append(f"{path}: {node.name}, {parameters} parameters, {lines} lines")
    return found


def local_imports(text: str) -> int:
    """Count imports of the package's own modules within functions.

    An import in a nested function counts once.
    """
    imports = set()
    for function in ast.walk(ast.parse(text)):
        if not isinstance(function, (ast.FunctionDef, ast.AsyncFunctionDef)):
            continue
        for node in ast.walk(function):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("touchfield"):
                imports.add(node)
    return len(imports)


def measure() -> Figures:
    """Count for each package, and for all."""
    packages = dict[str, Counter[str]]()
    large = list[str]()
    for path, text in texts().items():
        counts = Counter(
            lines=text.count("\n"),
            files=1,
            wide_lines=sum(len(line) > MAX_COLUMNS for line in text.splitlines()),
            local_imports=local_imports(text),
        )
        for package in ("all", path.parts[0] if len(path.parts) > 1 else "(top)"):
            packages.setdefault(package, Counter()).update(counts)
        large += large_functions(path, text)
    ordered = sorted(packages.items(), key=lambda row: -row[1]["lines"])
    return {"packages": {name: dict(counts) for name, counts in ordered}, "large_functions": sorted(large)}


def bars(figures: Figures) -> list[Bar]:
    """Return no bars: sizes are information."""
    return []


if __name__ == "__main__":
    bench("size", __doc__, measure, bars, reads=("src/touchfield/**/*.py",))
