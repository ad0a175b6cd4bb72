"""The page in a real browser: opened, played, dragged and probed, with the forces given by Python."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import ROOT, drive, hour_played, needs_browser, step

import touchfield as tf
from touchfield.cli.main import app, run as run_cli
from touchfield.perception.vibrotactile import BANDS_HZ
from touchfield.render.material import Material
from touchfield.tasks.texture import store_materials

pytestmark = needs_browser

CONFORMANCE = ROOT / "conformance"
ALIKE_N = 1e-5
FAULTY: dict[str, str] = json.loads((CONFORMANCE / "faulty" / "errors.json").read_text())
KINDS = {"ForeignFile": "foreign file", "TruncatedFile": "cut short", "CorruptFile": "corrupt",
         "UnsupportedVersion": "another version"}  # fmt: skip
MOVING = CONFORMANCE / "v1" / "objects-touch.touch"
SOLID = CONFORMANCE / "v1" / "touch-solid.touch"


def is_paper(stream: Path) -> bool:
    """Whether a file needs the paper's coder, which the page does not support."""
    return b"\x05\x00paper" in stream.read_bytes()


GOLDEN = [s for s in sorted((CONFORMANCE / "v1").glob("*.touch")) if not is_paper(s)]


def test_forces_equal_those_of_python_in_every_golden_file(page: str, tmp_path: Path) -> None:
    steps, expected, names = [step("goto", url=page)], [None], [""]
    rng = np.random.default_rng(18)
    for stream in GOLDEN:
        steps.append(step("open", file=stream))
        expected.append(None)
        names.append(stream.stem)
        with tf.open_stream(stream) as opened:
            medium = opened.scene or opened.medium
            grid, count, rate = opened.grid, opened.reader.head.frame_count, opened.reader.head.rate_hz
            low, high = grid.box_m
            points = rng.uniform(low - 0.1 * (high - low), high + 0.1 * (high - low), (60, 3))
            points = np.concatenate([points, _within(opened.medium[0], rng)])
            sampler = tf.FieldSampler(medium)
            for time_s in sorted({0.0, 0.4 / rate, (count - 1) / rate, 0.77 * (count - 1) / rate}):
                forces = sampler.force_n(time_s, points)
                amplitudes, frequencies = sampler.vibration(time_s, points)
                steps += [step("seek", time=time_s), step("feel", points=points.reshape(-1).tolist())]
                expected += [None, np.column_stack([forces, amplitudes, frequencies])]
                names += [stream.stem, f"{stream.stem} at {time_s:g} s"]
    result = drive(tmp_path, *steps)
    assert result.errors == []
    nonzero = 0
    for answer, of_python, name in zip(result.answers, expected, names, strict=True):
        if of_python is not None:
            got = np.array(answer).reshape(-1, 5)
            np.testing.assert_allclose(got[:, :4], of_python[:, :4], rtol=0, atol=ALIKE_N, err_msg=name)
            nonzero += int((np.abs(of_python[:, :3]).max(axis=1) > 0).sum())
    assert nonzero > 1000


def _within(field: Any, rng: np.random.Generator) -> np.ndarray:
    """Points near samples with a force."""
    support = field.support()
    if not len(support.positions):
        return np.zeros((0, 3))
    positions = support.positions[rng.integers(0, len(support.positions), 60)]
    grid = field.grid
    return np.asarray(grid.origin_m) + (positions + rng.uniform(-0.6, 0.6, positions.shape)) * np.asarray(
        grid.spacing_m
    )


def test_a_faulty_file_is_refused_with_an_explanation(page: str, tmp_path: Path) -> None:
    names = sorted(FAULTY)
    steps = [step("goto", url=page)]
    for name in names:
        file = CONFORMANCE / "faulty" / f"{name}.touch"
        steps += [step("drop", file=file), step("through"), step("text", id="fault"), step("state")]
    result = drive(tmp_path, *steps)
    assert result.errors == []
    for name, text, state in zip(names, result.answers[3::4], result.answers[4::4], strict=True):
        assert state["state"] == "fault", name
        assert text.startswith(f"{name}.touch cannot be shown: "), text
        if not is_paper(CONFORMANCE / "faulty" / f"{name}.touch"):
            assert KINDS[FAULTY[name]] in text, (name, text)


