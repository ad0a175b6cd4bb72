"""The scripts of the gallery run, and its pages are their output."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from PIL import Image

GALLERY = Path(__file__).resolve().parents[1] / "docs" / "gallery"


def builder() -> ModuleType:
    spec = importlib.util.spec_from_file_location("gallery_build", GALLERY / "build.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


BUILD = builder()
NUMBER = re.compile(r"[-+]?\d[\d,]*\.?\d*(?:e[-+]?\d+)?")


def split(page: str) -> tuple[str, list[float]]:
    """The text and code of a page with blanked numbers of outputs, and those numbers."""
    numbers: list[float] = []
    for output in re.findall(r"```text\n.*?```", page, re.DOTALL):
        numbers += [float(n.replace(",", "")) for n in NUMBER.findall(output)]
    return re.sub(r"```text\n.*?```", "```text```", page, flags=re.DOTALL), numbers


@pytest.mark.parametrize("name", BUILD.SCRIPTS)
def test_a_page_is_the_output_of_its_script(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("matplotlib", reason="the gallery draws with matplotlib")
    if name == "six_devices":
        pytest.importorskip("skimage", reason="the motorcycle comes with scikit-image")
    monkeypatch.setenv("MPLBACKEND", "agg")
    generated, stored = split(BUILD.page(name, tmp_path)), split((GALLERY / f"{name}.md").read_text())
    assert generated[0] == stored[0], "run `make gallery`"
    np.testing.assert_allclose(
        generated[1], stored[1], rtol=0.02, atol=0.02
    )  # the last digits depend on the machine
    pictures = re.findall(r"!\[.*?\]\((.*?)\)", generated[0])
    assert pictures == [f"{name}.png"], "each page ends in its figure"
    with Image.open(tmp_path / pictures[0]) as new, Image.open(GALLERY / pictures[0]) as old:
        assert new.size == old.size
        assert len(new.convert("RGB").getcolors(1 << 22)) > 50, "and the figure shows something"


def test_the_index_names_every_page() -> None:
    index = (GALLERY / "README.md").read_text()
    assert BUILD.SCRIPTS
    for name in BUILD.SCRIPTS:
        assert f"({name}.md)" in index and f"({name}.png)" in index
        assert (GALLERY / f"{name}.md").exists() and (GALLERY / f"{name}.png").exists()
