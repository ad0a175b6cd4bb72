"""The library for Unity renders the forces of the Python player: from Python, and from C# (Mono, .NET)."""

from __future__ import annotations

import ctypes
import json
import re
from collections.abc import Iterator
from ctypes import POINTER, c_char_p, c_double, c_int, c_int64, c_uint64, c_void_p
from pathlib import Path

import numpy as np
import pytest
from builders import (
    ATOL_N,
    ENGINE,
    FAULTY,
    INTEGRATIONS,
    OBJECTS,
    TICKS,
    VOXELS,
    assert_has_friction,
    assert_is_released,
    assert_resists,
    build_integration,
    needs,
    player_forces,
    press_plate,
    run,
    slide_on_plate,
    slow_way,
    stream_of,
    ticks_of,
)

pytestmark = needs("make", "cc")
SOURCE = (INTEGRATIONS / "unity" / "Touchfield.cs").read_text()
HEADER = (INTEGRATIONS / "unity" / "touchfield.h").read_text()
TICK_NS = 1_000_000
OPTIONS = {"wall_n_per_m": 800, "damping_n_s_per_m": 0.5, "coupling_n_per_m": 0, "is_loop": 1}
ARGUMENTS = ["-l", "-k", 800, "-d", 0.5, "-c", 0]
TYPES = {
    "touchfield *": c_void_p,
    "const touchfield *": c_void_p,
    "const void *": c_char_p,
    "const char *": c_char_p,
    "uint64_t ": c_uint64,
    "int64_t ": c_int64,
    "double ": c_double,
    "int ": c_int,
    "void ": None,
}
IN_CS = {
    "touchfield *": "IntPtr",
    "const touchfield *": "IntPtr",
    "const void *": "byte[]",
    "const char *": "string",
    "uint64_t ": "ulong",
    "int64_t ": "long",
    "double ": "double",
    "int ": "int",
    "void ": "void",
}


def declarations() -> dict[str, tuple[str, list[str]]]:
    """Functions of the header: type of the result, types of the arguments."""
    found = {}
    pattern = r"^TOUCHFIELD_API (\w[\w ]*?[ *]+)(touchfield_\w+)\(([^)]*)\);"
    for result, name, arguments in re.findall(pattern, HEADER, re.MULTILINE):
        kinds = ["double[]" if a.endswith("[3]") else re.sub(r"\w+$", "", a) for a in arguments.split(", ")]
        found[name] = result, kinds
    return found


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_integration("unity", tmp_path_factory.mktemp("unity"), "CFLAGS=-O1")


@pytest.fixture(scope="module")
def library(built: Path) -> ctypes.CDLL:
    (path,) = (*built.glob("libtouchfield.so"), *built.glob("libtouchfield.dylib"))
    library = ctypes.CDLL(str(path))
    for name, (result, arguments) in declarations().items():
        getattr(library, name).restype = TYPES[result]
        getattr(library, name).argtypes = [
            POINTER(c_double) if kind == "double[]" else TYPES[kind] for kind in arguments
        ]
    return library


class Player:
    """A player of the library on a simulated clock, which decodes between ticks."""

    def __init__(self, library: ctypes.CDLL, path: Path, **options: float) -> None:
        content = path.read_bytes()
        self.library, self.handle, self.ticks = library, library.touchfield_open(content, len(content)), 0
        for name, value in options.items():
            assert library.touchfield_set(self.handle, name.encode(), value)
        self.code = library.touchfield_start(self.handle)

    @property
    def error(self) -> str:
        return self.library.touchfield_error(self.handle).decode()

    @property
    def media_s(self) -> float:
        return self.library.touchfield_media_s(self.handle)

    def tick(self, position_m: np.ndarray) -> np.ndarray:
        """The force after waiting for its frames, float64 [3]."""
        force_n, now_ns = np.empty(3), self.ticks * TICK_NS
        while not self.library.touchfield_is_ready(self.handle, now_ns):
            assert self.library.touchfield_decode(self.handle)
        pointer = force_n.ctypes.data_as(POINTER(c_double))
        has_force = self.library.touchfield_tick(self.handle, *position_m.tolist(), now_ns, pointer)
        assert bool(has_force) == force_n.any()
        self.ticks += 1
        return force_n

    def forces_n(self, positions_m: np.ndarray) -> np.ndarray:
        return np.stack([self.tick(position_m) for position_m in positions_m])