def test_files_of_the_coder_paper_are_refused_by_name(page: str, tmp_path: Path) -> None:
    result = drive(tmp_path, step("goto", url=page),
                   step("open", file=CONFORMANCE / "v1" / "paper-dct.touch"), step("text", id="fault"),
                   step("open", file=SOLID), step("state"))  # fmt: skip
    assert "another version" in result.answers[2] and "coder" in result.answers[2]
    assert result.answers[4]["state"] == "ready"


def test_error_of_a_damaged_record_states_its_byte(page: str, tmp_path: Path) -> None:
    broken = bytearray(SOLID.read_bytes())
    broken[200] ^= 1
    path = tmp_path / "broken.touch"
    path.write_bytes(broken)
    result = drive(tmp_path, step("goto", url=page), step("drop", file=path), step("text", id="fault"))
    assert "at byte 14)" in result.answers[2]  # the start of HEAD


def test_play_seek_and_pause(page: str, tmp_path: Path) -> None:
    looks = [action for _ in range(6) for action in (step("wait", ms=130), step("state"))]
    result = drive(
        tmp_path,
        step("goto", url=page),
        step("open", file=MOVING),
        step("state"),
        step("click", id="play"),
        *looks,
        step("press", key=" "),
        step("state"),
        step("seek", time=0),
        step("press", key="."),
        step("state"),
    )
    first, *playing = result.answers[2], *result.answers[5:16:2]
    paused, on = result.answers[17], result.answers[20]
    assert first["bodies"] > 1 and first["triangles"] > 0 and first["cones"] > 0 and not first["playing"]
    assert all(state["playing"] for state in playing) and len({state["time"] for state in playing}) > 1
    assert not paused["playing"]
    assert on["time"] == pytest.approx(1 / on["head"]["rate"]) and result.errors == []


FRAME_REQUESTS = """(async () => {
  const request = window.requestAnimationFrame.bind(window);
  let requests = 0;
  window.requestAnimationFrame = (shown) => { requests++; return request(shown); };
  const press = (times) => { for (let n = 0; n < times; n++) document.getElementById("play").click(); };
  const within = async (frames) => {
    requests = 0;
    for (let n = 0; n < frames; n++) await new Promise(request);
    return requests;
  };
  press(1);
  const once = await within(20);
  press(1);
  press(5);
  return [once, await within(20)];
})()"""
"""How often the page asks for a frame of the screen, in 20 frames: after Play, and five presses at once."""


def test_play_that_is_pressed_again_at_once_starts_no_second_loop(page: str, tmp_path: Path) -> None:
    opening = step("goto", url=page), step("open", file=MOVING)
    result = drive(tmp_path, *opening, step("run", code=FRAME_REQUESTS), step("state"))
    once, five_times = result.answers[2]
    assert once > 10 and five_times < 1.3 * once and result.answers[3]["playing"] and result.errors == []


def test_the_pointer_probes_and_drags(page: str, tmp_path: Path) -> None:
    result = drive(tmp_path, step("goto", url=page), step("open", file=SOLID), step("state"),
                   step("move", x=430, y=400), step("move", x=470, y=430), step("state"),
                   step("place", selector="#labels .handle"))  # fmt: skip
    before, after, box = result.answers[2], result.answers[5], result.answers[6]
    assert before["point"] != after["point"]
    middle = [box["x"] + box["width"] / 2, box["y"] + box["height"] / 2]
    result = drive(tmp_path, step("goto", url=page), step("open", file=SOLID), step("state"),
                   step("drag", **{"from": middle, "to": [middle[0] - 60, middle[1]]}), step("state"),
                   step("drag", **{"from": [300, 600], "to": [400, 620]}), step("state"))  # fmt: skip
    assert result.answers[4]["cut"] != result.answers[2]["cut"]
    assert result.answers[6]["cut"] == result.answers[4]["cut"]
    assert result.errors == []


