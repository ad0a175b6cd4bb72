"""Pages of instructions: their code runs, block after block, in an empty folder; and the site builds."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from touchfield.cli.main import _exit_code

DOCS = Path(__file__).resolve().parents[1] / "docs"
PAGES = [
    DOCS / "index.md",
    *sorted((DOCS / "tutorial").glob("*.md")),
    *sorted((DOCS / "how-to").glob("*.md")),
]
NEEDS = {"simulation": "mujoco", "broadcast": "av"}
"""Libraries needed by a page, besides those for pictures."""


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_code_of_a_page_runs(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for library in ("matplotlib", *filter(None, [NEEDS.get(page.stem)])):
        pytest.importorskip(library)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    names: dict[str, Any] = {}
    blocks = re.findall(r"^```(python|sh)\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE)
    assert blocks
    for language, text in blocks:
        if language == "python":
            exec(compile(text, page.name, "exec"), names)
            continue
        for line in text.splitlines():
            program, *arguments = shlex.split(line, comments=True)
            assert program == "touchfield"
            assert _exit_code(arguments) == 0, (line, capsys.readouterr().err)
    for picture in re.findall(r"(?:--plot|--preview|--out) (\S+\.png)", page.read_text()):
        assert (tmp_path / picture).stat().st_size > 10_000


def test_the_site_builds_with_every_link_checked(tmp_path: Path) -> None:
    pytest.importorskip("mkdocs", reason="the site is made by the extra docs")
    pytest.importorskip("mkdocstrings")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site")]
    built = subprocess.run(command, cwd=DOCS.parent, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stdout + built.stderr
    page = (tmp_path / "site" / "api" / "medium" / "index.html").read_text()
    assert "float32 [n, 8, 8, 8, 3]" in page
    for file in (tmp_path / "site").rglob("*.html"):
        assert not re.search(r'<(?:script|link|img)[^>]+(?:src|href)="https?://', file.read_text()), file
