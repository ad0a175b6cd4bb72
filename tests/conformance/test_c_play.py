"""The receiver for engines in C, `c/touch_play.h`: the forces of the Python player, under the sanitizers."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from shutil import which
from typing import Any

import numpy as np
import pytest

import touchfield as tf
from touchfield.container import TouchReader, TouchWriter
from touchfield.devices import device
from touchfield.devices.drivers.simulated import SimHand
from touchfield.errors import TouchfieldError
from touchfield.medium.trace import Trace
from touchfield.perception.vibrotactile import BANDS_HZ
from touchfield.render.block import Memory
from touchfield.render.material import KEY, Material, stored_json
from touchfield.render.offline import run_offline
from touchfield.render.player import Session
from touchfield.render.spec import RenderSpec, stated_n_per_m as stated_of, wall_of
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Box

HERE = Path(__file__).resolve().parent
C, GOLDEN = HERE.parents[1] / "c", HERE.parents[1] / "conformance" / "v1"
WARNINGS = ("-std=c99", "-Wall", "-Wextra", "-pedantic", "-Wconversion", "-Werror")
SANITIZERS = ("-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
OMNI = device("phantom-omni")
NAMES = ("touch-block", "touch-fast", "touch-lossless", "touch-mask", "touch-solid", "touch-empty")
NO_TSAN_WARNINGS = {"thread": ("-Wno-tsan",), "address,undefined": ()}
OBJECTS = ("objects-touch", "objects-touch-deforming", "vibration-touch")


def compiled(source: Path, folder: Path, *options: str) -> Path:
    """Compile a program of C; skip without a compiler."""
    compiler = which("cc")
    if compiler is None:
        pytest.skip("no C compiler")
    program = folder / source.stem
    command = [compiler, *WARNINGS, *options, f"-I{C}", "-o", program, source, "-lm", "-lpthread"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return program


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return compiled(HERE / "play.c", tmp_path_factory.mktemp("play"), *SANITIZERS)


@pytest.fixture(scope="module")
def plate(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plate of 60 x 40 x 2 mm."""
    path = tmp_path_factory.mktemp("plate") / "plate.touch"
    tf.encode(AnalyticScene((Box((0, 0, 0), (0.03, 0.02, 0.001)),)), path, tf.EncodeSpec(nw=7, mapping="1"))
    return path


@dataclass
class Played:
    """Settings, and of each tick: media time, flags and force."""

    settings: Any
    media_s: Any
    flags: Any
    forces_n: Any