def test_a_sliding_hand_plays_the_sound_of_the_material(page: str, tmp_path: Path) -> None:
    levels = np.zeros((1, 1, len(BANDS_HZ)))
    levels[..., 9] = 0.01
    oak = Material("oak", speeds_m_s=(1e-6,), forces_n=(1e-4,), texture_rms_n=levels.tolist())
    stream = tmp_path / "oak.touch"
    store_materials(SOLID, [oak], stream)
    opening = [step("goto", url=page), step("open", file=stream), step("press", key="j")]
    slides = [step("press", key=key) for key in ("ArrowRight", "ArrowLeft", "ArrowRight")]
    result = drive(
        tmp_path,
        *opening,
        *slides,
        step("state"),
        step("wait", ms=400),
        step("press", key="j"),
        step("state"),
    )
    assert result.errors == []
    sliding, resting = (result.answers[n]["sound"] for n in (6, 9))
    assert sliding["hertz"] == pytest.approx(BANDS_HZ[9], rel=1e-4) and sliding["loudness"] > 0
    assert resting["hertz"] != pytest.approx(BANDS_HZ[9], rel=1e-4)


def test_all_functions_by_keys_and_as_spoken_text(page: str, tmp_path: Path) -> None:
    keys = [
        "ArrowUp",
        "ArrowRight",
        "Shift+ArrowLeft",
        "PageDown",
        "]",
        "y",
        "c",
        "+",
        "a",
        ">",
        "m",
        "v",
        "h",
        "j",
    ]
    pressed = [action for key in keys for action in (step("press", key=key), step("state"))]
    result = drive(
        tmp_path,
        step("goto", url=page),
        step("open", file=MOVING),
        step("state"),
        *pressed,
        step("press", key="t"),
        step("text", id="spoken"),
        step("press", key="?"),
        step("text", id="help"),
        step("run", code="document.documentElement.className"),
        step("press", key="s"),
        step("wait", ms=700),
        step("state"),
        step("wait", ms=3000),
        step("state"),
    )
    states = dict(zip(keys, result.answers[4 : 4 + 2 * len(keys) : 2], strict=True))
    first = result.answers[2]
    assert states["ArrowUp"]["point"] != first["point"]
    assert states["PageDown"]["point"] != states["Shift+ArrowLeft"]["point"] != states["ArrowRight"]["point"]
    assert states["]"]["cut"] != first["cut"] and states["y"]["axis"] == 1
    assert max(np.abs(states["j"]["force"][:3])) > 0 and states["j"]["sound"]["loudness"] > 0
    spoken, help_text, looks, scanning, over = (result.answers[i] for i in (-9, -7, -6, -3, -1))
    assert "newtons" in spoken and "millimetres from the middle" in spoken
    assert "scan" in help_text and looks == "contrast"
    assert scanning["point"] != over["point"]
    assert over["point"] == pytest.approx(states["j"]["point"])
    assert result.errors == []


def test_an_exported_page_opens_without_a_request(tmp_path: Path) -> None:
    out = tmp_path / "page.html"
    with pytest.raises(SystemExit) as ended:
        run_cli(["export", str(MOVING), str(out)], app)
    assert ended.value.code == 0
    result = drive(tmp_path, step("goto", url=out.as_uri()), step("state"), step("click", id="play"),
                   step("wait", ms=500), step("count", selector="#figures dd"))  # fmt: skip
    assert result.answers[1]["state"] == "ready" and result.answers[1]["name"] == MOVING.name
    assert result.answers[4] > 8
    assert [r for r in result.requests if not r.startswith("blob:")] == [out.as_uri()]
    assert result.errors == []


