"""The page of a tactile map: places are found by keys alone, what is under the cursor is said, and zoom and
pan show the views of the file.
"""

from __future__ import annotations

import base64
import math
import re
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import ROOT, drive, needs_browser, step

import touchfield as tf
from map_makers import feature, town, write_geojson
from touchfield.cli.main import _exit_code
from touchfield.container import TouchReader
from touchfield.container.map_record import TactileMap, decode_view
from touchfield.container.writer import with_map
from touchfield.errors import InvalidArgument
from touchfield.maps.symbols import symbols
from touchfield.tasks.map import MapSpec, make_map
from touchfield.viewer.browser import empty_map_page

LOOKS = (ROOT / "tests" / "viewer" / "looks.js").read_text(encoding="utf-8")
STATE = "touchfield.state()"
COMPASS = ("east", "north-east", "north", "north-west", "west", "south-west", "south", "south-east")


@pytest.fixture(scope="module")
def town_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A map of a town in three zoom levels, with a station in the north west."""
    folder = tmp_path_factory.mktemp("town")
    station = feature("Point", [0.00015, 0.00095], railway="station", name="Main Station")
    source = write_geojson(folder / "town.geojson", *town(), station)
    make_map(source, folder / "town.touch", MapSpec(has_labels=False, zooms=3))
    return folder / "town.touch"


@pytest.fixture(scope="module")
def record(town_file: Path) -> TactileMap:
    with TouchReader(town_file) as reader:
        value = reader.read_map()
    assert value is not None and len(value.levels) == 3
    return value


@pytest.fixture(scope="module")
def url(town_file: Path) -> str:
    return tf.view(town_file).save(town_file.with_name("town.html")).as_uri()


def said(count: int) -> dict[str, Any]:
    """Wait until a number of sentences was said since the page was opened."""
    return step("until", code=f"{STATE}.sentences.length >= {count}")


def clicked(button: str) -> dict[str, Any]:
    """Click a button without waiting for a frame to be drawn, which a busy machine may not do for long."""
    return step("run", code=f"document.getElementById('{button}').click()")


def state() -> dict[str, Any]:
    return step("run", code=STATE)


def box_of(record: TactileMap, name: str) -> tuple[float, ...]:
    return next(place.box for place in record.places if record.names[place.name].text == name)


def way(start: list[float], stop: list[float]) -> str:
    """Distance in two digits and one of eight directions."""
    dx, dy = stop[0] - start[0], stop[1] - start[1]
    return (
        f"{float(f'{math.hypot(dx, dy):.2g}'):g} m {COMPASS[round(math.atan2(dy, dx) / (math.pi / 4)) % 8]}"
    )


def below(record: TactileMap, level: int, point: list[float]) -> str:
    """What the page says of a point of a level of one view."""
    own = record.levels[level]
    view = decode_view(record, 0, "town")
    row = round((own.north - point[1]) / own.pin_step)
    column = round((point[0] - own.west) / own.pin_step)
    owner = view.owner[row, column]
    if owner < 0:
        return "nothing here"
    symbol = view.symbols[owner]
    title = symbols()[record.kinds[symbol.kind].name].titled("en")
    return ", ".join([*(record.names[name].text for name in symbol.names), title])


# -- the browser -----------------------------------------------------------------------------------------


@needs_browser
def test_a_place_is_found_by_keys_alone(url: str, record: TactileMap, tmp_path: Path) -> None:
    keys = ["/", *"main st"]
    result = drive(
        tmp_path,
        step("goto", url=url),
        state(),
        *[step("press", key=key) for key in keys],
        step("until", code=f"{STATE}.sentences.at(-1)?.includes('Main Station')"),
        step("press", key="Enter"),
        step("until", code=f"{STATE}.sentences.at(-1).startsWith('Main Station, stop')"),
        state(),
        step("text", id="spoken"),
        step("run", code="document.activeElement.id"),
    )
    assert result.errors == [] and result.requests == [url]
    before, after, spoken, focused = result.answers[1], *result.answers[-3:]
    assert after["met"] == {"names": ["Main Station"], "kind": "stop", "role": "point"}
    assert spoken == f"Main Station, stop, {way(before['cursor'], after['cursor'])}"
    west, south, east, north = box_of(record, "Main Station")
    distance = math.dist(after["cursor"], ((west + east) / 2, (south + north) / 2))
    assert distance <= 6 * record.levels[after["level"]].pin_step, "a symbol stands near its place"
    assert focused == "view", "arrow keys go on from there"


@needs_browser
def test_the_page_guides_and_lists_places(url: str, tmp_path: Path) -> None:
    """From the place that was found three pins away, and back; then by the list of all places."""
    result = drive(
        tmp_path,
        step("goto", url=url),
        step("press", key="g"),
        step("text", id="spoken"),
        *[step("press", key=key) for key in ("/", *"mian")],
        step("until", code=f"{STATE}.sentences.at(-1)?.startsWith('nothing of that name')"),
        step("text", id="spoken"),
        *[step("press", key=key) for key in ("Escape", "/", *"station", "Enter")],
        step("until", code=f"{STATE}.met?.names[0] === 'Main Station'"),
        *[step("press", key="ArrowDown") for _ in range(5)],
        step("press", key="g"),
        step("until", code=f"{STATE}.isGuiding"),
        state(),
        step("press", key="ArrowRight"),
        step("until", code=f"{STATE}.sentences.at(-1).endsWith(': Main Station')"),
        state(),
        step("press", key="ArrowLeft"),
        *[step("press", key="ArrowUp") for _ in range(5)],
        step("until", code=f"!{STATE}.isGuiding"),
        step("run", code=f"{STATE}.sentences.find((found) => found.includes('arrived'))"),
        *[step("press", key=key) for key in ("l", "Tab", "Enter", "Tab", "Enter")],
        step("until", code=f"{STATE}.met?.names[0] === 'High Street'"),
        step("text", id="spoken"),
    )
    assert result.errors == []
    texts = [answer for answer in result.answers if isinstance(answer, str)]
    assert texts[0].startswith("No place was found yet")
    assert "similar: Main Station, stop" in texts[1]
    start, moved = (answer for answer in result.answers if isinstance(answer, dict))
    target = moved["sentences"][-1]
    assert re.fullmatch(r"nothing here\. [\d.]+ m north(-west)?: Main Station", target), target
    assert moved["cursor"][0] > start["cursor"][0] and moved["cursor"][1] == start["cursor"][1]
    assert texts[2].endswith("arrived: Main Station, stop")
    assert texts[3].startswith("High Street, road, ")


@needs_browser
def test_arrow_keys_say_what_is_under_the_cursor(url: str, record: TactileMap, tmp_path: Path) -> None:
    keys = ["ArrowUp"] * 4 + ["ArrowRight"] * 10
    steps = []
    for n, key in enumerate(keys):
        steps += [step("press", key=key), said(n + 1), state()]
    leaps = [step("press", key="Control+ArrowDown"), said(len(keys) + 1), state()]
    last = [step("press", key="Control+ArrowLeft"), said(len(keys) + 2), state()]
    result = drive(tmp_path, step("goto", url=url), state(), *steps, *leaps, *last)
    assert result.errors == []
    states = [answer for answer in result.answers if isinstance(answer, dict)]
    step_m = record.levels[0].pin_step
    for n, (before, after) in enumerate(zip(states, states[1 : len(keys) + 1])):
        move = np.subtract(after["cursor"], before["cursor"]) / step_m
        np.testing.assert_allclose(move, (0, 1) if n < 4 else (1, 0), atol=1e-6)
        assert after["sentences"][-1] == below(record, 0, after["cursor"])
    heard = {after["sentences"][-1] for after in states[1:]}
    assert {"nothing here", "High Street, road"} <= heard
    for after in states[-2:]:
        assert after["sentences"][-1] == below(record, 0, after["cursor"]) != "nothing here"


def middle(record: TactileMap, level: int, view: list[int]) -> list[float]:
    own = record.levels[level]
    column = view[1] * own.pan_columns + (record.columns - 1) / 2
    row = view[0] * own.pan_rows + (record.rows - 1) / 2
    return [own.west + column * own.pin_step, own.north - row * own.pin_step]


@needs_browser
@pytest.mark.parametrize("size", [(1280, 800), (390, 844)])
def test_zoom_and_pan_show_the_views(
    url: str, record: TactileMap, tmp_path: Path, size: tuple[int, int]
) -> None:
    keys = ["+", "Shift+ArrowRight", "Shift+ArrowUp", "Shift+ArrowUp", "+", "-", "-", "+"]
    steps = []
    for n, key in enumerate(keys):
        steps += [step("press", key=key), said(n + 1), state()]
    buttons = [clicked("left"), said(9), state(), clicked("whole"), said(10), state()]
    viewport = {"width": size[0], "height": size[1]}
    result = drive(tmp_path, step("goto", url=url), state(), *steps, *buttons, viewport=viewport)
    assert result.errors == []
    states = [answer for answer in result.answers if isinstance(answer, dict)]
    assert [found["level"] for found in states] == [0, 1, 1, 1, 1, 2, 1, 0, 1, 1, 0]
    for found in states:
        np.testing.assert_allclose(found["centre"], middle(record, found["level"], found["view"]), atol=1e-6)
        own = record.levels[found["level"]]
        pins = (
            (own.north - found["cursor"][1]) / own.pin_step,
            (found["cursor"][0] - own.west) / own.pin_step,
        )
        pans, sides = (own.pan_rows, own.pan_columns), (record.rows, record.columns)
        for pin, view, pan, side in zip(pins, found["view"], pans, sides):
            assert view * pan - 1e-6 <= pin <= view * pan + side - 1 + 1e-6, "the cursor is in the view"
    zoomed, right, up, edge = (found["view"] for found in states[1:5])
    assert [right, up] == [[zoomed[0], zoomed[1] + 1], [zoomed[0] - 1, zoomed[1] + 1]]
    assert edge == up and states[4]["sentences"][-1].startswith("edge of the map")
    assert "zoom 2 of 3" in states[1]["sentences"][-1] and "the whole map" in states[-1]["sentences"][-1]
    scales = [found["scale"] for found in states[:2]]
    assert scales[0] / scales[1] == pytest.approx(record.levels[0].pin_step / record.levels[1].pin_step)


@needs_browser
def test_mouse_and_fingers(url: str, record: TactileMap, tmp_path: Path) -> None:
    """A mouse says what it meets and drags; a finger speaks and vibrates, two fingers zoom."""
    spy = """window.spoken = []; window.pulses = [];
      speechSynthesis.speak = (utterance) => spoken.push([utterance.text, utterance.lang]);
      navigator.vibrate = (pattern) => pulses.push(pattern);"""
    where = (
        "(() => { const b = document.getElementById('view').getBoundingClientRect(); return [b.x, b.y]; })()"
    )
    station = step(
        "run",
        code="""(() => { const s = touchfield.state(); const v = document.getElementById('view');
          return [v.clientWidth / 2, v.clientHeight / 2, s.scale, ...s.centre]; })()""",
    )
    first = drive(tmp_path, step("goto", url=url), station, step("run", code=where), hasTouch=True)
    (half_x, half_y, scale, x, y), (left, top) = first.answers[1], first.answers[2]
    west, _, east, north = box_of(record, "High Street")
    street = [left + half_x + ((west + 3 * east) / 4 - x) / scale, top + half_y - (north - y) / scale]
    centre = [left + half_x, top + half_y]
    result = drive(
        tmp_path,
        step("goto", url=url),
        step("run", code=spy),
        clicked("vibration"),
        step("move", x=street[0], y=street[1]),
        step("until", code=f"{STATE}.met?.names[0] === 'High Street'"),
        step("press", key="+"),
        step("until", code=f"{STATE}.level === 1"),
        state(),
        step("drag", **{"from": centre, "to": [centre[0] + 60, centre[1]]}),
        state(),
        step("press", key="Home"),
        step("touch", type="touchStart", points=[centre]),
        step("touch", type="touchMove", points=[street]),
        step("until", code="spoken.some(([text]) => text.startsWith('High Street'))"),
        step("run", code="[spoken, pulses]"),
        step("touch", type="touchEnd", points=[]),
        step("touch", type="touchStart", points=[[centre[0] - 40, centre[1]], [centre[0] + 40, centre[1]]]),
        step("touch", type="touchMove", points=[[centre[0] - 90, centre[1]], [centre[0] + 90, centre[1]]]),
        step("touch", type="touchEnd", points=[]),
        step("until", code=f"{STATE}.level > 0"),
        state(),
        hasTouch=True,
    )
    assert result.errors == []
    zoomed, dragged, pinched = (answer for answer in result.answers if isinstance(answer, dict))
    spoken, pulses = next(answer for answer in result.answers if isinstance(answer, list))
    assert dragged["centre"][0] == pytest.approx(zoomed["centre"][0] - 60 * zoomed["scale"], rel=1e-6)
    assert ["Speech on", "en"] in spoken, "a finger that reaches the page has no screen reader"
    assert any(isinstance(pulse, list) for pulse in pulses), "each class that is met is felt"
    assert pinched["scale"] == pytest.approx(scale * 80 / 180, rel=0.02)


@needs_browser
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_small_screen(url: str, tmp_path: Path, scheme: str) -> None:
    looks = [step("run", code=f"looks.{name}()") for name in ("smallTargets", "contrasts", "texts", "width")]
    result = drive(
        tmp_path,
        step("goto", url=url),
        step("run", code=LOOKS),
        *looks,
        clicked("other"),
        step("text", id="list-title"),
        step("run", code="[...document.querySelectorAll('[aria-label]')].map((e) => e.ariaLabel).join()"),
        step("press", key="t"),
        step("text", id="spoken"),
        viewport={"width": 390, "height": 844},
        colorScheme=scheme,
        reducedMotion="reduce",
    )
    assert result.errors == []
    small, (ground, *contrasts), texts, width, _, title, labels, _, german = result.answers[2:11]
    assert small == [] and width == 390 and min(contrasts) >= 4.5
    assert (ground < 0.1) == (scheme == "dark")
    assert not re.search(r"\d\.\d{6,}|undefined|NaN", texts)
    assert title == "Alle Orte" and "Ganze Karte" not in labels and "Karte nach Westen" in labels
    assert re.search(r"Stufe 1 von 3, \d+ m breit; nächster Ort", german), german


@needs_browser
def test_files_without_a_map_and_damaged_ones(town_file: Path, record: TactileMap, tmp_path: Path) -> None:
    """Each gets one sentence, and a good file afterwards is shown."""
    page = tmp_path / "empty.html"
    page.write_text(empty_map_page(), encoding="utf-8")
    data = town_file.read_bytes()
    (tmp_path / "cut.touch").write_bytes(data[: len(data) // 2])
    (tmp_path / "text.touch").write_text("no map")
    frame = (ROOT / "conformance" / "v1" / "touch-mask.touch").read_bytes()
    bomb = zlib.compress(bytes(1 << 22), 9)
    (tmp_path / "bomb.touch").write_bytes(with_map(frame, replace(record, views=(bomb, *record.views[1:]))))
    names = ("text", "cut", "bomb")
    opened = [step for name in names for step in (_opened(tmp_path / f"{name}.touch"), _fault())]
    opened += [_opened(ROOT / "conformance" / "v1" / "touch-mask.touch"), _fault()]
    result = drive(
        tmp_path,
        step("goto", url=page.as_uri()),
        step("run", code="document.getElementById('empty').checkVisibility()"),
        *opened,
        _opened(town_file),
        step("run", code=f"[{STATE}.state, document.getElementById('fault').checkVisibility()]"),
    )
    assert result.errors == []
    text, cut, bomb_text, without = (result.answers[n] for n in (3, 5, 7, 9))
    assert result.answers[1] and result.answers[-1] == ["ready", False]
    assert text.startswith("text.touch: it is no .touch file")
    assert re.search(r"damaged or cut short.*\(byte \d+\)", cut)
    assert "a view that is too long" in bomb_text
    assert without.startswith("touch-mask.touch: it has no map")


def _opened(path: Path) -> dict[str, Any]:
    return step("open", file=path)


def _fault() -> dict[str, Any]:
    return step("text", id="fault")


@needs_browser
def test_changed_bytes_are_a_fault_or_a_map(town_file: Path, record: TactileMap, tmp_path: Path) -> None:
    """Records whose CRC-32 matches and whose payload was changed at random."""
    page = tmp_path / "empty.html"
    page.write_text(empty_map_page(), encoding="utf-8")
    data, tag = town_file.read_bytes(), b"TMAP"
    at = data.index(tag)
    length = int.from_bytes(data[at + 8 : at + 16], "little")
    rng, end = np.random.default_rng(5), at + 16 + length
    changes = []
    for place, value in zip(
        rng.integers(at + 16, at + 16 + min(length, 900), 120), rng.integers(0, 256, 120)
    ):
        changed = bytearray(data)
        changed[place] = value
        changes.append([int(place), int(value), zlib.crc32(changed[at:end])])
    code = f"""(async () => {{
      const given = Uint8Array.from(atob("{base64.b64encode(data).decode()}"), (c) => c.charCodeAt(0));
      const states = [];
      for (const [place, value, crc] of {changes}) {{
        const changed = given.slice();
        changed[place] = value;
        new DataView(changed.buffer).setUint32({end}, crc, true);
        await touchfield.open(changed, "changed.touch");
        const {{ state }} = document.documentElement.dataset;
        states.push(state + ":" + document.getElementById("fault").textContent);
      }}
      return states;
    }})()"""
    result = drive(tmp_path, step("goto", url=page.as_uri()), step("run", code=code))
    assert result.errors == []
    states = result.answers[1]
    assert len(states) == 120 and all(re.match("ready:|fault:changed.touch: ", found) for found in states)
    assert sum(found.startswith("fault") for found in states) > 10
    faults = {found for found in states if found.startswith("fault")}
    assert all("the map in it is damaged" in found or "version" in found for found in faults), faults


# -- without a browser -----------------------------------------------------------------------------------


def test_view_takes_the_page_of_maps(
    town_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shown = tf.view(town_file)
    assert "data-text=" in shown.html and base64.b64encode(town_file.read_bytes()).decode() in shown.html
    assert shown.figures["zoom_levels"] == 3 and shown.figures["named_features"] > 4
    out = tmp_path / "page.html"
    assert _exit_code(["view", str(town_file), "--page", "field", "--out", str(out), "--no-open"]) == 0
    assert 'id="decoder"' in out.read_text(encoding="utf-8")
    assert _exit_code(["view", str(town_file), "--device", "graphiti", "--out", str(out), "--no-open"]) == 0
    assert 'id="decoder"' in out.read_text(encoding="utf-8"), "figures are on the page of the field"
    assert _exit_code(["export", str(town_file), str(out)]) == 0
    assert out.read_text(encoding="utf-8") == shown.html
    capsys.readouterr()
    plain = ROOT / "conformance" / "v1" / "touch-mask.touch"
    assert (
        _exit_code(["view", str(plain), "--page", "map", "--out", str(tmp_path / "no.html"), "--no-open"])
        == 2
    )
    assert "a file without a map" in capsys.readouterr().err and not (tmp_path / "no.html").exists()
    assert _exit_code(["view", str(plain), "--page", "maps", "--out", str(out), "--no-open"]) == 2
    for arguments in ({"against": plain}, {"devices": ("graphiti",)}):
        with pytest.raises(InvalidArgument, match="neither"):
            tf.view(town_file, page="map", **arguments)  # type: ignore[arg-type]


def test_a_damaged_map_leaves_the_frame(town_file: Path, tmp_path: Path) -> None:
    """The page of the field, with a note; a request for the map is refused."""
    data = town_file.read_bytes()
    at = data.index(b"TMAP")
    length = int.from_bytes(data[at + 8 : at + 16], "little")
    changed = bytearray(data)
    changed[at + 16] = 2  # a later version
    end = at + 16 + length
    changed[end : end + 4] = zlib.crc32(changed[at:end]).to_bytes(4, "little")
    path = tmp_path / "later.touch"
    path.write_bytes(changed)
    shown = tf.view(path)
    assert 'id="decoder"' in shown.html and "version" in shown.figures["map_notes"][0]
    with pytest.raises(InvalidArgument, match="version"):
        tf.view(path, page="map")


def test_classes_are_those_of_the_symbols() -> None:
    source = (ROOT / "web" / "src" / "map_classes.ts").read_text(encoding="utf-8")
    table = source[source.index("CLASSES") : source.index("};")]
    found = re.findall(r'^  (\w+): \{ en: "([^"]+)", de: "([^"]+)"', table, re.MULTILINE)
    assert {name: (en, de) for name, en, de in found} == {
        name: (symbol.titled("en"), symbol.titled("de")) for name, symbol in symbols().items()
    }


def test_colours_of_classes_are_seen() -> None:
    """At least 3 to 1 on the sheet, in light and in dark, as WCAG asks of graphics."""
    source = (ROOT / "web" / "src" / "map_classes.ts").read_text(encoding="utf-8")
    style = (ROOT / "web" / "map.css").read_text(encoding="utf-8")
    sheets = re.findall(r"--sheet: (#\w{6});", style)
    pairs = re.findall(r'colours: \["(#\w{6})", "(#\w{6})"\]', source)
    assert len(pairs) == len(symbols()) + 2 and len(sheets) == 3
    for light, dark in pairs:
        assert contrast(light, sheets[0]) >= 3 and contrast(dark, sheets[1]) >= 3
        assert contrast(light if sheets[2] > "#8" else dark, sheets[2]) >= 3


def contrast(a: str, b: str) -> float:
    """Contrast of two colours by WCAG 2."""
    high, low = sorted((luminance(a), luminance(b)), reverse=True)
    return (high + 0.05) / (low + 0.05)


def luminance(colour: str) -> float:
    parts = [int(colour[n : n + 2], 16) / 255 for n in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
    return float(np.dot(linear, (0.2126, 0.7152, 0.0722)))
