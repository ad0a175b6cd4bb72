"""A fast row of each table of the committed pages is what today's code gives, and a page states its origin.

The rows need no estimate: volumes of bodies, actuators counted whole, one coded frame. A failure means that
`docs/reproduction` has to be made again: `make reproduction`.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from reproduction import table_1_counts, table_2
from reproduction.__main__ import app
from reproduction.coding import CodedScene
from reproduction.experiment import SEEDS, Inputs
from reproduction.figure_9 import _datum, _points
from reproduction.origin import code_hash, input_hash
from reproduction.perceptual_bits import six_bits
from reproduction.progress import Steps
from reproduction.scenes import DepthInput, depth_inputs
from reproduction.section_5_1 import READINGS, PaperScene, scene_1
from reproduction.table_3_runs import Settings

from touchfield.cli import main as command_line
from touchfield.devices import device
from touchfield.sources.depth.depth_scene import DepthScene

PAGES = Path(__file__).resolve().parents[1] / "docs" / "reproduction"
SAME = 1e-6
"""Relative difference that libraries of other versions may cause."""


def committed(name: str) -> Any:
    return json.loads((PAGES / f"{name}.json").read_text())["data"]


@pytest.fixture(scope="module")
def falling() -> PaperScene:
    pytest.importorskip("mujoco", reason="the falling bodies are simulated with it")
    return scene_1(4)


def test_table_1_has_the_volume_of_the_bodies(falling: PaperScene) -> None:
    (stored,) = (s for s in committed("table1")["scenes"] if s["scene"] == falling.name)
    volumes = table_1_counts._by_volume(falling)
    assert volumes is not None and len(volumes) == 4
    for (reading, is_nominal), value in volumes.items():
        key = f"{reading}, {'nominal' if is_nominal else 'device'}"
        assert stored["object_count_by_volume"][key] == pytest.approx(value, rel=SAME), key


@pytest.mark.parametrize("reading", READINGS)
def test_table_2_has_the_actuators_of_the_first_frame(falling: PaperScene, reading: str) -> None:
    (stored,) = (s for s in committed("table2")["scenes"] if s["scene"] == falling.name)
    q = six_bits(device(table_2.DEVICE).force_max_n)
    found = table_2._found(falling, reading, q, Steps(lambda done, total: None, 1), quick=True)
    row = stored[reading]
    assert (row["object_count"], row["symbols"]) == (found.objects, found.symbols)
    assert (row["voxel_bits"], row["object_bits"]) == pytest.approx(
        (found.voxel_bits, found.object_bits), rel=SAME
    )


@pytest.fixture(scope="module")
def motorcycle(tmp_path_factory: pytest.TempPathFactory) -> DepthInput:
    pytest.importorskip("skimage", reason="the depth map comes with scikit-image")
    return depth_inputs(Inputs(tmp_path_factory.mktemp("pages")))[0]


@pytest.mark.parametrize("reading", READINGS)
def test_table_3_has_the_first_frame(motorcycle: DepthInput, reading: str) -> None:
    table = committed("table3")
    cases = table["sequences"][motorcycle.name]["variants"]["wall, camera"][reading]
    (stored,) = (c for c in cases if (c["m"], c["k"], c["is_high"]) == (1, 0.1, True))
    frames = max(c["m"] for c in cases)
    scene = CodedScene(DepthScene(motorcycle.first(frames).sequence, frame="camera"), table["nw"])
    found = scene.coded(Settings(table["nw"], table["nq"], (0.1,), (1,)).paper(reading, 0.1, True), 1)
    assert stored["bits_per_frame"] == [found.bits(0)] and stored["sent"] == [found.frames[0].sent]
    assert stored["cr_literal"] == pytest.approx(found.cr_literal, rel=SAME)
    for name, decibels in found.decibels.items():
        assert stored[f"db {name}"] == pytest.approx(decibels, abs=1e-4)


def test_figure_9_has_its_coarsest_points(motorcycle: DepthInput) -> None:
    stored = committed("fig9")["sequences"][motorcycle.name]
    points = _points(motorcycle, (5,), (4,), lambda: None)
    assert len(points) == 6
    for key, coded in points.items():
        found = _datum(key, coded)
        (row,) = (r for r in stored if all(r[k] == found[k] for k in ("reading", "is_high", "nw", "nq")))
        for name, value in found.items():
            assert row[name] == (pytest.approx(value, rel=SAME) if isinstance(value, float) else value), name


# -- the origin of a page ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", sorted(path.stem for path in PAGES.glob("*.json")))
def test_a_committed_page_states_its_origin(name: str) -> None:
    stored = json.loads((PAGES / f"{name}.json").read_text())
    origin, page = stored["origin"], (PAGES / f"{name}.md").read_text()
    assert re.fullmatch("[0-9a-f]{16}", origin["code"]) and origin["seeds"] == SEEDS
    assert stored["command"].startswith("python -m reproduction")
    for text in (origin["code"], *origin["inputs"].values()):
        assert text in page
    assert set(origin["inputs"]) == set(re.findall(r"--depth (\S+)", stored["command"]))


def test_a_hash_is_that_of_names_and_contents(tmp_path: Path) -> None:
    first, second = tmp_path / "a", tmp_path / "b"
    for folder in (first, second):
        (folder / "depth").mkdir(parents=True)
        (folder / "depth" / "0.png").write_bytes(b"12")
        (folder / "poses.txt").write_bytes(b"3")
    assert input_hash(first) == input_hash(second) != input_hash(first / "poses.txt")
    before = input_hash(first)
    (first / "poses.txt").rename(first / "pose.txt")
    renamed = input_hash(first)
    (first / "pose.txt").write_bytes(b"4")
    assert len({before, renamed, input_hash(first)}) == 3
    assert code_hash() == code_hash()


def test_two_runs_give_the_same_files(tmp_path: Path) -> None:
    """Figure 8 draws random directions; its pages, data and pictures are equal byte for byte."""
    pytest.importorskip("matplotlib", reason="the pictures are drawn with it")
    for folder in ("first", "second"):
        assert command_line._exit_code(["fig8", "--quick", "--out", str(tmp_path / folder)], app) == 0
    first, second = ({p.name: p.read_bytes() for p in (tmp_path / f).iterdir()} for f in ("first", "second"))
    assert first == second and len(first) >= 3