def test_the_difference_of_the_file_and_its_source(tmp_path: Path) -> None:
    """At samples of the lattice, in units of the mask, up to the error of the embedded source."""
    medium, rng = _waves(), np.random.default_rng(3)
    tf.encode(medium, tmp_path / "waves.touch", tf.EncodeSpec(touch=tf.codec.TouchSpec(k=0.3, f0_n=0.05)))
    page = tf.view(tmp_path / "waves.touch", against=medium)
    page.save(tmp_path / "page.html")
    field, grid = medium[0], medium.grid
    support = field.support().positions
    indices = support[rng.integers(0, len(support), 300)]
    points = (np.asarray(grid.origin_m) + indices * np.asarray(grid.spacing_m)).reshape(-1).tolist()
    probe = step("feel", points=points)
    result = drive(tmp_path, step("goto", url=(tmp_path / "page.html").as_uri()), probe,
                   step("press", key="e"), step("wait", ms=500), probe, step("text", id="unit"),
                   step("click", id="fields [data-what=difference]"), step("wait", ms=900), probe,
                   step("text", id="unit"), step("state"), step("text", id="caption"),
                   step("open", file=SOLID), step("state"), step("place", selector="#fields"))  # fmt: skip
    assert result.errors == []
    decoded, source, between = (np.array(result.answers[n]).reshape(-1, 5) for n in (1, 4, 8))
    true = field.sample_n(np.array(points).reshape(-1, 3))
    allowed = np.maximum(0.05, 0.3 * np.linalg.norm(true, axis=1))
    assert (np.linalg.norm(source[:, :3] - true, axis=1) <= 0.1 * allowed * (1 + 1e-6)).all()
    expected = (decoded[:, :3] - true) / allowed[:, None]
    assert np.linalg.norm(expected, axis=1).max() > 0.5  # the difference is visible
    np.testing.assert_allclose(between[:, :3], expected, atol=0.15)
    np.testing.assert_allclose(between[:, 3], allowed, rtol=0.04)
    assert (result.answers[5], result.answers[9]) == ("N", "of the error bound") and "0.1" in result.answers[
        11
    ]
    assert result.answers[10]["triangles"] > 0 and result.answers[10]["cones"] > 0
    assert (
        result.answers[13]["state"] == "ready"
        and result.answers[13]["what"] == "decoded"
        and result.answers[14] is None
    )


def test_differences_of_bodies_and_arrays_are_drawn(tmp_path: Path) -> None:
    """Every kind of medium: bodies at an instant between two frames, and actuators."""
    grid = tf.Grid((6, 5, 1), (0.01, 0.01, 0.01), (0, 0, 0))
    drives = np.zeros((6, 5, 1, 3), np.float32)
    drives[..., 0, 2] = np.linspace(0.1, 3, 30).reshape(6, 5)
    tf.encode(drives, tmp_path / "array.touch", tf.EncodeSpec(device="tshirt-32x32"), grid=grid)
    for name, source in (("array", tf.HapticMedium.from_array(drives, grid)), ("bodies", MOVING)):
        file = tmp_path / f"{name}.touch" if name == "array" else _again(MOVING, tmp_path / "bodies.touch")
        tf.view(file, against=source).save(tmp_path / f"{name}.html")
        result = drive(tmp_path, step("goto", url=(tmp_path / f"{name}.html").as_uri()),
                     step("click", id="fields [data-what=difference]"), step("wait", ms=600),
                     step("seek", time=0.0004), step("feel", points=[0, 0, 0]), step("state"))  # fmt: skip
        assert result.errors == [] and result.answers[5]["state"] == "ready", name
        assert result.answers[5]["what"] == "difference" and result.answers[4][3] > 0


def _again(stream: Path, out: Path) -> Path:
    tf.encode(stream, out)
    return out


def _waves() -> tf.HapticMedium:
    grid = tf.Grid((32, 32, 16), (0.004,) * 3, (-0.062, -0.062, -0.03))
    x, y, z = np.meshgrid(*(np.arange(n) for n in grid.shape), indexing="ij")
    force = np.stack([np.sin(x / 3), np.cos(y / 4), 1.5 + np.sin(z / 2)], axis=-1).astype(np.float32)
    force[z > 6 + 2 * np.sin(x / 5)] = 0
    return tf.HapticMedium.from_array(force, grid)


