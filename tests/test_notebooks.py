"""The notebooks agree with the how-to pages, and their stored outputs are those of their cells."""

from __future__ import annotations

import base64
import importlib.util
import io
import json
import re
import shlex
import warnings
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from PIL import Image

import touchfield as tf
from touchfield.cli.main import _exit_code
from touchfield.errors import TouchfieldError

DOCS = Path(__file__).resolve().parents[1] / "docs"


def module(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"notebooks_{name}", DOCS / "notebooks" / f"{name}.py")
    assert spec is not None and spec.loader is not None
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded


BUILD = module("build")
NUMBER = re.compile(r"[-+]?\d[\d,]*\.?\d*(?:e[-+]?\d+)?")
ENCODED = {
    "scan": {"scan.touch"},
    "depth-camera": {"room.touch"},
    "codec-experiment": set(),  # the encodings of the page's Python block, which the notebook contains
    "study": {"fine.touch", "k05.touch", "k10.touch", "k20.touch", "k40.touch", "k80.touch"},
}
"""Files that both a page's commands and its notebook encode."""


def blocks(name: str, language: str) -> list[str]:
    """The blocks of a language in a how-to page."""
    page = (DOCS / "how-to" / f"{name}.md").read_text()
    return re.findall(rf"^```{language}\n(.*?)^```", page, re.DOTALL | re.MULTILINE)


def outputs_of(notebook: dict[str, Any]) -> tuple[str, list[Image.Image]]:
    """The printed texts, and the pictures."""
    texts, pictures = [], []
    for cell in notebook["cells"]:
        for output in cell.get("outputs", []):
            data = output.get("data", {})
            if "image/png" in data:
                pictures.append(Image.open(io.BytesIO(base64.b64decode(data["image/png"]))))
            else:
                texts.append("".join(output.get("text") or data["text/plain"]))
    return "\n".join(texts), pictures


@pytest.mark.parametrize("name", BUILD.NAMES)
def test_a_notebook_has_the_code_of_its_page(name: str) -> None:
    notebook = BUILD.read_notebook(name)
    cells = [BUILD.text_of(cell) for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert blocks(name, "python")
    for block in blocks(name, "python"):
        assert block.rstrip("\n") in cells, f"{name}.ipynb lacks a cell of docs/how-to/{name}.md"


@pytest.mark.parametrize("name", BUILD.NAMES)
def test_stored_outputs_are_complete_and_name_no_machine(name: str) -> None:
    notebook = BUILD.read_notebook(name)
    nbformat = pytest.importorskip("nbformat", reason="checks the form of notebooks")
    nbformat.validate(notebook, relax_add_props=False)
    code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert [cell["execution_count"] for cell in code] == [*range(1, len(code) + 1)], (
        "run docs/notebooks/build.py"
    )
    text, pictures = outputs_of(notebook)
    assert text and len(pictures) >= 2 and sum(len(picture.tobytes()) for picture in pictures) < 1 << 24
    stored = json.dumps([cell["outputs"] for cell in code])
    assert not re.search(r"/(tmp|home|root|work|usr|Users|var)/|[A-Z]:\\\\|site-packages", stored)
    assert len((DOCS / "notebooks" / f"{name}.ipynb").read_bytes()) < 700_000
    for picture in pictures:
        assert len(picture.convert("RGB").getcolors(1 << 22)) > 50, "a picture shows something"


def test_the_study_finds_what_its_page_says() -> None:
    page = (DOCS / "how-to" / "study.md").read_text()
    text, _ = outputs_of(BUILD.read_notebook("study"))
    levels = re.search(r"millinewtons rms: ([\d, ]+) and (\d+)\.", page)
    fit = re.search(
        r"threshold of (\d+) mN, with an interval from (\d+) to (\d+) mN", page.replace("\n", " ")
    )
    assert levels is not None and fit is not None
    assert ", ".join(f"{level} mN" for level in (*levels[1].split(", "), levels[2])) in text
    assert f"threshold {fit[1]} mN, interval {fit[2]} to {fit[3]} mN" in text


def test_pages_of_the_site_have_every_cell() -> None:
    pytest.importorskip("mkdocs", reason="the site is made by the extra docs")
    pages = module("pages")
    notebook = BUILD.read_notebook("scan")
    text, pictures = pages.page_of(notebook, "scan")
    assert all(BUILD.text_of(cell) in text for cell in notebook["cells"])
    assert len(pictures) == len(outputs_of(notebook)[1]) and all(f"({name})" in text for name in pictures)
    linked = pages.on_page_markdown("[A](scan.ipynb) and [Download](scan.ipynb)")
    assert linked == "[A](scan.md) and [Download](scan.ipynb)"


def specs_of_page(name: str, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """The spec of each encoding among the commands of a page, by the file."""
    specs: dict[str, Any] = {}

    def record(source: str, out: Path, spec: Any, *_: Any, **__: Any) -> None:
        specs[str(out)] = (str(source), spec)
        raise TouchfieldError("it is recorded")

    with monkeypatch.context() as patched:
        patched.setattr("touchfield.pipeline.encode", record)
        for line in "".join(blocks(name, "sh")).splitlines():
            if line.startswith("touchfield encode ") and "--target-bytes" not in line:
                assert _exit_code(shlex.split(line, comments=True)[1:]) == 1
    return specs


@pytest.mark.thorough
@pytest.mark.parametrize("name", BUILD.NAMES)
def test_a_notebook_runs_and_encodes_as_its_page_does(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("matplotlib", reason="the notebooks draw with matplotlib")
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    monkeypatch.chdir(tmp_path)
    encode, recorded = tf.encode, {}

    def recording(source: str, out: str, spec: Any) -> Any:
        recorded[out] = (source, spec)
        return encode(source, out, spec)

    monkeypatch.setattr(tf, "encode", recording)
    with warnings.catch_warnings():  # a notebook may change the filters
        generated = BUILD.run_notebook(BUILD.read_notebook(name), name)
    monkeypatch.undo()
    expected = specs_of_page(name, monkeypatch)
    assert ENCODED[name] == recorded.keys() & expected.keys()
    assert {out: recorded[out] for out in ENCODED[name]} == {out: expected[out] for out in ENCODED[name]}
    (text, pictures), (stored, stored_pictures) = outputs_of(generated), outputs_of(BUILD.read_notebook(name))
    assert NUMBER.sub("#", text) == NUMBER.sub("#", stored), "run docs/notebooks/build.py"
    numbers = [[float(n.replace(",", "")) for n in NUMBER.findall(t)] for t in (text, stored)]
    np.testing.assert_allclose(*numbers, rtol=0.02, atol=0.02)  # the last digits depend on the machine
    assert [p.size for p in pictures] == [p.size for p in stored_pictures]
