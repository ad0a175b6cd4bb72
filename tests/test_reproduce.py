"""`python -m reproduction`: its experiments, pages, errors and input sequences."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from reproduction import experiment as frame, page, scenes
from reproduction.__main__ import app
from reproduction.experiment import Experiment, Finding, Inputs, markdown_table

from experiment_makers import Plane, plane_depth_m
from touchfield.atomic import atomic_path
from touchfield.cli import main as command_line
from touchfield.errors import InvalidArgument, MissingExtra, SourceError


def _exit_code(arguments: list[str]) -> int:
    """Exit code of `python -m reproduction`."""
    return command_line._exit_code(arguments, app)


def _found(inputs: Inputs) -> Finding:
    inputs.report(1, 1)
    with atomic_path(inputs.folder / "good1.png") as temporary:
        Image.new("L", (2, 2), 7).save(temporary, "png")
    data = {"a": np.float64(1.5), "b": [np.int64(2), float("nan")], "quick": inputs.quick}
    return Finding("![a square](good1.png)\n\nBody.", data, (inputs.folder / "good1.png",))


def _missing(inputs: Inputs) -> Finding:
    raise MissingExtra("the bodies", "mujoco", "physics")


GOOD = Experiment("good1", "Good 1: what is made", _found)
BAD = Experiment("bad1", "Bad 1: what lacks a library", _missing)


@pytest.fixture
def toys(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Two experiments instead of the paper's: one that works, one that lacks a library."""
    monkeypatch.setattr(frame, "MODULES", ("good_1", "bad_1"))
    monkeypatch.setattr(frame, "_loaded", {"good_1": GOOD, "bad_1": BAD}.__getitem__)
    frame.experiments.cache_clear()
    yield
    frame.experiments.cache_clear()  # discard the toy experiments


@pytest.mark.usefixtures("toys")
def test_one_experiment_has_a_page_and_a_json_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "new" / "folder"
    assert _exit_code(["good_1", "--out", str(out), "--json", "--quick"]) == 0
    stdout = json.loads(capsys.readouterr().out)
    assert stdout["good1"] == {"a": 1.5, "b": [2, None], "quick": True}
    text = (out / "good1.md").read_text()
    assert text.startswith("# Good 1: what is made\n") and "Body." in text
    assert "`python -m reproduction good1 --quick`" in text and str(tmp_path) not in text
    stored = json.loads((out / "good1.json").read_text())
    assert stored["data"] == stdout["good1"] and stored["pictures"] == ["good1.png"]
    assert stored["versions"]["touchfield"] and stored["versions"]["numpy"] == np.__version__
    assert sorted(p.name for p in out.iterdir()) == ["good1.json", "good1.md", "good1.png"]