def test_texts_of_a_file_are_escaped(page: str, tmp_path: Path) -> None:
    grid = tf.Grid((16, 16, 8), (0.005, 0.005, 0.005), (-0.0375, -0.0375, -0.0175))
    force = np.zeros((16, 16, 8, 3), np.float32)
    force[4:12, 4:12, 2:6, 2] = 1.0
    evil = "<img src=x onerror=window.ran=1>"
    medium = tf.HapticMedium.from_array(force, grid, axes=f"x right, y up, z {evil}")
    tf.encode(medium, tmp_path / "evil.touch")
    result = drive(tmp_path, step("goto", url=page), step("open", file=tmp_path / "evil.touch"),
                   step("count", selector="img"), step("run", code="window.ran ?? 0"),
                   step("text", id="figures"))  # fmt: skip
    assert result.answers[2] == result.answers[3] == 0
    assert evil in result.answers[4]


def test_a_game_pad_rumbles_in_proportion_to_the_force(page: str, tmp_path: Path) -> None:
    pad = """window.played = []; Object.defineProperty(navigator, "getGamepads", { value: () => [null, {
      vibrationActuator: { playEffect: (kind, effect) => {
        played.push({ kind, size: Math.hypot(...touchfield.state().force.slice(0, 3)), ...effect });
        return Promise.resolve("complete");
      } } }] }); 0"""
    result = drive(
        tmp_path,
        step("goto", url=page),
        step("run", code=pad),
        step("open", file=SOLID),
        step("run", code="played.length"),
        step("click", id="rumble"),
        step("press", key="j"),
        step("wait", ms=1500),
        step("state"),
        step("press", key="v"),
        step("run", code="played"),
        step("press", key="ArrowUp"),
        step("run", code="played.length"),
    )
    silent, state, played, after = result.answers[3], result.answers[7], result.answers[9], result.answers[11]
    size = played[-1]["size"]
    assert result.errors == [] and silent == 0 and after == len(played) > 0
    assert played[-1]["kind"] == "dual-rumble" and played[-1]["duration"] > 60
    assert played[-1]["strongMagnitude"] == pytest.approx(size / state["head"]["peak"]) and size > 0


def test_the_pressure_of_a_pen_is_depth(page: str, tmp_path: Path) -> None:
    """At half its pressure a pen has the depth of a mouse, and the depth is proportional to the pressure."""
    presses = [("mousePressed", 0.1), ("mouseMoved", 0.5), ("mouseMoved", 0.9), ("mouseReleased", 0.0)]
    pens = [
        action
        for kind, force in presses
        for action in (step("pen", type=kind, x=479, y=420, force=force), step("state"))
    ]
    result = drive(tmp_path, step("goto", url=page), step("open", file=SOLID), step("press", key="c"),
                   step("move", x=479, y=420), step("state"), *pens)  # fmt: skip
    assert result.errors == []
    head, pointer = result.answers[4]["head"], np.array(result.answers[4]["point"])
    light, half, hard = (np.array(result.answers[n]["point"]) for n in (6, 8, 10))
    depth_m = 0.05 * min(n * h for n, h in zip(head["shape"], head["spacing"], strict=True))
    np.testing.assert_allclose(half, pointer, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(half - light), 0.8 * depth_m, rtol=1e-3)
    np.testing.assert_allclose(hard - half, half - light, atol=1e-6)


def test_an_hour_of_a_medium_takes_no_more_memory_than_its_first_minutes(page: str, tmp_path: Path) -> None:
    played, heap, memory, objects = hour_played(tmp_path, page).T
    first, last = (played > 600) & (played < 1800), played > 2400
    assert first.sum() > 10 and last.sum() > 10
    assert np.median(heap[last]) - np.median(heap[first]) < 500_000
    assert memory[last].max() == memory[first].max() > 1 << 20
    assert objects[last].max() <= objects[first].max() < 50