def play(
    program: Path, path: Path, positions_m: Any, folder: Path, loop: bool = False, start_s: float = 0.0
) -> Played:
    """Ticks of the program at positions, float64 [n, 3]."""
    numbers = (
        *(OMNI.force_max_n, OMNI.force_continuous_n or 0.0, 1e-3 * (OMNI.delay_ms or 0.0)),
        *(OMNI.inertia_kg or 0.0, OMNI.damping_n_s_per_m or 0.0, OMNI.friction_n or 0.0),
        *(1e-3 * (OMNI.resolution_mm or 0.0), loop, start_s, 1.0),
    )
    np.asarray(positions_m, "<f8").tofile(folder / "positions")
    np.asarray(numbers, "<f8").tofile(folder / "options")
    command = [program, path, folder / "positions", folder / "out", folder / "options"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    rows = np.fromfile(folder / "out", "<f8").reshape(-1, 5)
    settings = [float(word) for word in done.stdout.split()]
    return Played(settings, rows[:, 0], rows[:, 1].astype(int), rows[:, 2:])


def play_in_python(path: Path, positions_m: Any, loop: bool) -> tuple[list[float], Any]:
    """The settings, and the log, of the Python player at the same positions."""
    count = len(positions_m)
    trace = Trace(np.arange(count) * 1e-3, np.asarray(positions_m), None)
    with tf.open_stream(path) as stream:
        medium = stream.scene or stream.medium
        spec = RenderSpec(up="lattice")
        profile = with_axes_of(medium)
        run = run_offline(medium, profile, lambda: SimHand(trace), spec, seconds=1e-3 * count, loop=loop)
        session = Session(medium, profile, spec)
        memory = Memory.empty(session.layout.size_bytes)
        session.set_up(memory)
        chosen = memory.receiver["settings"]
    names = ("wall_n_per_m", "wall_level_n", "brake_n_s_per_m", "coupling_n_per_m", "friction")
    return [*(float(chosen[name]) for name in names), float(chosen["damping_n_s_per_m"])], run.log[:count]


def with_axes_of(medium: Any) -> Any:
    """The device, in the axes of the medium."""
    return replace(OMNI, axes=medium.axes)


def through_the_medium(path: Path, count: int) -> Any:
    """A smooth way through all of the medium, float64 [count, 3], metres."""
    with tf.open_stream(path) as stream:
        low, high = (np.asarray(edge) for edge in stream.grid.box_m)
    t = np.arange(count)[:, None] * 1e-3
    waves = np.sin(t * np.array([29.0, 37.0, 23.0]) + np.array([0.1, 0.3, 0.2]))
    return (low + high) / 2 + 0.52 * (high - low) * waves


@pytest.mark.parametrize("name", [*NAMES, *OBJECTS])
@pytest.mark.parametrize("loop", [False, True])
def test_forces_are_those_of_the_python_player(program: Path, tmp_path: Path, name: str, loop: bool) -> None:
    path = GOLDEN / f"{name}.touch"
    way_m = through_the_medium(path, 900)
    settings, log = play_in_python(path, way_m, loop)
    played = play(program, path, log["position_m"], tmp_path, loop)  # the simulated hand adds up its time
    assert played.settings == settings
    np.testing.assert_allclose(played.media_s, log["media_s"], atol=1e-12)
    np.testing.assert_array_equal(played.flags, log["flags"])
    np.testing.assert_allclose(played.forces_n, log["force_n"], atol=1e-9, rtol=0)
    assert name == "touch-empty" or np.abs(played.forces_n).max() > 0.05


def press(thickness_m: float, count: int = 1500) -> Any:
    """A hand that goes from 5 mm above a plate to 2 mm below its surface and rests, float64 [count, 3]."""
    surface_m = thickness_m / 2
    height_m = np.interp(
        np.arange(count), [0, 300, count], [surface_m + 0.005, surface_m - 0.002, surface_m - 0.002]
    )
    return np.stack([np.full(count, 0.004), np.full(count, 0.003), height_m], axis=1)


def test_hand_is_held_by_a_thin_plate(program: Path, plate: Path, tmp_path: Path) -> None:
    played = play(program, plate, press(0.002), tmp_path)
    sizes_n = np.linalg.norm(played.forces_n, axis=1)
    assert played.settings[0] > 100  # there is a proxy
    # 2 mm into a plate of 2 mm: the field itself pushes to the other side, or not at all; the proxy pushes up
    expected_n = min(played.settings[0] * 0.002, OMNI.force_continuous_n)
    assert (played.forces_n[400:, 2] > 0.8 * expected_n).all()
    assert sizes_n.max() <= OMNI.force_max_n
    assert np.linalg.norm(np.diff(played.forces_n, axis=0), axis=1).max() <= OMNI.force_max_n / 0.005 * 1e-3


def test_force_comes_with_a_ramp(program: Path, plate: Path, tmp_path: Path) -> None:
    """A hand that is within the plate from the first tick on."""
    resting = np.repeat([[0.004, 0.003, 0.0006]], 160, axis=0)
    played = play(program, plate, resting, tmp_path)
    sizes_n, ticks = np.linalg.norm(played.forces_n, axis=1), np.arange(160)
    assert sizes_n[120] > 0.1
    gains = np.minimum(1.0, (ticks + 1) * 1e-3 / 0.02)
    gains *= 0.5 - 0.5 * np.cos(np.pi * np.minimum(1.0, ticks * 1e-3 / 0.1))  # as after a seam (touch_seam.h)
    np.testing.assert_allclose(sizes_n, sizes_n[120] * gains, rtol=0.02, atol=1e-3)


@pytest.fixture(scope="module", params=["thread", "address,undefined"])
def threads_program(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The program with three threads, under a sanitizer; the thread sanitizer knows no fences (-Wno-tsan)."""
    sanitizer = f"-fsanitize={request.param}"
    compiler = which("cc")
    check = [str(compiler), sanitizer, "-x", "c", "-", "-o", str(tmp_path_factory.mktemp("check") / "check")]
    source = "int main(void) { return 0; }"
    if compiler is None or subprocess.run(check, input=source, text=True, check=False).returncode:
        pytest.skip(f"no compiler with {sanitizer}")
    options = "-O1", "-g", sanitizer, "-fno-sanitize-recover=all", *NO_TSAN_WARNINGS[request.param]
    return compiled(HERE / "play_threads.c", tmp_path_factory.mktemp("threads"), *options)


def counts_of(
    program: Path, path: Path, seed: float, speed: float, loop: bool, least_forces: int = 0
) -> list[int]:
    """Ticks, with a force, without a frame, frames left out, and seeks, in 1.5 s.

    Up to 15 s, until so many ticks had a force: a loaded machine decodes late.
    """
    numbers = "1.5", seed, speed, int(loop), least_forces
    command = [str(program), str(path), *map(str, numbers)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0, done.stdout + done.stderr
    return [int(word) for word in done.stdout.split()]


@pytest.mark.parametrize("name", ["touch-block", "objects-touch-deforming", "vibration-touch"])
@pytest.mark.parametrize("loop", [False, True])
def test_orders_at_any_time_from_a_third_thread(threads_program: Path, name: str, loop: bool) -> None:
    """Forces are within peak and slew limit at every tick, and zero after the stop."""
    counts = counts_of(threads_program, GOLDEN / f"{name}.touch", 7.0, 1.0, loop, least_forces=21)
    ticks, forces, _, _, seeks = counts
    assert ticks > 100 and forces > 20 and seeks > 5


@pytest.mark.parametrize("name", ["touch-fast", "objects-touch-deforming"])
def test_a_slow_machine_shows_the_frames_that_it_can_decode(threads_program: Path, name: str) -> None:
    """At 40 times the speed, no machine decodes all frames under a sanitizer."""
    path = GOLDEN / f"{name}.touch"
    ticks, forces, stalled, left_out, _ = counts_of(threads_program, path, 0.0, 40.0, loop=True)
    assert left_out > 100
    assert stalled < 0.8 * ticks and forces > 0.1 * ticks  # all, and none, if no frame is left out in advance


def test_walls_have_the_stiffness_that_the_file_states(program: Path, plate: Path, tmp_path: Path) -> None:
    with tf.open_stream(plate) as stream:
        measured, stated_n_per_m = wall_of(stream.medium[0]), stated_of(stream.medium.provenance)
    assert measured is not None and measured.stiffness_n_per_m != stated_n_per_m == 500.0
    assert play(program, plate, np.zeros((1, 3)), tmp_path).settings[0] == stated_n_per_m


TEXTURE = tuple(tuple(0.01 * (n + m) for n in range(16)) for m in range(2))
OAK = Material(
    *("oak", 0.4, 0.7, 0.002, None, ((-1.0, -1.0, -1.0), (1.0, 1.0, 0.0))),
    *((0.05, 0.1), (1.0,), tuple((row,) for row in TEXTURE)),
)
FELT = Material("felt", 0.9, speeds_m_s=(0.02,), forces_n=(0.5, 2.0), texture_rms_n=(TEXTURE,))


def copy_changed(
    source: Path,
    path: Path,
    *,
    rate_hz: float | None = None,
    materials: str | None = None,
    names: Sequence[str] = (),
) -> Path:
    """Copy a file with another rate of frames, materials, valid or not, and names of its objects."""
    with TouchReader(source) as reader, TouchWriter(path) as writer:
        head = reader.head if rate_hz is None else replace(reader.head, rate_hz=rate_hz)
        provenance = reader.provenance if materials is None else {**reader.provenance, KEY: materials}
        writer.write_head(head, provenance)
        for n in range(reader.object_count):
            record = reader.read_object(n)
            writer.write_object(replace(record, name=names[n]) if names else record)
        for n, entry in enumerate(reader.segments):
            writer.write_segment(entry.first_frame, entry.frame_count, reader.read_segment(n))
    return path


@pytest.mark.parametrize("name", ["touch-block", "objects-touch"])
def test_forces_with_stored_materials_are_those_of_the_python_player(
    program: Path, tmp_path: Path, name: str
) -> None:
    path, oak = tmp_path / "stored.touch", OAK
    names = ('T\u00fcr "\U0001f600\\', "b", "c") if name == "objects-touch" else ()  # JSON escapes the first
    if names:
        oak = replace(oak, object=names[0], box_m=None)
    materials = stored_json([oak, FELT, Material("plain")])
    copy_changed(GOLDEN / f"{name}.touch", path, materials=materials, names=names)
    settings, log = play_in_python(path, through_the_medium(path, 900), loop=True)
    plain = play(program, GOLDEN / f"{name}.touch", log["position_m"], tmp_path, loop=True)
    played = play(program, path, log["position_m"], tmp_path, loop=True)
    assert played.settings == settings
    np.testing.assert_allclose(played.forces_n, log["force_n"], atol=1e-9, rtol=0)
    assert np.abs(played.forces_n - plain.forces_n).max() > 1e-3


@pytest.mark.parametrize(
    ("text", "is_valid"),
    [
        ('"materials": []', True),
        ('"materials": [{"name": "a", "friction": null, "slip_length_m": 1e-6}]', True),
        ('"materials": [{"name": "a", "friction": -0.1}]', False),
        ('"materials": [{"name": "a", "static_friction": 0.5}]', False),
        ('"materials": [{"name": "a", "friction": 0.6, "static_friction": 0.5}]', False),
        ('"materials": [{"name": "a", "slip_length_m": 1e-7}]', False),
        ('"materials": [{"name": "a", "box_m": [[0, 0, 0], [1, -1, 1]]}]', False),
        ('"materials": [{"name": "a", "box_m": [0, 0, 0]}]', False),
        ('"materials": [{"name": "a", "speeds_m_s": [0.1], "forces_n": [1]}]', False),
        ('"materials": [{"name": "a", "texture_rms_n": [[[0, 0]]]}]', False),
        ('"materials": [{"name": "a", "object": "elsewhere"}]', False),
        ('"materials": [{"friction": 0.1}]', False),
        ('"materials": [7]', False),
        ('"materials": {}', False),
        ('"material": []', False),
    ],
)
def test_materials_are_valid_in_c_if_they_are_in_python(
    program: Path, tmp_path: Path, text: str, is_valid: bool
) -> None:
    path = tmp_path / "stored.touch"
    bands = json.dumps([float(f"{hz:.4g}") for hz in BANDS_HZ])
    copy_changed(GOLDEN / "touch-block.touch", path, materials=f'{{"bands_hz": {bands}, {text}}}')
    for run in (
        lambda: play(program, path, np.zeros((1, 3)), tmp_path),
        lambda: play_in_python(path, np.zeros((1, 3)), loop=False),
    ):
        if is_valid:
            run()
        else:
            with pytest.raises((AssertionError, TouchfieldError), match="material"):
                run()


@pytest.fixture(scope="module")
def readme_program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The program of c/README.md."""
    text = (C / "README.md").read_text().split("```c\n")[-1].split("```")[0]
    source = tmp_path_factory.mktemp("readme") / "receiver.c"
    source.write_text(text)
    return compiled(source, source.parent, "-O1")


@pytest.mark.parametrize("name", ["touch-block", "objects-touch", "plate"])
def test_program_of_the_readme_runs(readme_program: Path, plate: Path, tmp_path: Path, name: str) -> None:
    """It renders in real time: hands rest for seconds, and media last for one, so that load is no fault."""
    count = 4000
    if name == "plate":
        path, positions_m = plate, press(0.002, count)
    else:
        path = copy_changed(GOLDEN / f"{name}.touch", tmp_path / "slow.touch", rate_hz=5.0)
        positions_m = np.tile(point_with_a_force(path), (count, 1))
    lines = "".join(f"{x!r} {y!r} {z!r}\n" for x, y, z in positions_m.tolist())
    done = subprocess.run([readme_program, path], input=lines, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    forces_n = np.array([line.split() for line in done.stdout.splitlines()], np.float64)
    assert len(forces_n) == len(positions_m)
    assert 0.05 < np.linalg.norm(forces_n, axis=1).max() <= 3.3
    if name == "plate":
        assert (forces_n[-100:, 2] > 0.5).all()


def test_program_of_the_readme_refuses_a_damaged_file(readme_program: Path) -> None:
    path = GOLDEN.parent / "faulty" / "cut-at-end.touch"
    done = subprocess.run([readme_program, path], capture_output=True, text=True, check=False)
    assert done.returncode == 65 and "end too early" in done.stderr


@pytest.fixture(scope="module")
def orders_program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return compiled(HERE / "play_orders.c", tmp_path_factory.mktemp("orders"), *SANITIZERS)


def point_with_a_force(path: Path) -> Any:
    """A point, float64 [3], metres, that has a force in every frame."""
    with tf.open_stream(path) as stream:
        frames = [stream.medium[n] for n in range(len(stream.medium))]
        points = frames[0].grid.to_m(frames[0].positions())
        sizes_n = [np.linalg.norm([frame.sample_n(point) for point in points], axis=1) for frame in frames]
    return points[np.argmax(np.min(sizes_n, axis=0))]


@pytest.mark.parametrize("name", ["touch-solid", "plate"])
@pytest.mark.parametrize("check", ["stop", "silence", "force-max"])
def test_checks_of_play_orders(orders_program: Path, plate: Path, name: str, check: str) -> None:
    """A stop is for ever; a thread that decodes no more is reported; 0 is the medium's greatest force."""
    path = plate if name == "plate" else GOLDEN / f"{name}.touch"
    point = (0.004, 0.003, 0.0006) if name == "plate" else point_with_a_force(path)
    command = [orders_program, check, path, *map(str, point)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
