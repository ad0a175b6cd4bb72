"""`--cite`, the version in results, and CITATION.cff."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from touchfield import __version__
from touchfield.cli.citations import SOURCES, cited_commands, sources_of
from touchfield.cli.main import COMMANDS, _exit_code
from touchfield.cli.output import Answer
from touchfield.measure.estimators import ESTIMATORS

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def sphere(tmp_path: Path) -> Path:
    path = tmp_path / "sphere.toml"
    path.write_text('[[shape]]\nkind = "sphere"\ncenter_m = [0.0, 0.0, 0.0]\nradius_m = 0.05\n')
    return path


def test_measure_prints_its_sources_only_if_asked(sphere: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["measure", str(sphere), "--nw", "4", "--no-limits"]
    assert _exit_code([*arguments, "--json"]) == 0
    plain = json.loads(capsys.readouterr().out)
    assert plain["touchfield"] == __version__ and "sources" not in plain
    assert _exit_code([*arguments, "--json", "--cite"]) == 0
    cited = json.loads(capsys.readouterr().out)
    assert cited.pop("sources") == list(sources_of("measure"))
    assert cited == plain, "the same figures"
    assert _exit_code([*arguments, "--cite"]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("source: ")]
    assert lines == [f"source: {text}" for text in sources_of("measure")]


def test_compare_and_plan_print_the_sources_of_their_figures(
    sphere: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stream = str(tmp_path / "sphere.touch")
    assert _exit_code(["encode", str(sphere), stream, "--nw", "4"]) == 0
    capsys.readouterr()
    plan = ["plan", str(sphere), "--budget", "1MB", "--nw", "4", "--k", "0.1", "--json", "--cite"]
    compare = ["compare", str(sphere), stream, "--no-picture", "--json", "--cite"]
    for arguments, author in ((compare, "Israr"), (plan, "Shoham")):
        assert _exit_code(arguments) == 0
        sources = json.loads(capsys.readouterr().out)["sources"]
        assert sources == list(sources_of(arguments[0])) and author in sources[-1]


def test_texture_prints_the_sources_of_its_figures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = "".join(f"{n / 4000:.6f},{np.sin(n):.6f}\n" for n in range(4000))
    (tmp_path / "drag.csv").write_text(f"t_s,a_m_s2\n{rows}")
    drag = [
        str(tmp_path / "drag.csv"),
        "-o",
        str(tmp_path / "oak.json"),
        "--speed-m-s",
        "0.1",
        "--force-n",
        "1",
    ]
    assert _exit_code(["texture", *drag, "--json", "--cite"]) == 0
    sources = json.loads(capsys.readouterr().out)["sources"]
    assert sources == list(sources_of("texture")) and "Landin" in sources[2]


def test_every_source_is_of_a_command_and_names_a_year() -> None:
    used = {text for command in cited_commands() for text in sources_of(command)}
    assert used == set(SOURCES.values()) and set(cited_commands()) <= set(COMMANDS)
    assert sources_of("devices") == ()
    for name, text in SOURCES.items():
        assert name in ("touchfield", "paper") or re.search(r"\b(19|20)\d\d\b", text)
    of_measure = " ".join(sources_of("measure"))
    assert all(name in of_measure for name in ESTIMATORS if name != "plug-in"), "every estimator has a source"


def test_modules_name_the_same_sources() -> None:
    """Each author named by a command is named by a module that computes its figures."""
    folders, suffixes = ("measure", "reduction", "perception", "tasks", "datasets/cards"), (".py", ".toml")
    paths = (path for folder in folders for path in (ROOT / "src/touchfield" / folder).iterdir())
    files = (path for path in paths if path.suffix in suffixes)
    code = "".join(path.read_text() for path in files)
    for name in set(SOURCES) - {"touchfield", "paper"}:
        assert name in code.lower(), name


def test_every_answer_has_the_version(capsys: pytest.CaptureFixture[str]) -> None:
    Answer({"a": np.float64(-0.0)}, "").show(as_json=True)
    assert json.loads(capsys.readouterr().out) == {"a": 0.0, "touchfield": __version__, "notes": []}


def test_citation_file_has_the_version_of_the_package() -> None:
    text = (ROOT / "CITATION.cff").read_text()
    assert re.search(r"^version: (.+)$", text, re.MULTILINE).group(1) == __version__  # type: ignore[union-attr]
    assert all(
        re.search(rf"^{key}:", text, re.MULTILINE) for key in ("cff-version", "message", "title", "authors")
    )