@pytest.mark.parametrize(
    "policy",
    [
        "",  # Jupyter and marimo
        "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval'; style-src 'unsafe-inline'; "
        "img-src https: data:; child-src https: data: blob:",  # as in the view of an editor
        "worker-src 'none'",  # no threads: the decoder runs in the thread of the page
    ],
)
def test_a_notebook_shows_the_page_in_a_frame(tmp_path: Path, policy: str) -> None:
    out = tmp_path / "notebook.html"
    head = f'<meta http-equiv="Content-Security-Policy" content="{policy}">' if policy else ""
    cell = tf.view(MOVING)._repr_html_()
    out.write_text(
        f'<!doctype html><html data-state="ready"><head>{head}</head><body>{cell}</body></html>',
        encoding="utf-8",
    )
    outer_title = "(() => { try { return parent.document.title; } catch { return 'closed'; } })()"
    result = drive(tmp_path, step("goto", url=out.as_uri()),
                   step("until", frame=1, code="window.touchfield?.state().state == 'ready'"),
                   step("within", code="window.touchfield.state()"), step("within", code=outer_title),
                   step("within", code="[...document.querySelectorAll('button')].find((b) => b.id == "
                                       "'play').click()"),
                   step("until", frame=1, code="window.touchfield.state().time > 0"))  # fmt: skip
    assert result.answers[2]["state"] == "ready" and result.answers[2]["triangles"] > 0, result.errors
    assert result.answers[3] == "closed"
    assert all("worker" in error.lower() for error in result.errors) and bool(result.errors) == (
        "worker-src" in policy
    )


def test_memory_grows_with_the_file(page: str, tmp_path: Path) -> None:
    grid = tf.Grid((160, 160, 160), (1e-3,) * 3, (-0.0795,) * 3)
    force = np.zeros((160, 160, 160, 3), np.float32)
    force[4::8, 4::8, 4::8, 2] = 1.0  # 8000 bricks: more than the initial memory
    tf.encode(tf.HapticMedium.from_array(force, grid), tmp_path / "wide.touch")
    point = [grid.origin_m[n] + 12e-3 for n in range(3)]
    result = drive(tmp_path, step("goto", url=page), step("open", file=tmp_path / "wide.touch"),
                   step("state"), step("feel", points=point), step("open", file=MOVING),
                   step("state"))  # fmt: skip
    assert result.answers[2]["state"] == result.answers[5]["state"] == "ready" and result.errors == []
    assert result.answers[3][2] == pytest.approx(1.0, abs=0.11)


