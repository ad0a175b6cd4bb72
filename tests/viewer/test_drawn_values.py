"""Pictures draw the given values: lines, images, labels and limits, read from the figure."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import touchfield as tf
from touchfield.codec.touch.spec import TouchSpec
from touchfield.measure import Interval, Quantity, Spread, capacity
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.pipeline import encode, prepare
from touchfield.pipeline.spec import EncodeSpec
from touchfield.render.block import COLUMNS
from touchfield.tasks.measure import MeasureSpec, measure_medium
from touchfield.tasks.view import draw_medium, draw_preview
from touchfield.viewer import information, interaction, picture, plots
from touchfield.viewer.information import Bar, draw_information
from touchfield.viewer.interaction import InteractionView, draw_interaction
from touchfield.viewer.page import is_our_picture
from touchfield.viewer.picture import draw_comparison, shadow_n
from touchfield.viewer.plots import TextureCurve, draw_masked_signal, draw_textures

pytest.importorskip("matplotlib", reason="pictures need the extra report")

GRID = Grid((12, 10, 16), (0.002, 0.003, 0.001), (-0.01, 0.02, 0.005))
AXES = "x right, y up, z towards the viewer"
K, F0_N = 0.1, 0.05

Drawn = Callable[[Any], list[Any]]


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> Drawn:
    """The figures drawn by a module, instead of their files."""

    def of(module: Any) -> list[Any]:
        figures: list[Any] = []
        monkeypatch.setattr(module, "write_png", lambda figure, path: figures.append(figure))
        return figures

    return of


def block(seed: int = 0) -> np.ndarray:
    """Distinct forces in a block off the centre."""
    forces = np.zeros((*GRID.shape, 3), np.float32)
    forces[3:8, 2:9, 5:12] = np.random.default_rng(seed).uniform(0.3, 1.5, (5, 7, 7, 3))
    forces[3:8, 6, 5:12] *= 6  # in the plane of the slice
    return forces


def filled(image: Any) -> np.ndarray:
    return np.ma.filled(image.get_array().astype(float), np.nan)


def assert_shows(panel: Any, values: np.ndarray, is_drawn: np.ndarray) -> None:
    """The image of the panel has the values [across, up] where they are drawn, and nothing elsewhere."""
    np.testing.assert_allclose(filled(panel.images[0]), np.where(is_drawn, values, np.nan).T, rtol=1e-5)


# -- an interaction -----------------------------------------------------------------------------------------


def rows() -> np.ndarray:
    log, rng = np.zeros(40, COLUMNS), np.random.default_rng(1)
    log["time_s"] = 0.25 + np.arange(40) / 1000
    for name in ("position_m", "field_force_n", "friction_n", "force_n"):
        log[name] = rng.normal(0, 1, (40, 3))
    log["field_force_n"][:10] = log["field_force_n"][25:] = 0
    log["position_m"] *= 0.01
    return log


def test_an_interaction_is_drawn(drawn: Drawn) -> None:
    figures, log, field = drawn(interaction), rows(), ForceField.from_dense(GRID, block())
    size = {name: np.linalg.norm(log[name], axis=1) for name in ("field_force_n", "friction_n", "force_n")}
    top = size["force_n"].max()
    view = InteractionView("the title", "the caption", AXES, log, 1.9 * top, 0.5 * top, field)
    draw_interaction(Path("x.png"), view)
    (figure,) = figures
    assert figure.get_suptitle().split("\n") == ["the title", "the caption"]
    hand, force, parts, *_ = panels = [artist for artist in figure.axes if artist.get_label() != "<colorbar>"]
    for panel, values in ((hand, 1e3 * log["position_m"]), (parts, log["force_n"])):
        for line, component in zip(panel.lines, values.T, strict=True):
            np.testing.assert_array_equal(line.get_ydata(), component)
            np.testing.assert_array_equal(line.get_xdata(), log["time_s"])
    names = {"of the field": "field_force_n", "friction": "friction_n", "put out": "force_n"}
    assert [line.get_label() for line in force.lines[:3]] == list(names)
    for line in force.lines[:3]:
        np.testing.assert_array_equal(line.get_ydata(), size[names[line.get_label()]])
    assert [line.get_ydata()[0] for line in force.lines[3:]] == [1.9 * top, 0.5 * top]
    assert [artist.get_text() for artist in force.texts] == [
        f"peak {1.9 * top:g} N",
        f"continuous {0.5 * top:g} N",
    ]
    for panel in (hand, force, parts):
        np.testing.assert_allclose(panel.get_xlim(), (log["time_s"][0], log["time_s"][-1]))
        (tint,) = panel.collections
        corners = np.concatenate([path.vertices for path in tint.get_paths()])
        touched = log["time_s"][10:25]
        assert (corners[:, 0].min(), corners[:, 0].max()) == (touched[0], touched[-1])
    order = np.argsort(size["force_n"], kind="stable")
    for panel, up in zip(panels[3:], (1, 2), strict=True):
        (dots,) = panel.collections
        np.testing.assert_array_equal(dots.get_array(), size["force_n"][order])
        np.testing.assert_array_equal(dots.get_offsets(), 1e3 * log["position_m"][order][:, [0, up]])
        low, high = 1e3 * np.stack(GRID.box_m)
        np.testing.assert_allclose(panel.images[0].get_extent(), (low[0], high[0], low[up], high[up]))
        shadow = np.linalg.norm(block(), axis=-1).max(axis=3 - up)
        np.testing.assert_allclose(filled(panel.images[0]), shadow.T, rtol=1e-6)
        assert (panel.get_xlabel(), panel.get_ylabel()) == ("x, mm", f"{'xyz'[up]}, mm")
        path_mm, forces_mm = 1e3 * log["position_m"], 1e3 * field.grid.to_m(field.positions())
        seen_mm = np.concatenate([path_mm, forces_mm])[:, [0, up]]
        margin = 0.05 * np.ptp(seen_mm, axis=0).max()
        for limits, ends in zip((panel.get_xlim(), panel.get_ylim()), seen_mm.T, strict=True):
            assert sorted(limits) == pytest.approx([ends.min() - margin, ends.max() + margin])
    draw_interaction(Path("x.png"), InteractionView("t", "c", AXES, log, 2.1 * top, None))
    assert len(figures[1].axes[1].lines) == 3, "a limit far above takes no room"


@pytest.mark.parametrize(("across", "up"), [(0, 1), (1, 0), (0, 2), (2, 1)])
def test_a_shadow_is_the_greatest_force_along_the_third_axis(across: int, up: int) -> None:
    fields = [ForceField.from_dense(GRID, block(n)) for n in (1, 2)]
    sizes = np.maximum(*(np.linalg.norm(block(n), axis=-1) for n in (1, 2))).max(axis=3 - across - up)
    expected = sizes if across < up else sizes.T
    np.testing.assert_allclose(shadow_n(fields, across, up), expected, rtol=1e-6)


# -- a measurement ------------------------------------------------------------------------------------------


def test_bars_and_devices_are_drawn_with_their_numbers(drawn: Drawn) -> None:
    figures = drawn(information)
    bars = [Bar("raw", 96.0), Bar("H(S)", 2.5, (2.0, 3.25)), Bar("this file", 4.75, is_actual=True)]
    bits = Quantity("H", 1000.0, "bit/frame").of(interval=Interval(900.0, 1100.0, 0.95, "x"))
    ratio = Spread(Interval(0.2, 0.3, 0.95, "paired"), None)
    of_device = capacity(bits, bits.of(value=250.0), 400.0, ratio=ratio)
    nothing = Quantity("H", 0.0, "bit/frame")
    devices = {"one": of_device, "two": capacity(nothing, nothing, 400.0)}
    draw_information(Path("x.png"), "the title", "the unit", bars, devices)
    (figure,) = figures
    above, below = figure.axes
    assert figure.get_suptitle() == "the title" and above.get_xlabel() == "the unit"
    assert [artist.get_text() for artist in above.texts] == ["96", "2.5", "4.75"]
    points = [line for line in above.lines if line.get_marker() == "o"]
    assert [(line.get_xdata()[0], line.get_ydata()[0]) for line in points] == [(96.0, 0), (2.5, 1), (4.75, 2)]
    assert points[0].get_color() == points[1].get_color() != points[2].get_color()
    (spread,) = [line for line in above.lines if line.get_marker() != "o"]
    assert list(spread.get_xdata()) == [2.0, 3.25] and list(spread.get_ydata()) == [1, 1]
    assert [artist.get_text() for artist in above.get_yticklabels()] == ["raw", "H(S)", "this file"]
    assert above.get_ylim() == (2.5, -0.5) and below.get_xlim() == (0, 1)
    assert [artist.get_width() for artist in below.patches] == [1.0, of_device.wmr.value]
    text, none = (artist.get_text() for artist in below.texts)
    figures_of = of_device.capacity.value, of_device.wmr.value, of_device.hil.value
    assert text == "C = {:,.0f} bit/frame   WMR {:.3g}   HIL {:.5g}".format(*figures_of)
    assert of_device.wmr.value == 0.25 and of_device.hil.value == 0.75 and none == "no information to render"
    assert of_device.wmr.interval is not None
    assert list(below.lines[0].get_xdata()) == [of_device.wmr.interval.low, of_device.wmr.interval.high]


def test_the_bars_of_a_measurement_are_bits_of_a_supported_voxel(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[tuple[Any, ...]] = []
    module = import_module("touchfield.tasks.measure")
    monkeypatch.setattr(module, "draw_information", lambda *args: calls.append(args))
    medium = HapticMedium.from_array(np.stack([block(), np.roll(block(), 2, axis=0)]), GRID)
    out = tmp_path / "out.touch"
    encode(medium, out, EncodeSpec(touch=TouchSpec(effort="fast")))
    measured = measure_medium(out)
    measured.draw(tmp_path / "x.png")
    ((path, title, unit, bars, capacities),) = calls
    supported = measured.supported_voxels
    assert supported > 0 and measured.occupancy == supported / (2 * GRID.voxel_count)
    assert (path, unit, capacities) == (tmp_path / "x.png", "bits per supported voxel", {})
    assert title == (
        f"out.touch: 2 frames of {GRID.voxel_count:,} voxels, {measured.occupancy:.2%} with a force; "
        f"Q {measured.quantiser}, H(W) = {measured.per_frame.value:,.0f} bit/frame"
    )
    each = 2 * GRID.voxel_count / supported
    assert measured.limits is not None and measured.voxel.interval is not None
    limits = [c.per_voxel for c in measured.limits.contexts if c.per_voxel.value > 0 and not c.is_diluted]
    values = [96.0, measured.voxel.value * each, *(q.value * each for q in limits)]
    assert [bar.value for bar in bars] == pytest.approx([*values, 8 * out.stat().st_size / supported])
    low_high = measured.voxel.interval.low, measured.voxel.interval.high
    assert bars[1].interval == pytest.approx([each * end for end in low_high])
    assert [bar.is_actual for bar in bars] == [False] * (len(bars) - 1) + [True]
    measure_medium(medium[:1], MeasureSpec(limits=False)).draw(tmp_path / "x.png")
    _, title, _, bars, _ = calls[1]
    assert title.startswith("medium: 1 frame of") and [bar.label for bar in bars][1:] == [
        "H(S) over voxels: no neighbours"
    ]


# -- a comparison -------------------------------------------------------------------------------------------


def test_slices_of_a_comparison_show_the_forces_and_their_errors(drawn: Drawn) -> None:
    """The decoded force is rotated by 10 degrees about y and 20 % longer, and one sample is missing."""
    figures, source = drawn(picture), block()
    c, s = np.cos(np.radians(10)), np.sin(np.radians(10))
    decoded = 1.2 * source @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    decoded[4, 6, 7] = 0
    fields = [ForceField.from_dense(GRID, item.astype(np.float32)) for item in (source, decoded)]
    draw_comparison(Path("x.png"), *fields, "t", AXES, (K, F0_N))
    (figure,) = figures
    panels = [item for item in figure.axes if item.get_label() != "<colorbar>"]
    crop, cut = np.s_[2:9, 1:10, 4:13], 6 - 1  # one sample around the block
    sizes = [np.linalg.norm(item[crop], axis=-1) for item in (source, decoded)]
    error = np.linalg.norm((decoded - source)[crop], axis=-1) / np.maximum(F0_N, K * sizes[0])
    is_supported = (sizes[0] > 0) | (sizes[1] > 0)
    low = [1e3 * (GRID.origin_m[n] + (crop[n].start - 0.5) * GRID.spacing_m[n]) for n in range(3)]
    high = [low[n] + 1e3 * (crop[n].stop - crop[n].start) * GRID.spacing_m[n] for n in range(3)]
    worst = np.where(is_supported.any(axis=2), np.where(is_supported, error, 0).max(axis=2), np.nan)
    np.testing.assert_allclose(filled(panels[2].images[0]), worst.T, rtol=1e-5)
    for panel, size in zip(panels[3:5], sizes, strict=True):
        assert_shows(panel, size[:, cut], size[:, cut] > 0)
        np.testing.assert_allclose(panel.images[0].get_extent(), (low[0], high[0], low[2], high[2]))
        assert panel.images[0].get_clim() == pytest.approx((0, max(sizes[0].max(), sizes[1].max())))
    assert_shows(panels[5], error[:, cut], is_supported[:, cut])
    units = [item[crop][:, cut] / np.maximum(np.linalg.norm(item[crop][:, cut], axis=-1), 1e-9)[..., None]
             for item in (source, decoded)]  # fmt: skip
    angle = np.degrees(np.arccos(np.clip((units[0] * units[1]).sum(-1), -1, 1)))
    both = (sizes[0] > 0) & (sizes[1] > 0)
    np.testing.assert_allclose(
        filled(panels[8].images[0]), np.where(both[:, cut], angle, np.nan).T, rtol=1e-3, atol=1e-3
    )
    names = ["first contact"] * 2 + ["largest error"] + ["|F|"] * 2 + ["error, in"] + ["direction"] * 2
    names.append("direction error")
    for panel, title in zip(panels, names, strict=True):
        assert title in panel.get_title()
    for first, second in ((0, 1), (3, 4), (6, 7)):
        assert panels[first].get_title().startswith("source")
        assert panels[second].get_title().startswith("decoded")
    labels = [item.get_ylabel() for item in figure.axes if item.get_label() == "<colorbar>"]
    assert labels.count(f"|error| / max({F0_N:g} N, {K:g} |F|)") == 2 and "|F| / N" in labels


def test_each_actuator_of_an_array_is_drawn(drawn: Drawn) -> None:
    figures, grid = drawn(picture), Grid((5, 4, 1), (0.01, 0.02, 0.03), (0.1, 0.2, 0.0))
    forces = np.zeros((5, 4, 1, 3), np.float32)
    forces[..., 2] = 1 + np.arange(20).reshape(5, 4, 1)
    fields = [ForceField.from_dense(grid, item) for item in (forces, 1.5 * forces)]
    draw_comparison(Path("x.png"), *fields, "t", "x right, y down, z forward", (K, F0_N))
    panels = [item for item in figures[0].axes if item.get_label() != "<colorbar>"]
    titles = ["source |F|", "decoded |F|", "error, in units of the mask"]
    assert [panel.get_title() for panel in panels] == titles
    for panel, expected in zip(panels, (forces, 1.5 * forces, np.full_like(forces, 5.0)), strict=True):
        np.testing.assert_allclose(filled(panel.images[0]), expected[:, :, 0, 2].T, rtol=1e-5)
        np.testing.assert_allclose(panel.images[0].get_extent(), (95, 145, 190, 270))
        assert panel.yaxis_inverted()


# -- a field in its workspace -------------------------------------------------------------------------------


def test_a_preview_states_its_frame_and_position(drawn: Drawn) -> None:
    figures = drawn(import_module("touchfield.tasks.view"))
    medium = HapticMedium.from_array(np.stack([block(n) for n in range(6)]), GRID, 30.0, AXES)
    draw_preview(prepare(medium, EncodeSpec(device="omega.3")), Path("x.png"))
    (figure,) = figures
    title = " ".join(figure.get_suptitle().split())
    assert title.startswith("frames 1, 3, 6 of 6, in the workspace of omega.3 (dashed)")
    assert f"1 mm of the hand is 1 mm of the scene; the middle is the scene's (0, 0, 0) m; {AXES}" in title
    shadow = np.max([np.linalg.norm(block(n), axis=-1) for n in (0, 2, 5)], axis=0).max(axis=2)
    assert_shows(figure.axes[0], shadow, shadow > 0)
    low, high = 1e3 * np.stack(GRID.box_m)
    margin = 0.12 * (high - low).max()
    limits = low[0] - margin, high[0] + margin
    assert figure.axes[0].get_xlim() == pytest.approx(limits), "all of the workspace is shown"


def test_a_medium_is_drawn_cropped_to_its_forces(tmp_path: Path) -> None:
    frames = [ForceField.from_dense(GRID, np.roll(block(), shift, axis=0)) for shift in (0, 2)]
    figure = draw_medium(HapticMedium.from_frames(frames, 30.0, AXES))
    title = "frames 1, 2 of 2, cropped to the forces; edges of the lattice (dashed)"
    assert figure.get_suptitle().startswith(title) and GRID.description in figure.get_suptitle()
    low, high = 1e3 * np.stack(GRID.box_m)
    first, stop, step = np.array((3, 2, 5)), np.array((10, 9, 12)), 1e3 * np.array(GRID.spacing_m)
    margin = 0.05 * ((stop - first) * step).max()
    axes_of_panels = (0, 1, False), (2, 1, True), (0, 2, False)
    for panel, (across, up, is_inverted) in zip(figure.axes, axes_of_panels, strict=False):
        (box,) = panel.patches
        assert box.get_xy() == pytest.approx((low[across], low[up]))
        assert (box.get_width(), box.get_height()) == pytest.approx(((high - low)[across], (high - low)[up]))
        for axis, limits in ((across, panel.get_xlim()), (up, panel.get_ylim())):
            ends = low[axis] + np.array((first[axis], stop[axis])) * step[axis]
            assert sorted(limits) == pytest.approx([ends[0] - margin, ends[1] + margin])
        assert (panel.get_xlabel(), panel.get_ylabel()) == (f"{'xyz'[across]} / mm", f"{'xyz'[up]} / mm")
        assert panel.xaxis_inverted() == is_inverted and panel.yaxis_inverted() == (up == 2)
    tf.tasks.view.draw_medium(HapticMedium.from_frames([ForceField.empty(GRID)], 30.0), tmp_path / "x.png")
    assert is_our_picture(tmp_path / "x.png")


# -- curves -------------------------------------------------------------------------------------------------


def test_textures_are_millinewtons_over_the_threshold(drawn: Drawn) -> None:
    figures = drawn(plots)
    bands, threshold = (40.0, 80.0, 160.0), np.array([0.004, 0.002, 0.003])
    rows_n = {"oak": np.array([0.001, 0.0, 0.005]), "felt": np.array([0.1, 0.2, 0.3])}
    curves = [TextureCurve(name, 0.1, 1.0, levels_n) for name, levels_n in rows_n.items()]
    draw_textures(Path("x.png"), bands, curves, threshold)
    (axis,) = figures[0].axes
    for line, (name, levels_n) in zip(axis.lines, rows_n.items(), strict=True):
        assert line.get_label() == name and tuple(line.get_xdata()) == bands
        np.testing.assert_allclose(line.get_ydata(), 1e3 * np.where(levels_n > 0, levels_n, np.nan))
    (area,) = axis.collections
    corners = area.get_paths()[0].vertices
    for hertz, level in zip(bands, threshold, strict=True):
        assert corners[corners[:, 0] == hertz][:, 1].max() == pytest.approx(1e3 * level)
    assert corners[:, 1].min() == pytest.approx(0.2)


def test_a_legend_of_textures_names_colours_and_not_every_curve(drawn: Drawn) -> None:
    figures = drawn(plots)
    speeds_m_s, forces_n, bands = (0.05, 0.1, 0.2), (0.5, 1.0, 2.0), (40.0, 80.0)

    def legend(names: tuple[str, ...]) -> list[str]:
        curves = [
            TextureCurve(name, speed, force, np.full(2, speed))
            for name in names
            for speed in speeds_m_s
            for force in forces_n
        ]
        draw_textures(Path("x.png"), bands, curves, np.ones(2))
        (axis,) = figures[-1].axes
        assert len(axis.lines) == len(curves)
        widths = [line.get_linewidth() for line in axis.lines[:3]]
        assert widths == sorted(set(widths)), "greater forces are wider"
        return [text.get_text() for text in axis.get_legend().get_texts()]

    below = "below the threshold"
    draw_textures(Path("x.png"), bands, [], np.ones(2))
    assert not figures[-1].axes[0].lines, "materials of friction alone have no curve"
    assert legend(("oak",)) == ["50 mm/s", "100 mm/s", "200 mm/s", below]
    assert legend(("oak", "ice")) == ["oak", "ice", below]
    assert legend(tuple("abcdefghij")) == [*"abcdefgh", below]
    assert figures[-1].axes[0].get_legend().get_title().get_text() == "and 2 more"


def test_a_masked_signal_shows_readings_errors_and_violations(drawn: Drawn) -> None:
    figures = drawn(plots)
    t, x = np.arange(4) / 10, np.array([1.0, 2.0, 4.0, 3.0])
    readings = {"one": np.array([1.05, 2.5, 4.0, 3.3]), "two": x + 0.01}
    draw_masked_signal(Path("x.png"), t, x, readings, 0.1)
    axes = np.array(figures[0].axes).reshape(2, 2)
    for (name, q), (top, bottom) in zip(readings.items(), axes.T, strict=True):
        assert top.get_title() == name
        for line, values in zip((*top.lines, bottom.lines[0]), (x, q, abs(q - x)), strict=True):
            np.testing.assert_array_equal(line.get_xdata(), t)
            np.testing.assert_allclose(line.get_ydata(), values)
        is_violation = np.isfinite(bottom.lines[1].get_ydata())
        assert is_violation.tolist() == [False, name == "one", False, False]
        mask = bottom.collections[0].get_paths()[0].vertices
        assert mask[:, 1].max() == pytest.approx(0.4)
    assert axes[0, 0].get_ylabel() == "force / N" and axes[1, 0].get_ylabel() == "error / N"
