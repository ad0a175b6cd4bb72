"""The page for people who do not see it, see it small or in the dark, or hold a pad or a Braille display."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import ROOT, WITHOUT_WEBGL, drive, needs_browser, step

import touchfield as tf
from touchfield.viewer.browser import empty_page

SOLID = ROOT / "conformance" / "v1" / "touch-solid.touch"
MOVING = ROOT / "conformance" / "v1" / "objects-touch.touch"
ODD = tf.codec.TouchSpec(k=1 / 70, f0_n=0.1 / 3)
"""An error bound of many digits."""

LOOKS = (ROOT / "tests" / "viewer" / "looks.js").read_text(encoding="utf-8")
BARS = np.array([[0x40, 0x80], [0x44, 0xA0], [0x46, 0xB0], [0x47, 0xB8]])
"""Dots of a bar of one to four dots, in the left and the right column of a cell."""


RESTS = step("until", code="(window.before ?? '') === (window.before = String(touchfield.state().point))")
"""Until the probe stays where it is."""


def _look(name: str) -> dict[str, Any]:
    """Call a function of looks.js."""
    return step("run", code=f"looks.{name}()")


def _spoken(key: str) -> list[dict[str, Any]]:
    """Press a key, and hear what is under the probe."""
    return [step("press", key=key), step("press", key="t"), step("text", id="spoken")]


@pytest.fixture(scope="module")
def pins(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A map of 60 x 40 pins with one highest pin, in column 40 and row 10."""
    x, y = np.meshgrid(np.arange(60), np.arange(40), indexing="ij")
    heights = np.clip(1 - np.hypot(x - 39, y - 30) / 60, 0, 1)
    drives = np.zeros((60, 40, 1, 3), np.float32)
    drives[..., 0, 2] = 3.3 * heights
    path = tmp_path_factory.mktemp("pins") / "pins.touch"
    grid = tf.Grid((60, 40, 1), (0.0025, 0.0025, 0.0026), (-0.07375, -0.04875, 0.0))
    medium = tf.HapticMedium.from_array(drives, grid, axes="x east, y north, z up")
    tf.encode(medium, path, tf.EncodeSpec(device="graphiti", touch=ODD))
    return path


def test_first_paint_is_that_of_a_page_that_loads() -> None:
    """Also of a page with a file, whose script comes after the markup."""
    markup = empty_page().split("<script", 1)[0]
    assert re.search(r'<div id="empty" hidden>', markup)
    assert re.search(r'<div id="loading" role="status">.*?<progress', markup, re.DOTALL)
    assert "<noscript>" in markup


@needs_browser
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_small_screen(pins: Path, tmp_path: Path, page: str, scheme: str) -> None:
    looks = [_look(name) for name in ("smallTargets", "overlaps", "contrasts", "texts", "width", "shown")]
    result = drive(
        tmp_path,
        step("goto", url=page),
        step("run", code=LOOKS),
        looks[-1],
        step("open", file=MOVING),
        *looks,
        step("open", file=pins),
        *looks,
        viewport={"width": 390, "height": 844},
        colorScheme=scheme,
    )
    assert result.errors == [] and result.answers[2] == [False, True]
    for small, overlaps, (ground, *contrasts), texts, width, shown in (
        result.answers[4:10],
        result.answers[11:17],
    ):
        assert small == [] and overlaps == [] and width == 390 and shown == [False, False]
        assert (ground < 0.1) == (scheme == "dark") and min(contrasts) >= 4.5
        assert not re.search(r"\d\.\d{6,}", texts), "a number as the machine has it"


@needs_browser
@pytest.mark.parametrize("flags", [(), WITHOUT_WEBGL])
def test_pins_speak_of_heights(pins: Path, page: str, tmp_path: Path, flags: tuple[str, ...]) -> None:
    result = drive(
        tmp_path,
        step("goto", url=page),
        step("open", file=pins),
        *_spoken("ArrowUp"),
        *_spoken("ArrowRight"),
        step("text", id="scale"),
        step("text", id="unit"),
        step("state"),
        step("text", id="size"),
        step("text", id="figures"),
        flags=flags,
    )
    assert result.errors == []
    up, right, scale, unit, state, size, figures = (result.answers[n] for n in (4, 7, 8, 9, 10, 11, 12))
    places = [[int(n) for n in re.findall(r"\d+", said)] for said in (up, right)]
    assert "newton" not in up and "rises up and right" in right and "rises" in up
    assert places[0][:2] != places[1][:2] and places[0][1] in (99, 100)
    assert places[1][2:] == [places[0][2] + 1, 60, places[0][4], 40], "one pin to the right"
    assert scale == "Height, percent" and unit == "% of the travel"
    share = np.linalg.norm(state["force"][:3]) / state["head"]["peak"]
    assert int(size) == pytest.approx(100 * share, abs=0.51) and places[1][0] == int(size)
    assert "of the travel" in figures and "largest force" not in figures