def test_a_movie_and_its_touch_are_on_one_clock(tmp_path: Path) -> None:
    """The brightness of the picture and the height of the touch encode the time; both are in one file."""
    av = pytest.importorskip("av", reason="movies need the extra video")
    from touchfield.network.mux import mux

    grid = tf.Grid((24, 24, 24), (0.004,) * 3, (-0.046,) * 3)
    dense = np.zeros((30, 24, 24, 24, 3), np.float32)
    for i in range(30):
        dense[i, :, : 4 + i // 2] = (0, 2, 0)
    tf.encode(dense, tmp_path / "rise.touch", grid=grid)  # 30 frames a second
    with av.open(str(tmp_path / "film.mp4"), "w") as sink:
        track = sink.add_stream("libvpx-vp9", rate=25)
        track.width, track.height, track.pix_fmt = 160, 96, "yuv420p"
        for i in range(75):
            sink.mux(track.encode(av.VideoFrame.from_ndarray(np.full((96, 160, 3), 3 * i, np.uint8))))
        sink.mux(track.encode(None))
    mux(tmp_path / "film.mp4", tmp_path / "rise.touch", tmp_path / "both.mp4", 1.0)
    tf.view(tmp_path / "both.mp4").save(tmp_path / "page.html")
    ready = (
        "new Promise((done) => { const v = document.getElementById('video'); "
        "v.readyState > 1 ? done(1) : (v.oncanplay = () => done(1)); })"
    )
    sought = (
        "(() => { const at = document.getElementById('at'); at.value = '0.5'; "
        "at.dispatchEvent(new Event('input')); })()"
    )
    looks = [state for _ in range(5) for state in (step("wait", ms=400), step("state"))]
    result = drive(
        tmp_path,
        step("goto", url=(tmp_path / "page.html").as_uri()),
        step("run", code=ready),
        step("state"),
        step("click", id="play"),
        *looks,
        step("click", id="play"),
        step("run", code=sought),
        step("wait", ms=400),
        step("state"),
        step("shot", path=str(tmp_path / "movie.png")),
    )
    first, playing, last = result.answers[2], result.answers[5:14:2], result.answers[17]
    assert result.errors == [] and not [
        url for url in result.requests if not url.startswith(("file:", "blob:", "data:"))
    ]
    assert first["state"] == "ready" and first["movie"] == 0
    times = [(state["movie"], state["time"]) for state in playing]
    assert all(0 < a < b for (a, _), (b, _) in zip(times, times[1:], strict=False))
    for film, touch in times:
        assert touch == pytest.approx(min(max(film - 1, 0), 29 / 30), abs=0.35)  # a slowly drawn frame
    assert not last["playing"] and last["movie"] == pytest.approx(1.5, abs=0.05)
    assert last["time"] == pytest.approx(0.5)


SAVED = "!document.getElementById('saved').textContent.startsWith('Saving')"


def _within_bound(stream: Path, original: list[tf.ForceField], k: float, f0_n: float) -> float:
    """Largest |error| / max(F_0, k |F|) of a file; its decoded frames are as many as the original ones."""
    medium = tf.decode(stream)
    assert len(medium) == len(original)
    ratios = [0.0]
    for decoded, frame in zip(medium, original, strict=True):
        true = frame.to_dense().astype(np.float64)
        allowed = np.maximum(f0_n, k * np.linalg.norm(true, axis=-1))
        ratios.append(float((np.linalg.norm(decoded.to_dense() - true, axis=-1) / allowed).max()))
    return max(ratios)


def _rising(count: int) -> tf.HapticMedium:
    """A wavy floor that rises from frame to frame."""
    x, y, z = np.meshgrid(*(np.arange(n) for n in (20, 17, 24)), indexing="ij")
    frames = []
    for i in range(count):
        depth = 6 + i / 3 + 2 * np.sin(x / 4) - z
        push = np.stack([0.1 * np.cos(y / 3), 0.1 * np.sin(x / 3), 0.3 * depth], axis=-1)
        frames.append(np.where(depth[..., None] > 0, push, 0))
    grid = tf.Grid((20, 17, 24), (0.004,) * 3, (-0.038, -0.032, -0.046))
    return tf.HapticMedium.from_array(np.stack(frames).astype(np.float32), grid, 30.0)


def test_the_shown_frame_is_saved_as_a_file(page: str, tmp_path: Path) -> None:
    """By the button with the bound of the file, by a key with another one; the page opens what it saved."""
    source, first, second = (tmp_path / f"{name}.touch" for name in ("rising", "first", "second"))
    tf.encode(_rising(3), source, tf.EncodeSpec(touch=tf.codec.TouchSpec(k=0.05, f0_n=0.02)))
    shown = tf.decode(source)
    result = drive(
        tmp_path,
        step("goto", url=page),
        step("open", file=source),
        step("seek", time=1 / 30),
        step("download", id="save-frame", path=str(first)),
        step("until", code=SAVED),
        step("text", id="saved"),
        step("fill", id="save-k", value="20"),
        step("fill", id="save-f0", value="0.1"),
        step("download", id="save-frame", key="Enter", path=str(second)),
        step("until", code=SAVED),
        step("state"),
        step("open", file=second),
        step("state"),
    )
    assert result.errors == []
    assert result.answers[3] == "rising-1.touch"
    assert result.answers[5].startswith("Saved rising-1.touch: 1 frame, ")
    assert result.answers[10]["name"] == "rising.touch" and result.answers[10]["state"] == "ready"
    for stream, k, f0_n in ((first, 0.05, 0.02), (second, 0.2, 0.1)):
        assert 0 < _within_bound(stream, [shown[1]], k, f0_n) <= 1 + 1e-6
        with tf.open_stream(stream) as opened:
            head = opened.reader.head
            assert (head.weber_fraction, head.force_threshold_n) == pytest.approx((k, f0_n))
            assert opened.reader.provenance["source"].startswith("frame 1 of rising.touch")
            assert opened.reader.provenance["source.source"] == "scene"
    assert second.stat().st_size < first.stat().st_size
    assert result.answers[12]["state"] == "ready" and result.answers[12]["name"] == "second.touch"
    assert result.answers[12]["head"]["frames"] == 1
    with pytest.raises(SystemExit) as ended:
        run_cli(["info", str(first)], app)
    assert ended.value.code == 0


def test_a_range_of_frames_is_saved_in_segments(page: str, tmp_path: Path) -> None:
    source, out = tmp_path / "rising.touch", tmp_path / "range.touch"
    tf.encode(_rising(24), source)
    shown = list(tf.decode(source))
    result = drive(
        tmp_path,
        step("goto", url=page),
        step("open", file=source),
        step("fill", id="save-from", value="3"),
        step("fill", id="save-to", value="22"),
        step("download", id="save-range", path=str(out)),
        step("open", file=out),
        step("through"),
        step("state"),
    )
    assert result.errors == []
    assert result.answers[4] == "rising-3-22.touch"
    assert 0 < _within_bound(out, shown[3:23], 0.1, 0.05) <= 1 + 1e-6
    with tf.open_stream(out) as opened:
        assert [entry.frame_count for entry in opened.reader.segments] == [15, 5]
    assert result.answers[7]["state"] == "ready" and result.answers[7]["head"]["frames"] == 20


def test_vibrations_are_saved_exactly(page: str, tmp_path: Path) -> None:
    source, out = CONFORMANCE / "v1" / "vibration-touch.touch", tmp_path / "out.touch"
    result = drive(tmp_path, step("goto", url=page), step("open", file=source),
                   step("download", id="save-range", path=str(out)))  # fmt: skip
    assert result.errors == []
    before, after = tf.decode(source), tf.decode(out)
    assert len(before) == len(after) > 1
    sampler, other = tf.FieldSampler(before), tf.FieldSampler(after)
    points = _lattice(before.grid)
    count = 0
    for i in range(len(before)):
        expected = sampler.vibration(i / before.rate_hz, points)
        found = other.vibration(i / after.rate_hz, points)
        np.testing.assert_array_equal(expected, found)
        count += int((np.asarray(expected)[0] > 0).sum())
    assert count > 0


def _lattice(grid: tf.Grid) -> np.ndarray:
    """Positions of all samples, metres, [samples, 3]."""
    indices = np.stack(np.meshgrid(*(np.arange(n) for n in grid.shape), indexing="ij"), axis=-1)
    return np.asarray(grid.origin_m) + indices.reshape(-1, 3) * np.asarray(grid.spacing_m)


def test_what_cannot_be_saved_is_reported(page: str, tmp_path: Path) -> None:
    text, paper = step("text", id="saved"), CONFORMANCE / "v1" / "paper-dct.touch"
    result = drive(
        tmp_path,
        step("goto", url=page),
        step("open", file=MOVING),
        text,
        step("click", id="save-frame"),
        step("until", code=SAVED),
        text,
        step("open", file=SOLID),
        text,
        step("fill", id="save-k", value="0"),
        step("click", id="save-frame"),
        text,
        step("open", file=paper),
        text,
        step("text", id="fault"),
        step("press", key="p"),
        text,
    )
    assert result.errors == []
    assert all("coder objects" in result.answers[n] for n in (2, 5))
    assert result.answers[7] == ""
    assert result.answers[10].startswith("Cannot be saved") and "percent" in result.answers[10]
    assert "paper-dct.touch cannot be shown" in result.answers[12] and "coder paper" in result.answers[13]
    assert result.answers[15].startswith("Cannot be saved")
