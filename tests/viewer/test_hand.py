"""The hand of the page, in node and in a browser: walls hold it, and a seek brings no step of the force."""

from __future__ import annotations

import base64
import gzip
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import NODE, ROOT, drive, needs_browser, step

import touchfield as tf
from touchfield.viewer.browser import empty_page

sys.path.insert(0, str(ROOT / "tests" / "integrations"))
from builders import make_plate, player_forces

pytestmark = pytest.mark.skipif(NODE is None, reason="there is no node here")

PEAK_N = 3.3
SLEW_N = PEAK_N / 0.005 * 1e-3  # a tick
ATOL_N = 1e-9
ABOVE, THROUGH = (0.004, 0.003, 0.006), (0.004, 0.003, -0.002)  # of a plate between -1 and 1 mm


class Rows:
    """What each tick rendered: forces [n, 3], N, proxy and device [n, 3], m, media time [n], s."""

    def __init__(self, rows: list[list[float]]) -> None:
        table = np.array(rows)
        self.force_n, self.proxy_m, self.device_m = table[:, 0:3], table[:, 3:6], table[:, 6:9]
        self.is_in_contact, self.ticks, self.media_s = table[:, 9], table[:, 10], table[:, 11]
        assert not table[:, 12].any()

    def max_step_n(self, start: int = 0) -> float:
        """The largest change of the force between two ticks."""
        return float(np.linalg.norm(np.diff(self.force_n[start:], axis=0), axis=1).max())


