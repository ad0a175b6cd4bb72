"""Figures of the pages equal those of the last benchmarks, and every benchmark has bars."""

from __future__ import annotations

import ast
import importlib
import json
import re
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text()
PAGES = ["README.md", "docs/coding.md", "docs/depth-sequences.md", "docs/scale.md"]
BENCH = str(ROOT / "bench")


@pytest.fixture(autouse=True)
def bench_on_path(monkeypatch: pytest.MonkeyPatch) -> None:
    """Modules of bench/ import each other by name."""
    monkeypatch.setattr(sys, "path", [BENCH, *sys.path])


def results(name: str) -> Any:
    return json.loads((ROOT / "bench" / "results" / f"{name}.json").read_text())


@pytest.mark.parametrize("page", PAGES)
def test_a_page_quotes_the_figures_of_the_results(page: str) -> None:
    quotes = importlib.import_module("quotes")
    quotes_of_page = [quote for quote in quotes.quotes() if quote.page == page]
    text = quotes.text_of(page)
    assert quotes_of_page and quotes.missing(page, text) == []
    assert quotes.written(page, text) == text
    found = quotes_of_page[0].pattern.search(text)
    assert found is not None
    wrong = text[: found.start(1)] + "98765" + text[found.end(1) :]
    assert quotes.missing(page, wrong) == [quotes_of_page[0]]
    assert quotes.written(page, wrong) == text


def test_every_quote_is_on_a_tested_page() -> None:
    assert {quote.page for quote in importlib.import_module("quotes").quotes()} == set(PAGES)


def test_readme_quotes_no_stale_result() -> None:
    """Remeasure with bench/run_all.py --rerun-stale, then bench/quotes.py --write."""
    quotes, machine = importlib.import_module("quotes"), importlib.import_module("machine")
    names = sorted({quote.result for quote in quotes.quotes() if quote.page == quotes.README})
    outdated = {name: machine.stale(name)[:5] for name in names if machine.stale(name)}
    assert names and outdated == {}


def test_readme_quotes_no_absolute_speed() -> None:
    assert re.findall(r"\d (?:frames a second|frames/s|us\b|ms\b(?! of)|M/s)", README) == []


def stored_results() -> list[str]:
    """Names of the stored results."""
    return sorted(path.stem for path in (ROOT / "bench" / "results").glob("*.json"))


@pytest.mark.parametrize("name", stored_results())
def test_a_result_has_bars_that_follow_from_its_figures(name: str) -> None:
    module = importlib.import_module("rate" if name == "rate" else f"bench_{name}")
    figures = results(name)
    bars = figures["bars"]
    assert bars or name == "size"  # sizes are informative only
    assert bars == json.loads(json.dumps(module.bars(figures), default=float))
    for bar in bars:
        assert set(bar) == {"bar", "measured", "way", "limit", "unit", "met"}
        more, limit = bar["way"] == "at least", bar["limit"]
        assert more or bar["way"] == "at most"
        measured = bar["measured"]
        assert bar["met"] is (
            None if measured is None else (measured >= limit if more else measured <= limit)
        )


def test_every_benchmark_has_a_stored_result() -> None:
    scripts = {path.stem.removeprefix("bench_") for path in (ROOT / "bench").glob("bench_*.py")}
    assert scripts | {"rate"} == set(stored_results())


@pytest.mark.parametrize("script", sorted((ROOT / "bench").glob("*.py")), ids=lambda path: path.stem)
def test_a_benchmark_imports_existing_names(script: Path) -> None:
    for node in ast.walk(ast.parse(script.read_text())):
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith("touchfield."):
            module = importlib.import_module(str(node.module))
            for name in node.names:
                assert hasattr(module, name.name) or importlib.import_module(f"{node.module}.{name.name}")
