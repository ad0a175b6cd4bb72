"""Writes the results of experiments as files: NAME.md and NAME.json for each, and one page for all of them.

A page names the command that makes it again, the versions, hashes and seeds that made it, and nothing of the
machine, so that two machines give the same page. Every file is there whole or not at all.
"""

from __future__ import annotations

import json
import math
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from reproduction.experiment import Experiment, Finding
from touchfield._version import __version__
from touchfield.atomic import atomic_path
from touchfield.errors import TouchfieldError

__all__ = ["PAGE", "Made", "command", "versions", "write_finding", "write_page"]

PAGE = "reproduction.md"
"""The page of all experiments."""

_LIBRARIES = ("numpy", "numba", "scipy", "matplotlib", "scikit-image", "mujoco-core")

_INTRODUCTION = """\
Moustakas and Lalos, *An information-theoretic treatment of passive haptic media*. The paper's own inputs and its
force field generator are not published, so that its figures cannot be met digit for digit: what can be checked are
sample counts, raw sizes, identities and trends. *Printed* is the paper's figure; *literal* is ours with the formulas
as they are printed; *corrected* is ours with what is at fault in them mended.
"""


@dataclass(frozen=True)
class Made:
    """An experiment and what became of it: a finding, or the error that kept it from being made."""

    experiment: Experiment
    finding: Finding | None = None
    error: TouchfieldError | None = None


def command(names: Sequence[str], depth: Sequence[Path] = (), quick: bool = False) -> str:
    """The command line that makes a page again; folders by their names alone."""
    words = ["python", "-m", "reproduction", *names]
    for folder in depth:
        words += ["--depth", Path(folder).resolve().name]
    return " ".join([*words, *(["--quick"] if quick else [])])


def versions() -> dict[str, str]:
    """What made a page: touchfield, Python, and the libraries whose versions may move a digit."""
    found = {"touchfield": __version__, "Python": platform.python_version()}
    for library in _LIBRARIES:
        try:
            found[library] = version(library)
        except PackageNotFoundError:
            continue
    return found


def write_finding(
    folder: Path, experiment: Experiment, finding: Finding, made_by: str, source: Mapping[str, Any]
) -> Path:
    """Write NAME.md and NAME.json; the path of the page.

    Parameters
    ----------
    folder : Path
        Where its pictures are already.
    made_by : str
        As `command` gives it.
    source : dict
        As `reproduction.origin.origin` gives it.
    """
    page = folder / f"{experiment.name}.md"
    _write(page, f"# {experiment.title}\n\n{_made_by(made_by, source)}\n{finding.markdown.rstrip()}\n")
    told = {
        "name": experiment.name,
        "title": experiment.title,
        "command": made_by,
        "versions": versions(),
        "origin": plain(source),
        "pictures": [picture.name for picture in finding.pictures],
        "data": plain(finding.data),
    }
    _write(folder / f"{experiment.name}.json", json.dumps(told, indent=1, allow_nan=False) + "\n")
    return page


def write_page(folder: Path, made: Sequence[Made], made_by: str, source: Mapping[str, Any]) -> Path:
    """Write the page of all experiments; what could not be made is told where it would stand."""
    lines = [
        "# The paper's tables and figures, made again\n",
        _INTRODUCTION,
        _made_by(made_by, source),
        "## Contents\n",
    ]
    for one in made:
        state = "" if one.error is None else " (not made)"
        lines.append(f"- [{one.experiment.title}](#{anchor(one.experiment.title)}){state}")
    for one in made:
        lines.append(f"\n## {one.experiment.title}\n")
        if one.finding is not None:
            lines.append(one.finding.markdown.rstrip())
        else:
            lines.append(f"Not made: {one.error}.")
    page = folder / PAGE
    _write(page, "\n".join(lines) + "\n")
    return page


def anchor(heading: str) -> str:
    """What a Markdown page calls a heading: lower case, blanks as hyphens, no other marks."""
    return "".join(c if c.isalnum() or c in "-_" else "-" if c == " " else "" for c in heading.lower())


def plain(value: Any) -> Any:
    """The same as `json` takes it: numpy's numbers as Python's, what is not finite as None."""
    if isinstance(value, Mapping):
        return {str(key): plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [plain(part) for part in value]
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _made_by(made_by: str, source: Mapping[str, Any]) -> str:
    with_versions = ", ".join(f"{name} {number}" for name, number in versions().items())
    hashes = [f"code {source['code']}", *(f"{name} {value}" for name, value in source["inputs"].items())]
    seeds = ", ".join(f"{name} {value}" for name, value in source["seeds"].items())
    return f"Made by `{made_by}` with {with_versions}. Hashes: {', '.join(hashes)}. Seeds: {seeds}.\n"


def _write(path: Path, text: str) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