@pytest.fixture
def open_player(library: ctypes.CDLL) -> Iterator[object]:
    players: list[Player] = []

    def open_one(path: Path, **options: float) -> Player:
        players.append(Player(library, path, **options))
        return players[-1]

    yield open_one
    for player in players:
        library.touchfield_close(player.handle)


@pytest.mark.parametrize("name", [*VOXELS, *OBJECTS])
def test_forces_agree_with_the_python_player(open_player, library: ctypes.CDLL, name: str) -> None:
    points, expected_n = player_forces(stream_of(name), slow_way(name, TICKS), 0.5, **ENGINE)
    player = open_player(stream_of(name), force_max_n=0.5, **OPTIONS)
    library.touchfield_resume(player.handle)
    forces_n = player.forces_n(points)
    assert np.abs(forces_n).max() > 0.05
    np.testing.assert_allclose(forces_n, expected_n, atol=ATOL_N, rtol=0)


def test_thin_plate_resists_the_hand_until_a_stop(open_player, library: ctypes.CDLL, plate: Path) -> None:
    player = open_player(plate, force_max_n=3.3)
    library.touchfield_resume(player.handle)
    positions_m = press_plate()
    forces_n = player.forces_n(positions_m)
    assert_resists(forces_n, 3.3)
    library.touchfield_stop(player.handle)
    released_n = []
    while not library.touchfield_is_released(player.handle):
        released_n.append(player.tick(positions_m[-1]))
    assert_is_released(np.array(released_n), forces_n[-1], 3.3)


def test_orders_pause_seek_and_resume(open_player, library: ctypes.CDLL) -> None:
    player = open_player(stream_of("touch-block"))
    duration_s = library.touchfield_duration_s(player.handle)
    position_m = slow_way("touch-block", 10)[0]
    player.tick(position_m)
    player.tick(position_m)
    assert player.media_s == 0.0  # it does not play yet
    library.touchfield_resume(player.handle)
    player.forces_n(np.tile(position_m, (21, 1)))
    assert player.media_s == pytest.approx(0.020)
    library.touchfield_pause(player.handle)
    player.forces_n(np.tile(position_m, (5, 1)))
    paused_s = player.media_s
    player.forces_n(np.tile(position_m, (5, 1)))
    assert player.media_s == paused_s
    library.touchfield_resume(player.handle)
    library.touchfield_seek(player.handle, duration_s / 2)
    player.forces_n(np.tile(position_m, (3, 1)))
    assert duration_s / 2 <= player.media_s < duration_s / 2 + 0.004
    assert not library.touchfield_is_over(player.handle)
    player.forces_n(np.tile(position_m, (int(1000 * duration_s), 1)))
    assert library.touchfield_is_over(player.handle)


def test_options_and_files_are_refused_with_a_message(open_player, library: ctypes.CDLL) -> None:
    faulty = open_player(FAULTY)
    assert faulty.code and "end too early" in faulty.error
    assert not faulty.tick(np.zeros(3)).any()  # every call is safe
    player = open_player(stream_of("touch-block"))
    assert player.code == 0 and player.error == ""
    assert not library.touchfield_set(player.handle, b"friction", 0.1)  # it has started
    assert library.touchfield_start(player.handle) and player.error == ""
    assert not library.touchfield_set(faulty.handle, b"colour", 1.0)
    assert not library.touchfield_set(faulty.handle, b"friction", float("nan"))
    for wrong_n in (-1.0, 1e-7, 2e6):
        assert "greatest force" in open_player(stream_of("touch-block"), force_max_n=wrong_n).error
    assert "cannot be played" in open_player(stream_of("touch-block"), rate_hz=0.0).error


def test_head_of_the_medium(open_player, library: ctypes.CDLL) -> None:
    player = open_player(stream_of("touch-block"))
    assert library.touchfield_axes(player.handle).decode().startswith("x ")
    assert library.touchfield_force_max_n(player.handle) > 0