@pytest.mark.usefixtures("toys")
def test_all_reports_failed_experiments_and_runs_the_rest(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _exit_code(["all", "--out", str(tmp_path)]) == 2
    output = capsys.readouterr()
    assert (
        "bad1 is not made" in output.err
        and "touchfield[physics]" in output.err
        and output.err.count("\n") == 1
    )
    assert "good1.md" in output.out and "reproduction.md" in output.out
    text = (tmp_path / page.PAGE).read_text()
    assert "Body." in text and "Not made: the bodies: found that the library mujoco is not installed." in text
    anchors = re.findall(r"\]\(#([^)]+)\)", text)
    headings = [page.anchor(line.removeprefix("## ")) for line in text.splitlines() if line.startswith("## ")]
    assert anchors == headings[1:] and len(anchors) == 2, "the contents lead to every heading"
    for picture in re.findall(r"!\[[^]]+\]\(([^)]+)\)", text):
        assert (tmp_path / picture).is_file()
    assert not (tmp_path / "bad1.md").exists()


@pytest.mark.usefixtures("toys")
def test_no_result_at_all_is_one_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert _exit_code(["bad1", "--out", str(tmp_path)]) == 2
    assert capsys.readouterr().err.count("mujoco") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("toys")
@pytest.mark.parametrize("name", ["table9", "", "ALL", "good1.png"])
def test_an_unknown_name_lists_the_known_ones(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert _exit_code(["good1", name, "--out", str(out)]) == 2
    assert "good1, bad1, or all" in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.usefixtures("toys")
def test_invalid_folders_are_reported_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    a_file, depth = tmp_path / "file", tmp_path / "depth"
    a_file.write_text("kept")
    depth.mkdir()
    for arguments, code, message in (
        (["--out", str(a_file)], 2, "file"),
        (["--out", str(depth / "within"), "--depth", str(depth)], 2, "which is read"),
        (["--depth", str(tmp_path / "nowhere"), "--out", str(tmp_path / "o")], 1, "nothing there"),
        (["--depth", str(depth), "--out", str(tmp_path / "o")], 1, "no kind of source"),
    ):
        assert _exit_code(["good1", *arguments]) == code
        assert message in capsys.readouterr().err
    assert a_file.read_text() == "kept" and not list(depth.iterdir())
    assert not list(tmp_path.glob("o/*"))


@pytest.mark.parametrize("name", ["figure_2", "figure_3", "figure_8", "figure_9", "table_3"])
def test_a_missing_plot_library_is_reported_before_the_work(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    experiment = import_module(f"reproduction.{name}").EXPERIMENT
    for library in ("matplotlib", "matplotlib.figure"):  # an imported module is found by its full name
        monkeypatch.setitem(sys.modules, library, None)
    steps: list[int] = []
    with pytest.raises(MissingExtra, match=r"touchfield\[report\]"):
        experiment.run(Inputs(tmp_path, report=lambda done, total: steps.append(done)))
    assert not steps and not list(tmp_path.iterdir())


def test_a_source_that_is_no_depth_is_refused(tmp_path: Path) -> None:
    (tmp_path / "ball.toml").write_text(
        '[[shape]]\nkind = "sphere"\ncenter_m = [0.0, 0.0, 0.0]\nradius_m = 0.05\n'
    )
    with pytest.raises(SourceError, match="no depth sequence"):
        scenes.user_inputs((tmp_path / "ball.toml",))


def test_the_printed_command_names_folders_without_their_parents(tmp_path: Path) -> None:
    text = page.command(["table3"], [tmp_path / "a" / "tum", Path("b/icl/")], quick=True)
    assert text == "python -m reproduction table3 --depth tum --depth icl --quick"


def test_a_bar_in_a_cell_stays_in_its_cell() -> None:
    assert markdown_table(["a"], [["|F|"]]).splitlines()[2] == "| \\|F\\| |"


# -- the sequences -----------------------------------------------------------------------------------------


def test_a_moving_view_of_a_plane_is_exact() -> None:
    view = scenes.MovingView(Plane(1), 4)
    for i in range(4):
        exact, depth = plane_depth_m(view, view.poses[i]), view.depth_m(i)
        is_known = depth > 0
        assert is_known.mean() > 0.85
        np.testing.assert_allclose(depth[is_known], exact[is_known], rtol=2e-6)
        assert not is_known.all(), "the unknown pixels stay unknown"


def test_a_moving_view_invents_no_depth_at_edges() -> None:
    class Steps(Plane):
        def depth_m(self, frame: int) -> np.ndarray:
            depth = np.full((self.height, self.width), 2.0, np.float32)
            depth[:, 20:30] = 1.0
            return depth

    view_m = scenes.MovingView(Steps(1), 3).depth_m(2)
    nearest = np.abs(view_m[view_m > 0][:, None] - [1.0, 2.0]).min(axis=1)
    assert nearest.max() < 0.05 and {1, 2} == set(np.rint(view_m[view_m > 0]).astype(int))


def test_the_hand_moves_and_turns_evenly() -> None:
    poses = scenes.hand_held_poses(6)
    steps = np.linalg.inv(poses[:-1]) @ poses[1:]
    np.testing.assert_allclose(np.linalg.norm(steps[:, :3, 3], axis=1), 1.5e-3, rtol=1e-9)
    turns = np.degrees(np.arccos((np.trace(steps[:, :3, :3], axis1=1, axis2=2) - 1) / 2))
    np.testing.assert_allclose(turns, 0.3, rtol=1e-6)


@pytest.mark.parametrize("sigma_per_m", [1e-4, 3e-3])
def test_noise_is_found_and_added(sigma_per_m: float) -> None:
    found = scenes.inverse_depth_noise_per_m(Plane(1, noise_per_m=sigma_per_m).depth_m(0))
    assert found == pytest.approx(sigma_per_m, rel=0.1)
    pair = scenes.NoisyPair(Plane(1), sigma_per_m)
    is_known = pair.depth_m(0) > 0
    change = 1 / pair.depth_m(1)[is_known] - 1 / pair.depth_m(0)[is_known]
    assert change.std() == pytest.approx(np.sqrt(2) * sigma_per_m, rel=0.1)
    noiseless = scenes.NoisyPair(Plane(1), 0.0)
    np.testing.assert_array_equal(noiseless.depth_m(0), noiseless.depth_m(1))


def test_first_frames_are_the_first(tmp_path: Path) -> None:
    cut = scenes.DepthInput("plane", Plane(5)).first(2).sequence
    assert cut.frame_count == 2 and cut.poses is not None and len(cut.poses) == 2
    np.testing.assert_array_equal(cut.depth_m(1), Plane(5).depth_m(1))
    with pytest.raises(InvalidArgument, match="0 to 1"):
        cut.depth_m(2)


# -- the figures -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["figure_2", "figure_3", "figure_8", "figure_9", "table_3"])
def test_each_makes_its_page_and_pictures(name: str, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="the pictures are drawn with it")
    if name in ("figure_9", "table_3"):
        pytest.importorskip("skimage", reason="the depth map comes with scikit-image")
    experiment = import_module(f"reproduction.{name}").EXPERIMENT
    assert experiment.name == name.replace("figure_", "fig").replace("_", "") and name in frame.MODULES
    steps: list[tuple[int, int]] = []
    found = experiment.run(
        Inputs(tmp_path, report=lambda done, total: steps.append((done, total)), quick=True)
    )
    assert [done for done, _ in steps] == list(range(1, len(steps) + 1)), "progress goes up one by one"
    assert bool(steps) == (name in ("figure_9", "table_3")), "the others take a moment"
    assert not steps or steps[-1][0] == steps[-1][1], "and ends where it said it would"
    assert json.dumps(page.plain(found.data), allow_nan=False) and str(tmp_path) not in found.markdown
    assert {p.name for p in found.pictures} == set(re.findall(r"!\[[^]]+\]\(([^)]+)\)", found.markdown))
    for picture in found.pictures:
        with Image.open(picture) as image:
            assert min(image.size) > 300 and len(image.convert("RGB").getcolors(1 << 22)) > 50


def test_figure_8_counts_and_covers() -> None:
    figure_8 = import_module("reproduction.figure_8")
    assert figure_8.icosahedral_numbers(9) == [1, 3, 4, 7, 9], "Caspar and Klug's triangulation numbers"
    assert 258 not in [10 * t + 2 for t in figure_8.icosahedral_numbers(40)]
    codebook = figure_8.Codebook.get("ico3")
    polyhedron = import_module("reproduction.polyhedron_picture")
    assert polyhedron.face_angles_deg(codebook).max() == pytest.approx(codebook.covering_radius_deg)
    # the table of the theory: isotropic directions, with 2e6 draws
    assert figure_8.mean_square_chord_db(codebook, 50_000) == pytest.approx(-16.53, abs=0.06)