@needs_browser
def test_pad_moves_the_probe_and_rumbles_without_gaps(page: str, tmp_path: Path) -> None:
    result = drive(
        tmp_path,
        step("goto", url=page),
        step("run", code=LOOKS),
        _look("plugPad"),
        step("open", file=SOLID),
        step("press", key="j"),
        step("state"),
        step("run", code="pad.axes[0] = 0.1"),
        step("wait", ms=300),
        step("state"),
        step("click", id="rumble"),
        step("wait", ms=1500),
        step("run", code="pad.effects.splice(0)"),
        step("run", code="window.start = touchfield.state().point[0]; pad.axes[0] = 1"),
        step("until", code="touchfield.state().point[0] > start + 0.001"),
        step("run", code="pad.axes[0] = 0"),
        RESTS,
        step("state"),
        step("run", code="pad.buttons[3].pressed = true"),
        step("until", code="touchfield.state().point[0] === start"),
        RESTS,
        step("state"),
    )
    assert result.errors == []
    first, idle, effects, moved, back = (result.answers[n] for n in (5, 8, 11, 16, 20))
    assert idle["point"] == first["point"], "a stick has play around its middle"
    assert moved["point"][0] > first["point"][0] and moved["point"][1:] == pytest.approx(first["point"][1:])
    assert back["point"] == pytest.approx(first["point"]), "Y goes to the strongest force"
    assert len(effects) > 3
    ends = [effect["at"] + effect["duration"] for effect in effects]
    assert all(after["at"] < end for after, end in zip(effects[1:], ends, strict=False)), "no gap"
    for effect in effects:
        assert effect["kind"] == "trigger-rumble"
        assert min(effect["leftTrigger"], effect["rightTrigger"]) == 0 < effect["strongMagnitude"]
        assert max(effect["leftTrigger"], effect["rightTrigger"]) <= effect["strongMagnitude"]


@needs_browser
def test_braille_display_shows_a_line_of_heights(pins: Path, page: str, tmp_path: Path) -> None:
    """A report of 13 bytes: one of another usage, and twelve cells of eight dots."""
    result = drive(
        tmp_path,
        step("goto", url=page),
        step("run", code=LOOKS),
        _look("plugBraille"),
        step("open", file=pins),
        step("run", code="document.getElementById('braille').click()"),
        step("until", code="reports.length > 0"),
        step("press", key="ArrowUp"),
        step("text", id="saved"),
        step("state"),
        step("run", code="reports.at(-1)"),
        step("run", code="document.getElementById('braille').click()"),
        step("until", code="reports.at(-1)[1].every((byte) => byte === 0)"),
        step("run", code="document.getElementById('braille').getAttribute('aria-pressed')"),
    )
    assert result.errors == []
    report, state, (number, data) = result.answers[7:10]
    assert report == "Cells of twelve: 1 row of 12 cells." and number == 3
    assert len(data) == 13 and data[0] == 0 and result.answers[12] == "false"
    row = round((state["point"][1] + 0.04875) / 0.0025)
    columns = np.floor((np.arange(24) + 0.5) / 24 * 60 - 0.5 + 1e-9)  # between two pins the page interpolates
    levels = 4 * np.clip(1 - np.hypot(columns + 0.5 - 39, row - 30) / 60, 0, 1)
    sure = np.abs(levels % 1 - 0.5) > 0.1
    dots = np.array([bin(int(data[1 + n // 2]) & int(BARS[3, n % 2])).count("1") for n in range(24)])
    np.testing.assert_array_equal(dots[sure], np.round(levels[sure]).astype(int))
    assert sure.sum() > 12 and len(set(dots)) > 1
    for n in range(24):
        bar = int(data[1 + n // 2]) & int(BARS[3, n % 2])
        assert bar == (BARS[dots[n] - 1, n % 2] if dots[n] else 0), "dots from the lowest up"


@needs_browser
def test_marks_and_links_lead_back(page: str, tmp_path: Path) -> None:
    (tmp_path / "page.html").write_text(tf.view(MOVING).html, encoding="utf-8")
    url = (tmp_path / "page.html").as_uri()
    first = drive(
        tmp_path,
        step("goto", url=url),
        step("press", key="End"),
        step("press", key="n"),
        step("state"),
        step("press", key="Home"),
        step("press", key="ArrowRight"),
        step("press", key="ArrowRight"),
        step("state"),
        step("press", key="b"),
        step("wait", ms=300),
        step("state"),
        step("press", key="l"),
        step("run", code="location.hash"),
        step("press", key="b"),
        step("wait", ms=300),
        step("state"),
    )
    marked, other, back, again = (first.answers[n] for n in (3, 7, 10, 15))
    assert other["time"] == 0 < marked["time"] and other["point"] != marked["point"]
    for found, expected in ((back, marked), (again, other)):
        assert found["time"] == pytest.approx(expected["time"])
        np.testing.assert_allclose(found["point"], expected["point"], atol=1e-9)
    steps = [step("goto", url=url + first.answers[12]), step("wait", ms=500), step("state")]
    linked = drive(tmp_path, *steps).answers[2]
    assert linked["time"] == pytest.approx(marked["time"], abs=1e-4)
    np.testing.assert_allclose(linked["point"], marked["point"], atol=1e-5)
    assert first.errors == []