def run_hand(folder: Path, *steps: dict[str, Any]) -> Rows:
    packed = re.search(r'id="decoder">([^<]+)<', empty_page())
    assert packed is not None
    (folder / "page.wasm").write_bytes(gzip.decompress(base64.b64decode(packed[1])))
    (folder / "steps.json").write_text(json.dumps(steps, default=str))
    script, files = ROOT / "tests" / "viewer" / "hand.mjs", ("page.wasm", "steps.json", "rows.json")
    command = [str(NODE), str(script), *(str(folder / name) for name in files)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return Rows(json.loads((folder / "rows.json").read_text()))


@pytest.fixture(scope="module")
def plate(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_plate(tmp_path_factory.mktemp("plate") / "plate.touch")


@pytest.fixture(scope="module")
def rising(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A block whose force rises from 0.5 to 2.5 N in two seconds; its push is no wall."""
    force = np.zeros((41, 16, 16, 16, 3), np.float32)
    force[:, 4:12, 4:12, 4:12, 1] = np.linspace(0.5, 2.5, 41)[:, None, None, None]
    path = tmp_path_factory.mktemp("rising") / "rising.touch"
    grid = tf.Grid((16, 16, 16), (0.005,) * 3, (-0.0375,) * 3)
    tf.encode(tf.HapticMedium.from_array(force, grid, 20.0), path)
    return path


def moved(point: tuple[float, float, float], count: int, **options: Any) -> list[dict[str, Any]]:
    """Steps: the probe moves to a point, metres, and some ticks pass."""
    return [step("move", point=point, **options), step("tick", count=count)]


def test_thin_plate_holds_the_hand(plate: Path, tmp_path: Path) -> None:
    """The probe goes through the plate in one event; the bare force there is none, or pushes it on."""
    rows = run_hand(tmp_path, step("open", file=plate), *moved(ABOVE, 200), *moved(THROUGH, 400))
    assert not rows.force_n[:200].any() and (rows.force_n[300:, 2] > 0.5).all()
    assert (rows.proxy_m[1:, 2] > 0.0008).all() and rows.is_in_contact[300:].all()
    np.testing.assert_allclose(rows.device_m[-1], THROUGH, atol=1e-9)
    assert rows.max_step_n() <= SLEW_N + ATOL_N
    with tf.open_stream(plate) as stream:
        bare_n = stream.medium.sample_n(rows.device_m[300:], 0.0)
    assert bare_n[:, 2].max() <= 0


def test_forces_are_those_of_the_python_player(plate: Path, tmp_path: Path) -> None:
    steps = [*moved(ABOVE, 100), *moved(THROUGH, 100), *moved((0.01, 0.0, -0.001), 200)]
    rows = run_hand(tmp_path, step("open", file=plate), *steps)
    landed = int(np.argmax(rows.device_m.any(axis=1)))
    _, expected_n = player_forces(plate, rows.device_m[landed:], loop=True)
    assert landed < 5 and np.abs(rows.force_n).max() > 0.5
    atol_n = 1e-7  # the player's simulated hand adds up its time: positions differ in their last digits
    np.testing.assert_allclose(rows.force_n[landed:], expected_n, atol=atol_n, rtol=0)


def test_force_that_begins_with_a_jump_stops_the_hand(tmp_path: Path) -> None:
    """A moving body pushes with its surface damping from its first sample on: no point is at the level."""
    outside, inside = (0.0122, 0.0011, 0.0220), (0.01033, 0.00007, 0.02081)
    steps = [*moved(outside, 100), *moved(inside, 300)]
    rows = run_hand(tmp_path, step("open", file=ROOT / "conformance" / "v1" / "objects-touch.touch"), *steps)
    assert not rows.force_n[90].any() and rows.is_in_contact[-100:].all()
    pull_m = rows.proxy_m[-100:] - rows.device_m[-100:]
    assert ((rows.force_n[-100:] * pull_m).sum(axis=1) > 0.1 * np.linalg.norm(pull_m, axis=1)).all()


def test_lifted_hand_comes_down_in_front_of_the_wall(plate: Path, tmp_path: Path) -> None:
    """The hand is pressed from above, then lifted, put down below the plate, and pressed from there."""
    below = (0.004, 0.003, -0.0012)
    pressed = [*moved(ABOVE, 100), *moved(THROUGH, 300)]
    rows = run_hand(
        tmp_path, step("open", file=plate), *pressed, *moved((0.004, 0.003, 0.002), 400, **{"from": below})
    )
    assert (rows.force_n[300:400, 2] > 0.5).all() and (rows.force_n[600:, 2] < -0.5).all()
    assert (rows.proxy_m[600:, 2] < -0.0008).all()
    assert rows.max_step_n() <= SLEW_N + ATOL_N


def test_pressed_hand_stays_on_its_side_over_a_seek(tmp_path: Path) -> None:
    """A plate in two frames: after the seek the proxy is where it was, and not behind the plate."""
    force = np.zeros((21, 16, 16, 32, 3), np.float32)
    force[:, 2:14, 2:14, 15, 2], force[:, 2:14, 2:14, 16, 2] = -1.5, 1.5
    force[:, 2:14, 2:14, 14, 2], force[:, 2:14, 2:14, 17, 2] = -0.5, 0.5
    grid = tf.Grid((16, 16, 32), (0.002, 0.002, 0.001), (-0.015, -0.015, -0.0155))
    tf.encode(tf.HapticMedium.from_array(force, grid, 20.0), tmp_path / "plate.touch")
    steps = [*moved((0, 0, 0.006), 100), *moved((0, 0, -0.004), 200)]
    steps += [step("follow", time=0.7, speed=0), step("tick", count=200)]
    rows = run_hand(tmp_path, step("open", file=tmp_path / "plate.touch"), *steps)
    assert (rows.force_n[200:300, 2] > 0.3).all() and not rows.force_n[315:322].all()
    assert (rows.force_n[400:, 2] > 0.3).all() and (rows.proxy_m[400:, 2] > 0).all()


def test_seek_brings_no_step_of_the_force(rising: Path, tmp_path: Path) -> None:
    """The force goes to zero, and comes back as that of the new time."""
    steps = [*moved((0, 0, 0), 200), step("follow", time=1.6, speed=0), step("tick", count=200)]
    rows = run_hand(tmp_path, step("open", file=rising), *steps)
    size_n = rows.force_n[:, 1]
    assert size_n[199] == pytest.approx(0.5, abs=0.06) and size_n[-1] == pytest.approx(2.1, rel=0.1)
    assert np.abs(size_n[200:260]).min() == 0
    assert rows.max_step_n() < 0.15, "the two forces differ by 1.5 N"


def test_hand_follows_the_page_in_a_loop_and_pauses_with_it(rising: Path, tmp_path: Path) -> None:
    """The page plays three rounds, in steps of 16 ms, and pauses."""
    page_s = np.arange(0, 6.0, 0.016) % 2.0
    steps = [step("open", file=rising), *moved((0, 0, 0), 100)]
    for time_s in page_s:
        steps += [step("follow", time=float(time_s), speed=1), step("tick", count=16)]
    steps += [step("follow", time=float(page_s[-1] + 0.016), speed=0), step("tick", count=300)]
    rows = run_hand(tmp_path, *steps)
    period_s = 41 / 20
    lag_s = (
        rows.media_s[100 : 100 + 16 * len(page_s) : 16] - page_s + period_s / 2
    ) % period_s - period_s / 2
    assert np.abs(lag_s[20:]).max() < 0.06, "a frame of 50 ms at the end is the loop's, and not the page's"
    played_n = rows.force_n[300 : 100 + 16 * len(page_s), 1]
    assert played_n.min() > 0.4 and np.abs(np.diff(played_n)).max() < 0.1, "no gap where it begins again"
    assert played_n.max() > 2.3
    assert np.ptp(rows.media_s[-200:]) == 0 and np.ptp(rows.force_n[-100:, 1]) < 1e-6
    assert rows.force_n[-1, 1] > 0.4


def test_hand_rests_where_the_medium_passes_too_fast(rising: Path, tmp_path: Path) -> None:
    steps = [*moved((0, 0, 0), 200), step("follow", time=0.5, speed=100), step("tick", count=200)]
    rows = run_hand(tmp_path, step("open", file=rising), *steps)
    assert rows.force_n[199, 1] > 0.4 and not rows.force_n[-100:].any()


def test_another_file_takes_the_force_over(rising: Path, plate: Path, tmp_path: Path) -> None:
    steps = [*moved((0, 0, 0), 200), step("open", file=plate), *moved(ABOVE, 200, **{"from": ABOVE})]
    rows = run_hand(tmp_path, step("open", file=rising), *steps)
    assert rows.force_n[199, 1] > 0.4 and rows.force_n[200, 1] > 0.4 and not rows.force_n[-100:].any()
    assert rows.max_step_n() < 0.05


def test_ticks_are_caught_up_to_a_limit(plate: Path, tmp_path: Path) -> None:
    steps = [step("late", ms=7), step("tick", count=1), step("late", ms=70), step("tick", count=2)]
    rows = run_hand(tmp_path, step("open", file=plate), *moved(ABOVE, 10), *steps)
    assert rows.ticks.tolist() == [1] * 10 + [8, 20, 1]


@needs_browser
def test_thin_plate_holds_the_hand_of_the_page(page: str, tmp_path: Path) -> None:
    """Keys push the probe through a plate of 2 mm: the proxy stays in front of it, and the force points out.

    The bare force behind the plate is zero, and within its far half it points to the far side.
    """
    plate = make_plate(tmp_path / "plate.touch")
    out = [step("press", key="PageDown") for _ in range(4)]
    through = [action for _ in range(16) for action in (step("press", key="Shift+PageUp"), step("state"))]
    through = [step("press", key="PageUp") for _ in range(3)] + through
    result = drive(
        tmp_path, step("goto", url=page), step("open", file=plate),
        step("until", code="touchfield.state().hand?.hertz"), *out, step("state"), *through,
        step("wait", ms=300), step("state"), step("text", id="hand"), step("text", id="size"),
    )  # fmt: skip
    assert result.errors == []
    above, behind, ticks, shown = result.answers[7], *result.answers[-3:]
    assert above["hand"]["force"] == [0, 0, 0] and above["point"][2] > 0.003
    assert behind["point"][2] < -0.0015 and behind["field"][:3] == pytest.approx([0, 0, 0], abs=1e-3)
    assert behind["hand"]["proxy"][2] > 0.0008 and behind["hand"]["isInContact"]
    assert behind["force"][2] > 0.5 and float(shown) == pytest.approx(behind["force"][2], abs=0.01)
    pressed = [s for s in result.answers if isinstance(s, dict) and s["hand"] and s["hand"]["isInContact"]]
    assert len(pressed) > 3 and all(state["force"][2] > 0 for state in pressed)
    assert re.match(r"\d+ ticks a second", ticks) and behind["hand"]["hertz"] > 500
    way = np.linspace(above["point"], behind["point"], 300)  # as a hand goes: a jump would be owed
    positions_m = np.concatenate([[above["point"]] * 100, way, [behind["point"]] * 300])
    expected_n = player_forces(plate, positions_m)[1][-1]
    np.testing.assert_allclose(behind["force"][:3], expected_n, atol=0.02)


@needs_browser
def test_page_without_a_hand_shows_the_force_of_the_field(page: str, tmp_path: Path) -> None:
    """An array of actuators is not touched with a probe, and a difference is no force."""
    drives = np.zeros((1, 8, 8, 1, 3), np.float32)
    drives[:, 2:5, 2:5, :, 2] = 0.5
    medium = tf.HapticMedium.from_array(drives, tf.Grid((8, 8, 1), (0.01, 0.01, 0.01), (0, 0, 0)))
    vest = tmp_path / "vest.touch"
    tf.encode(medium, vest, tf.EncodeSpec(device="tshirt-32x32"))
    result = drive(
        tmp_path, step("goto", url=page), step("open", file=vest), step("wait", ms=300), step("state"),
        step("text", id="hand"),
    )  # fmt: skip
    assert result.answers[3]["hand"] is None and result.answers[3]["force"] == result.answers[3]["field"]
    assert result.answers[4].startswith("none, ")


@needs_browser
def test_player_of_the_page_reaches_the_hand(page: str, rising: Path, tmp_path: Path) -> None:
    """The hand is where the page is while it plays, after a pause, and after a seek."""
    opening = [step("goto", url=page), step("open", file=rising)]
    opening += [step("until", code="touchfield.state().hand?.hertz"), step("click", id="play")]
    looks = [action for _ in range(8) for action in (step("wait", ms=150), step("state"))]
    pause = [step("click", id="play"), step("wait", ms=500), step("state")]
    seek = [step("seek", time=1.6), step("wait", ms=500), step("state")]
    result = drive(tmp_path, *opening, step("wait", ms=500), *looks, *pause, *seek)
    assert result.errors == []
    playing, paused, after = result.answers[6:21:2], result.answers[23], result.answers[26]
    period_s = 41 / 20
    lags_s = [(s["hand"]["time"] - s["time"] + period_s / 2) % period_s - period_s / 2 for s in playing]
    assert all(state["playing"] for state in playing) and len({s["hand"]["time"] for s in playing}) > 4
    assert max(map(abs, lags_s)) < 0.6, "apart by the time of a drawing, on a busy machine too"
    assert paused["hand"]["time"] == pytest.approx(paused["time"], abs=0.02)
    assert after["hand"]["time"] == pytest.approx(1.6, abs=0.02)
    assert after["force"][:3] == pytest.approx(after["field"][:3], rel=0.1) and max(after["force"]) > 0.5
