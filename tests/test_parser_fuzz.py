"""The harness that damages files: its mutators keep what they should, and it sees what a reader does."""

from __future__ import annotations

import importlib
import json
import random
import subprocess
import sys
import zlib
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

import hmpg_makers
from room_makers import write_png

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(autouse=True)
def bench_on_path(monkeypatch: pytest.MonkeyPatch) -> None:
    """Modules of bench/ import each other by name."""
    monkeypatch.setattr(sys, "path", [str(ROOT / "bench"), *sys.path])


def mutants(mutator: Any, data: bytes, count: int = 60) -> list[bytes]:
    """Damage a file by the mutator of a name, with as many seeds."""
    module, _, name = mutator.partition(".")
    mutate = getattr(importlib.import_module(module), name)
    return [mutate(data, random.Random(seed)) for seed in range(count)]


@pytest.mark.parametrize(
    ("mutator", "data"),
    [
        ("mutation.json_tree", b'{"a": [1, 2, {"b": "text"}], "c": null}'),
        ("mutation.xml_tree", b'<r><a x="1" y="2">3</a><b/></r>'),
        ("mutation.columns", b"1 2 3\n4 5 6\n"),
        ("mutation.raw", bytes(range(64))),
    ],
)
def test_a_case_is_the_same_in_every_run(mutator: str, data: bytes) -> None:
    found = mutants(mutator, data)
    assert found == mutants(mutator, data)
    assert len(set(found)) > 30


def test_most_mutants_of_a_tree_remain_json() -> None:
    sound = 0
    for mutant in mutants("mutation.json_tree", b'{"a": [1, 2, {"b": "text"}], "c": 3}'):
        with suppress(ValueError, RecursionError):
            json.loads(mutant)
            sound += 1
    assert sound > 30


def test_the_checks_of_a_png_hold(tmp_path: Path) -> None:
    import numpy as np

    data = write_png(tmp_path / "a.png", np.arange(64, dtype=np.uint16).reshape(8, 8)).read_bytes()
    sound = 0
    for mutant in mutants("mutation_binary.png", data):
        at = mutant.find(b"IHDR")
        size = int.from_bytes(mutant[at - 4 : at], "big")
        check = int.from_bytes(mutant[at + 4 + size : at + 8 + size], "big")
        sound += at > 0 and zlib.crc32(mutant[at : at + 4 + size]) == check
    assert sound > 40


def test_units_of_hmpg_keep_their_lengths() -> None:
    module = importlib.import_module("mutation_binary")
    split = module.split_by(module._unit_head, 0)
    mutate = module.one_of(module.hmpg(importlib.import_module("mutation").bit_fields))
    assert len(split(hmpg_makers.FILE)[1]) == 4
    whole = [split(mutate(hmpg_makers.FILE, random.Random(seed)))[2] == b"" for seed in range(60)]
    assert sum(whole) > 30


def test_the_worker_sees_what_a_reader_does() -> None:
    done = subprocess.run(
        [sys.executable, str(ROOT / "tests" / "parser_oracle.py")],
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    judged = json.loads(done.stdout)
    assert {name: text for name, text in judged.items() if not text.startswith(name.split()[0])} == {}
    for name, reason in (
        ("open_outside", "elsewhere"),
        ("read_by_c", "outside the folder"),
        ("leave_a_file", "a file is left"),
        ("warn", "RuntimeWarning: overflow"),
        ("take_memory", "MiB for 5 bytes"),
    ):
        assert reason in judged[f"FAULT {name}"]
