"""Defines what an experiment is (one table or figure of the paper), and lists all of them.

An experiment is one module of this room that ends in ``EXPERIMENT = Experiment(name, title, run)``, and one
line in `MODULES`. ``run(inputs)`` computes, draws its pictures into ``inputs.folder`` (named after itself),
and gives a `Finding`: the Markdown that lays the paper's printed figures beside ours, and the same as JSON.
It reads nothing but what `Inputs` names and what comes with the libraries, and gives the same numbers every
time.

A table has a row for each figure of the paper with the columns *printed* (the paper's), *literal* (ours, read
as the paper prints it), *corrected* (ours), and one line on why they differ.

The rest of the contract, which `reproduction.page` and `python -m reproduction` rely on:

* The name is short: module ``table_3``, name ``table3``; module ``figure_9``, name ``fig9``. Pictures are
  ``NAME.png`` or ``NAME_WORD.png``, written whole or not at all (`touchfield.viewer.page.write_png`), and the
  Markdown shows them as ``![what it shows](NAME.png)``. Its headings begin at the third level (``###``).
* Importing the module is cheap; what is heavy is imported in ``run``. A library that is not there is a
  `MissingExtra` out of ``run``.
* Neither Markdown nor data hold a path, a date or a time taken: a page is the same on every machine. A depth
  sequence is called by its `reproduction.scenes.DepthInput.name`.
* Data hold what `json` takes; a number that is not finite is None.
* ``depth_inputs(inputs)`` of `reproduction.scenes` gives the depth sequences: the one without download
  first, then the user's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from touchfield.errors import InvalidArgument, MissingExtra

__all__ = [
    "MODULES",
    "SEEDS",
    "Experiment",
    "Finding",
    "Inputs",
    "experiment",
    "experiments",
    "markdown_table",
    "require_drawing",
]

MODULES = (
    "table_1",
    "table_2",
    "table_3",
    "figure_2",
    "figure_3",
    "figure_5",
    "figure_6",
    "figure_8",
    "figure_9",
)
"""In the order of the page; ``table_1`` is called table1 on the command line."""

SEEDS = {"lattice_starts": 0, "sensor_noise": 0, "directions": 8}
"""The seed of everything that is drawn at random."""


@dataclass(frozen=True)
class Inputs:
    """What an experiment may use.

    Parameters
    ----------
    folder : Path
        Where pictures go.
    depth : tuple of Path
        Depth sequences of the user, of any layout that `touchfield.sources` reads, beside the one without
        download.
    report : callable
        ``report(done, total)``.
    quick : bool
        Smaller sizes, for tests; the page says so.
    """

    folder: Path
    depth: tuple[Path, ...] = ()
    report: Callable[[int, int], None] = lambda done, total: None
    quick: bool = False


@dataclass(frozen=True)
class Finding:
    """What an experiment found.

    Parameters
    ----------
    markdown : str
        Tables and text; no heading of its own. Pictures are named by their file name alone.
    data : dict
        The same figures for programs, as JSON takes them.
    pictures : tuple of Path
        What was drawn, in ``inputs.folder``.
    """

    markdown: str
    data: dict[str, Any] = field(default_factory=dict)
    pictures: tuple[Path, ...] = ()


@dataclass(frozen=True)
class Experiment:
    """One table or figure of the paper.

    Parameters
    ----------
    name : str
        The module's, shortened: ``table3``, ``fig9``.
    title : str
        The heading of its page: "Table 3: benefits of perceptual haptic filters".
    run : callable
        ``run(inputs) -> Finding``.
    """

    name: str
    title: str
    run: Callable[[Inputs], Finding]


def _loaded(module: str) -> Experiment:
    found: Experiment = import_module(f"reproduction.{module}").EXPERIMENT
    return found


@cache
def experiments() -> tuple[Experiment, ...]:
    """All experiments, in the order of the page."""
    return tuple(_loaded(module) for module in MODULES)


def experiment(name: str) -> Experiment:
    """An experiment by its name (``fig9``, also ``figure9`` or ``figure_9``); no other is imported.

    Raises
    ------
    InvalidArgument
        If there is none; the message lists those that are.
    """
    modules = {_short(module): module for module in MODULES}
    module = modules.get(_short(name))
    if module is None:
        raise InvalidArgument("experiment", repr(name), f"one of {', '.join(modules)}, or all")
    return _loaded(module)


def _short(name: str) -> str:
    return name.replace("figure", "fig").replace("_", "")


def require_drawing(purpose: str) -> None:
    """Say that the library that draws is missing before the work, not after it.

    Raises
    ------
    MissingExtra
        If matplotlib is not installed.
    """
    if find_spec("matplotlib") is None:
        raise MissingExtra(purpose, "matplotlib", "report")


def markdown_table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """A table in Markdown; "|" in a cell is escaped."""
    lines = [head, ["---"] * len(head), *rows]
    return (
        "\n".join("| " + " | ".join(str(c).replace("|", "\\|") for c in line) + " |" for line in lines) + "\n"
    )