def test_c_sharp_declares_every_function_of_the_header() -> None:
    imported = {}
    for result, name, arguments in re.findall(
        r"static extern (\w+) (touchfield_\w+)\(([^;]*)\);", SOURCE, re.DOTALL
    ):
        kinds = [re.sub(r"\[\w.*\] ", "", a.strip()).rpartition(" ")[0] for a in arguments.split(",")]
        imported[name] = result, kinds
    expected = {
        name: (
            "IntPtr" if result == "const char *" else IN_CS[result],
            ["out TouchfieldVector" if kind == "double[]" else IN_CS[kind] for kind in arguments],
        )
        for name, (result, arguments) in declarations().items()
    }
    assert imported == expected and len(imported) > 15


def write_settings(folder: Path) -> None:
    """Let .NET run the program that Mono's compiler has made, in whatever version is there."""
    framework = {"name": "Microsoft.NETCore.App", "version": "3.1.0"}
    properties = {"System.Globalization.Invariant": True}  # it needs no library of languages
    options = {"rollForward": "LatestMajor", "framework": framework, "configProperties": properties}
    (folder / "try.runtimeconfig.json").write_text(json.dumps({"runtimeOptions": options}))


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(("mono",), marks=needs("mono")),
        pytest.param(("dotnet", "exec"), marks=needs("dotnet")),
    ],
)
def program(request: pytest.FixtureRequest, built: Path) -> list[object]:
    build_integration("unity", built, "CFLAGS=-O1", "try")
    write_settings(built)
    return ["env", f"LD_LIBRARY_PATH={built}", *request.param, built / "try.exe"]


@needs("mcs")
@pytest.mark.parametrize("name", ["touch-block", "objects-touch-deforming"])
def test_c_sharp_agrees_with_the_python_player(program: list[object], name: str) -> None:
    points, expected_n = player_forces(stream_of(name), slow_way(name, TICKS), 0.5, **ENGINE)
    forces_n, _ = ticks_of(*program, *ARGUMENTS, "-p", 0.5, stream_of(name), points=points)
    np.testing.assert_allclose(forces_n, expected_n, atol=ATOL_N, rtol=0)


@needs("mcs")
@pytest.mark.parametrize("clock", [[], ["-r"]])
def test_c_sharp_keeps_the_hand_out_of_a_thin_plate(
    program: list[object], plate: Path, clock: list[str]
) -> None:
    forces_n, released_n = ticks_of(*program, "-p", 3.3, *clock, plate, points=press_plate())
    assert_resists(forces_n, 3.3)
    assert_is_released(released_n, forces_n[-1], 3.3)


@needs("mcs")
def test_force_ramps_to_zero_if_the_device_fails(program: list[object], plate: Path) -> None:
    points = press_plate()
    done_n, _ = ticks_of(*program, "-p", 3.3, "-r", "-f", 600, plate, points=points)
    assert done_n[599].any() and 605 < len(done_n) < 700
    assert_is_released(done_n[600:], done_n[599], 3.3)


@needs("mcs")
def test_physics_steps_render_the_ticks_between_them(program: list[object], plate: Path) -> None:
    points = slide_on_plate()[::20]
    forces_n, _ = ticks_of(*program, "-p", 3.3, "-m", 0.3, "-a", 20, plate, points=points)
    assert (forces_n[20:, 2] > 0.5).all()
    every_tick_n = np.repeat(forces_n, 20, axis=0)
    assert_has_friction(every_tick_n, 0.3)


@needs("mcs")
def test_damaged_file_is_refused_with_a_message(program: list[object]) -> None:
    done = run(*program, FAULTY)
    assert done.returncode == 65 and "end too early" in done.stderr


@needs("mcs")
def test_a_missing_file_or_none_is_one_line(program: list[object]) -> None:
    done = run(*program, "nowhere.touch")
    assert (
        done.returncode == 66 and done.stderr.startswith("nowhere.touch: ") and done.stderr.count("\n") == 1
    )
    done = run(*program)
    assert done.returncode == 64 and done.stderr.startswith("try.exe: ") and done.stderr.count("\n") == 1


@needs("mcs")
def test_the_component_compiles(tmp_path: Path) -> None:
    files = [INTEGRATIONS / "unity" / "Touchfield.cs", Path(__file__).parent / "UnityEngine.cs"]
    options = ["-warnaserror", "-target:library", "-define:UNITY_5_3_OR_NEWER", f"-out:{tmp_path / 'u.dll'}"]
    done = run("mcs", *options, *files)
    assert done.returncode == 0, done.stdout + done.stderr
