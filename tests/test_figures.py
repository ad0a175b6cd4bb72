"""Figures of README are those of the last benchmarks, and every benchmark has bars."""

from __future__ import annotations

import ast
import importlib
import json
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
README = " ".join((ROOT / "README.md").read_text().split())


def results(name: str) -> Any:
    return json.loads((ROOT / "bench" / "results" / f"{name}.json").read_text())


def row(rows: list[dict[str, Any]], **wanted: Any) -> dict[str, Any]:
    """The one row with these values."""
    (one,) = (r for r in rows if all(r[key] == value for key, value in wanted.items()))
    return one


def of_rate() -> list[str]:
    rate = results("rate")
    peer = {key: [f"{value:.2g}" for value in pair] for key, pair in rate["best_peer_over_ours"].items()}
    default, nmse = (peer[f"{key}, 1 frame"] for key in ("default, promise", "default, NMSE"))
    tum, icl = (row(rate["speeds"], field=f"{name} band, nw 7", effort="default") for name in ("tum", "icl"))
    decode, encode = ([round(s[f"{key}_frames_s"]) for s in (tum, icl)] for key in ("decode", "encode"))
    return [
        f"needs {default[0]} to {default[1]} times the bytes of effort `default`",
        f"it needs {nmse[0]} to {nmse[1]} times those of `default`",
        f"the TUM walls decode at {decode[0]} frames a second and the ICL walls at {decode[1]}",
        f"and encode at {encode[0]} and {encode[1]}.",
        f"take {rate['objects']['file of objects, coder touch'] / 1000:.0f} kilobytes",
    ]


def of_motion() -> list[str]:
    ball = row(results("motion")["slides"], field="ball", nw=7, speed_mm_s=100.0)
    return [
        f"takes {ball['bytes'] / 1000:.1f} kB",
        f"meets an error of {ball['error_mn']:.1f} mN, where the lattice itself makes {ball['lattice_mn']:.1f}",
    ]


def of_fusion() -> list[str]:
    alone, fused = (row(results("fusion")["standing"], sequence="TUM fr1_rpy", world=w) for w in ("frames", "fused"))
    assert fused["share"] == 0 and round(1 / fused["of_frames"]) == 5
    return [f"{100 * alone['share']:.0f} % of the samples change", "and none when ten frames are fused", "a fifth of"]


def of_startup() -> list[str]:
    startup = results("startup")
    first, second = startup["first_encode_s"], startup["second_encode_s"]
    return [f"the terrain takes {first:.0f} seconds here, on two cores, and {second:.0f} after that"]


@pytest.mark.parametrize("make", [of_rate, of_motion, of_fusion, of_startup], ids=lambda f: f.__name__[3:])
def test_figures_are_those_of_the_benchmark(make: Any) -> None:
    for words in make():
        assert words in README, words


def kept() -> list[str]:
    """Names of the results that a script keeps."""
    return sorted(path.stem for path in (ROOT / "bench" / "results").glob("*.json"))


@pytest.mark.parametrize("name", kept())
def test_a_result_has_bars_that_follow_from_its_figures(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", [str(ROOT / "bench"), *sys.path])
    module = importlib.import_module("rate" if name == "rate" else f"bench_{name}")
    figures = results(name)
    bars = figures["bars"]
    assert bars and bars == json.loads(json.dumps(module.bars(figures), default=float))
    for bar in bars:
        assert set(bar) == {"bar", "measured", "way", "limit", "unit", "met"}
        more, limit = bar["way"] == "at least", bar["limit"]
        assert more or bar["way"] == "at most"
        measured = bar["measured"]
        assert bar["met"] is (None if measured is None else (measured >= limit if more else measured <= limit))


def test_every_benchmark_keeps_a_result() -> None:
    scripts = {path.stem.removeprefix("bench_") for path in (ROOT / "bench").glob("bench_*.py")}
    assert scripts | {"rate"} == set(kept())


@pytest.mark.parametrize("script", sorted((ROOT / "bench").glob("*.py")), ids=lambda path: path.stem)
def test_a_benchmark_asks_for_names_that_there_are(script: Path) -> None:
    for node in ast.walk(ast.parse(script.read_text())):
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith("touchfield."):
            module = importlib.import_module(str(node.module))
            for name in node.names:
                assert hasattr(module, name.name) or importlib.import_module(f"{node.module}.{name.name}")
