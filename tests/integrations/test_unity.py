"""The C# file for Unity: its structs have C's layout, and with Mono it computes the forces of Python."""

from __future__ import annotations

import platform
import re
from pathlib import Path

import numpy as np
import pytest
from builders import (
    FAULTY,
    INTEGRATIONS,
    ROOT,
    build_integration,
    needs,
    python_forces,
    query_program,
    run,
    stream_of,
)

pytestmark = needs("make", "cc")
SOURCE = (INTEGRATIONS / "unity" / "Touchfield.cs").read_text()
HEADER = (ROOT / "c" / "touch.h").read_text().partition("#endif\n#endif")[0]
"""Declarations of the reader."""
PLAYING = HEADER.partition("/* Codes on their own")[0]
"""Those that playing a medium needs."""
BASIC = {"double": (8, 8), "ulong": (8, 8), "IntPtr": (8, 8), "uint": (4, 4), "int": (4, 4)}
Layouts = dict[str, tuple[int, ...]]


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_integration("unity", tmp_path_factory.mktemp("unity"), "CFLAGS=-O1")


def parse_layouts(text: str) -> Layouts:
    """Lines `name number ...`."""
    return {fields[0]: tuple(map(int, fields[1:])) for fields in map(str.split, text.splitlines())}


def layouts_of_cs() -> Layouts:
    """Sizes and offsets under `LayoutKind.Sequential`: each field at a multiple of its alignment."""
    sizes, out = dict(BASIC), {}
    for name, body in re.findall(
        r"LayoutKind\.Sequential\)\]\s+public struct (\w+)\s+{(.*?)}", SOURCE, re.DOTALL
    ):
        end, widest = 0, 1
        for kind, fields in re.findall(r"public (\w+) ([^;]+);", body):
            size, alignment = sizes[kind]
            for field in fields.split(","):
                start = -(-end // alignment) * alignment
                out[f"{name}.{field.strip().lstrip('@')}"] = start, size
                end, widest = start + size, max(widest, alignment)
        sizes[name] = -(-end // widest) * widest, widest
        out[name] = (sizes[name][0],)
    return {name: layout for name, layout in out.items() if name.startswith("touch_")}


@pytest.mark.skipif(
    platform.machine() not in ("x86_64", "aarch64"), reason="pointers here are of another size"
)
def test_structs_have_the_layout_of_c(built: Path) -> None:
    in_c = parse_layouts(run(built / "layouts").stdout)
    assert in_c == layouts_of_cs()
    assert set(re.findall(r"^} (touch_\w+);", PLAYING, re.MULTILINE)) == {n for n in in_c if "." not in n}


def test_every_function_that_plays_is_declared() -> None:
    functions = set(re.findall(r"^\w+ (touch_\w+)\(", PLAYING, re.MULTILINE))
    named = set(re.findall(r"static extern \w+ (touch_\w+)\(", SOURCE))
    assert PLAYING != HEADER and len(functions) > 8 and functions == named


@pytest.fixture(scope="module")
def program(built: Path) -> list[object]:
    build_integration("unity", built, "CFLAGS=-O1", "try")
    return ["env", f"LD_LIBRARY_PATH={built}", "mono", built / "try.exe"]


@needs("mono", "mcs")
def test_mono_has_the_layout_of_c(built: Path, program: list[object]) -> None:
    of_mono = parse_layouts(run(*program, "--layouts").stdout)
    assert {n: v for n, v in of_mono.items() if n.startswith("touch_")} == parse_layouts(
        run(built / "layouts").stdout
    )


@needs("mono", "mcs")
@pytest.mark.parametrize("name", ["touch-block", "objects-touch-deforming"])
def test_forces_agree_with_python(program: list[object], name: str) -> None:
    frames, points, forces = query_program(name, [*program, stream_of(name), 0.5], 100)
    np.testing.assert_allclose(forces, python_forces(name, frames, points, 0.5), atol=1e-5, rtol=0)
    assert np.linalg.norm(forces, axis=-1).max() == pytest.approx(0.5)


@needs("mono", "mcs")
def test_damaged_file_is_refused_with_a_message(program: list[object]) -> None:
    done = run(*program, FAULTY)
    assert done.returncode == 65 and "end too early" in done.stderr


@needs("mono", "mcs")
def test_the_component_compiles(tmp_path: Path) -> None:
    files = [INTEGRATIONS / "unity" / "Touchfield.cs", Path(__file__).parent / "UnityEngine.cs"]
    options = ["-warnaserror", "-target:library", "-define:UNITY_5_3_OR_NEWER", f"-out:{tmp_path / 'u.dll'}"]
    done = run("mcs", *options, *files)
    assert done.returncode == 0, done.stdout + done.stderr
