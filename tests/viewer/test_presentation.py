"""Texts for the user: unescaped names, nothing truncated, notes with their quantity, file names of
pictures.
"""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.quiver import Quiver
from PIL import Image

from touchfield import pipeline, tasks
from touchfield.cli.main import _exit_code
from touchfield.cli.output import Answer, show_rows
from touchfield.cli.view import show_measurement
from touchfield.devices import devices
from touchfield.measure import Interval, Quantity, Spread, capacity
from touchfield.medium import ForceField, Grid
from touchfield.pipeline.spec import EncodeSpec
from touchfield.render.block import COLUMNS
from touchfield.sources.tiny_scenes import tiny_scenes
from touchfield.tasks.measure import Measurement, MeasureSpec
from touchfield.viewer import interaction, picture
from touchfield.viewer.information import Bar, draw_information
from touchfield.viewer.interaction import InteractionView, draw_interaction
from touchfield.viewer.page import lines_that_fit
from touchfield.viewer.picture import draw_comparison

Capture = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def measured() -> Measurement:
    return tasks.measure.measure_medium(
        tiny_scenes()[0], MeasureSpec(devices=("dotpad",), encode=EncodeSpec(nw=5))
    )


def _printed(found: Measurement, capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setenv("COLUMNS", "80")
    show_measurement(found, ("the picture is x.png",))
    return capsys.readouterr().out


def test_a_name_is_no_formula_in_the_pictures(tmp_path: Path, measured: Measurement) -> None:
    name = r"a$\foo$.touch"
    replace(measured, name=name).draw(tmp_path / "bits.png")
    draw_information(
        tmp_path / "names.png", name, "$\\foo$", [Bar(name, 2.0)], {name: measured.capacities["dotpad"]}
    )
    field = pipeline.prepare(tiny_scenes()[0], EncodeSpec(nw=4)).medium[0]
    draw_comparison(tmp_path / "fields.png", field, field, name, "x right, y up", (0.1, 0.02))
    for drawn in ("bits", "names", "fields"):
        with Image.open(tmp_path / f"{drawn}.png") as image:
            assert len(np.unique(np.asarray(image.convert("L")))) > 20


def test_long_titles_are_broken_into_lines() -> None:
    text = f"{'W' * 250}.touch: 1 frame of 32,768 voxels"
    lines = lines_that_fit(text, 9.5)
    assert len(lines) > 3 and max(map(len, lines)) < 90
    assert "".join(lines).replace(" ", "") == text.replace(" ", "")
    assert lines_that_fit("two\nlines", 7) == ["two", "lines"]


def test_bits_of_nothing_and_full_devices_are_drawn(tmp_path: Path) -> None:
    bars = [Bar("raw", 96.0), Bar("none", 0.0, (0.0, 1.0)), Bar("-0", -0.0), Bar("too low", -0.2)]
    full, none = (Quantity("H", bits, "bit/frame") for bits in (1e5, 0.0))
    devices = {
        "all": capacity(full, full, 1e6, ratio=Spread(Interval(0.9, 1.0, 0.95, "paired"), None)),
        "none": capacity(none, none, 1e6),
    }
    draw_information(tmp_path / "x.png", "x", "bit", bars, devices)
    draw_information(tmp_path / "y.png", "y", "bit", [Bar("none", 0.0)])
    with Image.open(tmp_path / "x.png") as image:
        assert image.width == 1045


def test_names_are_printed_as_they_are(
    measured: Measurement, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    named = replace(measured, name="sample:motorcycle:[red]", notes=(":smile: [bold]",))
    printed = _printed(named, capsys, monkeypatch)
    assert "sample:motorcycle:[red]" in printed and "note: :smile: [bold]" in printed
    Answer({":motorcycle:": "[red]:motorcycle:"}, ":motorcycle:", (":motorcycle:",)).show()
    show_rows([{"stage": ":motorcycle:"}], ":motorcycle:")
    assert capsys.readouterr().out.count(":motorcycle:") == 6


def test_nothing_is_truncated(capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    text = "kind=salt-pepper,seed=4,density=0.05,rms=0.1," * 3
    Answer({"filters": text}, "long").show()
    printed = capsys.readouterr().out
    assert text in "".join(printed.split()) and "\u2026" not in printed
    stages = [{"stage": f"multiresolution-{i}", "supported_voxels": 14942 + i} for i in range(6)]
    show_rows(stages, "stages")
    printed = capsys.readouterr().out
    assert max(map(len, printed.splitlines())) <= 80 and "\u2026" not in printed
    for i in range(6):
        assert printed.count(f"multiresolution-{i}") == 1 and printed.count(str(14942 + i)) == 1
    assert printed.count("supported_voxels") == 2, "the keys stand again beside further columns"


def test_devices_fit_a_terminal_a_line_each(capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert _exit_code(["devices"]) == 0
    printed = capsys.readouterr().out.splitlines()
    lines = printed[: [line.strip() for line in printed].index("drivers (play --device)")]
    assert len(lines) == len(devices()) + 3 and max(map(len, printed)) <= 80
    for profile, line in zip(devices(), lines[2:], strict=False):
        assert (
            line.startswith(profile.name)
            and "x".join(f"{x:.0f}" for x in profile.workspace_mm) in line.split()
        )
        unseen = [source for source in profile.sources.values() if source.startswith("unverified")]
        assert line.rstrip().endswith(f" {len(unseen)} of {len(profile.sources)}")


def test_names_are_listed_and_sizes_multiplied(capsys: Capture) -> None:
    Answer({"names": ["torso", "arm"], "shape": [3, 4, 5]}, "").show()
    printed = capsys.readouterr().out
    assert "torso, arm" in printed and "3 x 4 x 5" in printed


def test_zero_has_no_sign(capsys: Capture) -> None:
    Answer({"a": -0.0, "b": [-0.0, {"c": np.array([-0.0])}], "d": np.float64(-0.0)}, "").show(True)
    assert "-0" not in capsys.readouterr().out
    Answer({"a": -0.0, "b": (-0.0, 1.0)}, "zeros").show()
    assert "-0" not in capsys.readouterr().out
    Answer({"inner": {"notes": (1, 2)}}, "").show(True)
    assert json.loads(capsys.readouterr().out)["inner"]["notes"] == [1, 2]


def test_notes_name_their_quantity(
    measured: Measurement, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert measured.limits is not None
    diluted = [c.per_voxel.name for c in measured.limits.contexts]
    contexts = tuple(
        replace(c, informed=1, per_voxel=c.per_voxel.of(notes=(f"{c.per_voxel.name} is too low",)))
        for c in measured.limits.contexts
    )
    noted = replace(measured, limits=replace(measured.limits, contexts=contexts), notes=("1 mm is 2 mm",))
    printed = _printed(noted, capsys, monkeypatch)
    for name in diluted:
        assert f"{name}: " in printed
        row = next(line for line in printed.splitlines() if line.startswith(f"{name} "))
        assert "too few samples" in row
    notes = [line for line in printed.splitlines() if line.startswith("note: ")]
    assert notes[-2:] == ["note: 1 mm is 2 mm", "note: the picture is x.png"]
    assert notes[0] == f"note: {diluted[0]}: {diluted[0]} is too low"
    assert len(set(notes)) == len(notes)
    of = measured.capacities["dotpad"]
    with_notes = replace(of, rendered=of.rendered.of(notes=("few samples: 1",)))
    printed = _printed(replace(measured, capacities={"dotpad": with_notes}), capsys, monkeypatch)
    assert "note: dotpad, H(M(W)): few samples: 1" in printed


def test_no_interval_of_a_capacity_without_that_of_its_entropy(
    measured: Measurement, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    of = measured.capacities["dotpad"]
    bare = replace(of, rendered=of.rendered.of(interval=None))
    printed = _printed(replace(measured, capacities={"dotpad": bare}), capsys, monkeypatch)
    section = printed.split("capacity of devices")[1].split("energy")[0]
    rows = [line for line in section.splitlines() if line.startswith(("dotpad", "  WMR", "  HIL"))]
    assert len(rows) == 3 and not any(" to " in row for row in rows)


def test_unmeasured_energy_is_printed_without_nan(
    measured: Measurement, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert measured.passivity is not None
    unmeasured = replace(measured.passivity, relative_curl=math.nan, notes=("no curl: thin",))
    printed = _printed(replace(measured, passivity=unmeasured), capsys, monkeypatch)
    assert "nan" not in printed
    assert "no curl: thin" in next(line for line in printed.splitlines() if line.startswith("relative curl"))


def test_report_of_filters_on_a_narrow_page(
    tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    scene = tmp_path / "s.toml"
    scene.write_text('[[shape]]\nkind = "sphere"\ncenter_m = [0.0, 0.0, 0.0]\nradius_m = 0.05\n')
    arguments = ["filter", str(scene), str(tmp_path / "o.touch"), "--nw", "4", "--report"]
    arguments += ["--multiresolution", "1", "--texture", "salt-pepper:seed=4"]
    assert _exit_code(arguments) == 0
    printed = capsys.readouterr().out
    assert "\u2026" not in printed and "rms=0.1" in printed
    section = printed.split("before and after")[1]
    assert max(map(len, section.splitlines())) <= 60 and "multiresolution" in section


def test_slices_pass_through_the_greatest_force(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Many weak samples at one height, and fewer strong ones at another."""
    grid = Grid.over_box((0, 0, 0), (0.04, 0.02, 0.04), (80, 10, 80))
    dense = np.zeros((80, 10, 80, 3))
    dense[:, 2, :, 2] = 0.01
    dense[20:60, 7, 20:60, 2] = 2.0
    drawn: list = []
    monkeypatch.setattr(picture, "write_png", lambda figure, path: drawn.append(figure))
    field = ForceField.from_dense(grid, dense)
    draw_comparison(tmp_path / "x.png", field, field, "t\nc", "x right, y up", (0.1, 0.02))
    titles = [panel.get_title() for panel in drawn[0].axes]
    assert sum("slice at y = 15.0 mm" in title for title in titles) == 4
    arrows = [quiver for panel in drawn[0].axes for quiver in panel.findobj(Quiver)]
    cells = (
        int(39 * 0.5 // (22 / 30)) + 1
    )  # of 22 mm that are shown, for samples 0 to 39 of half a millimetre
    assert [len(quiver.U) for quiver in arrows] == [cells**2] * 2, "one in each cell of the panel"
    assert all((quiver.V > 0).all() and not quiver.U.any() for quiver in arrows)


def test_the_axes_are_millimetres_of_the_lattice_where_forces_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    grid = Grid.over_box((-0.02, 0, 0.1), (0.02, 0.02, 0.14), (20, 10, 20))
    dense = np.zeros((20, 10, 20, 3))
    dense[5:15, 2:7, 3:9, 2] = 1.0
    drawn: list = []
    monkeypatch.setattr(picture, "write_png", lambda figure, path: drawn.append(figure))
    field = ForceField.from_dense(grid, dense)
    draw_comparison(tmp_path / "x.png", field, field, "t\nc", "x right, y up", (0.1, 0.02))
    front, _, _, top = drawn[0].axes[:4]
    low, high = grid.box_m
    for panel in (front, top):
        assert panel.get_xlabel() == "x / mm"
        limits = sorted(panel.get_xlim())
        # the box of the forces, -10 to 10 mm, with at most a few samples around it
        assert (
            1e3 * low[0] - 1e-6 <= limits[0] <= -10 + 1e-6 and 10 - 1e-6 <= limits[1] <= 1e3 * high[0] + 1e-6
        )
    met_mm = front.images[0].get_array().compressed()
    np.testing.assert_allclose(met_mm, 117.0, err_msg="whoever has z towards the eye meets the highest first")
    assert top.get_ylabel() == "z / mm" and 100 - 1e-6 <= min(top.get_ylim()) <= 106 + 1e-6


@pytest.mark.parametrize("axes", ["x right, y up", "x right, y down, z forward"])
def test_an_axis_that_points_down_is_drawn_downwards(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, axes: str
) -> None:
    drawn: list = []
    monkeypatch.setattr(picture, "write_png", lambda figure, path: drawn.append(figure))
    dense = np.zeros((12, 12, 12, 3))
    dense[3:9, 3:9, 3:9, 2] = 1.0
    field = ForceField.from_dense(Grid.over_box((-0.02,) * 3, (0.02,) * 3, (12, 12, 12)), dense)
    draw_comparison(tmp_path / "x.png", field, field, "t\nc", axes, (0.1, 0.02))
    assert [panel.yaxis_inverted() for panel in drawn[0].axes[:2]] == ["down" in axes] * 2
    monkeypatch.setattr(interaction, "write_png", lambda figure, path: drawn.append(figure))
    draw_interaction(
        tmp_path / "x.png", InteractionView("t", "c", axes, np.zeros(0, COLUMNS), 1.0, None, field)
    )
    front = [panel for panel in drawn[1].axes if panel.get_ylabel() == "y, mm"]
    assert [panel.yaxis_inverted() for panel in front] == ["down" in axes]
