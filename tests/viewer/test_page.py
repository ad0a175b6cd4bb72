"""The page equals the build of its sources, is small, allows no scripts or networks, and is filled
in by Python.
"""

from __future__ import annotations

import base64
import gzip
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from graphlib import TopologicalSorter
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from browser import ROOT

import touchfield as tf
from touchfield.cli.main import _exit_code
from touchfield.errors import InvalidArgument
from touchfield.tasks.view import fine_source
from touchfield.viewer.browser import empty_map_page, empty_page, page_of
from touchfield.viewer.timeline import empty_timeline

WEB = ROOT / "web"
GOLDEN = ROOT / "conformance" / "v1"
PAGE_GZ, WASM_GZ = 204_000, 91_500  # the module has decoder, encoder and receiver
TIMELINE_GZ = 24_000
MAP_GZ = 24_000

HEADERS = (
    "cells", "effects", "encode", "friction", "log", "media_clock", "model", "play", "proxy",
    "proxy_damping", "proxy_jump", "proxy_search", "query", "receiver", "render", "seam", "segment_blend",
    "settings", "shared", "slopes", "timing", "tool", "vector", "write",
)  # fmt: skip


def sources() -> list[str]:
    """The sources named by build.mjs."""
    names = [
        "../c/touch.h",
        *(f"../c/touch_{name}.h" for name in HEADERS),
        "build.mjs",
        "build_wasm.sh",
        "hand.c",
        "map.css",
        "map.html",
        "package-lock.json",
        "page.css",
        "page.h",
        "page.html",
        "record.h",
        "relief.h",
        "surface.h",
    ]
    folders = [f"{p.parent.name}/{p.name}" for p in sorted((WEB / "freestanding").iterdir())]
    return [
        *names,
        "three_core.mjs",
        "timeline.css",
        "timeline.html",
        "touch_wasm.c",
        "unused_methods.mjs",
        *folders,
        *(f"src/{p.name}" for p in sorted((WEB / "src").glob("*.ts"))),
        *(f"src/page/{p.name}" for p in sorted((WEB / "src" / "page").glob("*.ts"))),
    ]


PAGES = {"page.html": empty_page, "map.html": empty_map_page, "timeline.html": empty_timeline}


@pytest.mark.parametrize("page", PAGES.values(), ids=PAGES)
def test_a_page_is_built_from_the_current_sources(page: Callable[[], str]) -> None:
    digest = hashlib.sha256()
    for name in sources():
        digest.update(name.encode() + b"\0" + (WEB / name).read_bytes() + b"\0")
    recorded = re.search(r'name="touchfield-sources" content="([0-9a-f]{64})"', page())
    assert recorded and recorded[1] == digest.hexdigest(), "web/ or c/touch.h has changed: make web"


def test_building_again_gives_the_same_pages(tmp_path: Path) -> None:
    if shutil.which("node") is None or not (WEB / "node_modules" / "esbuild").is_dir():
        pytest.skip("node and web/node_modules are not here: make web")
    if find_spec("ziglang") is None and "TOUCHFIELD_ZIG_PYTHON" not in os.environ:
        pytest.skip("zig is not here: pip install 'touchfield[web]'")
    python = os.environ.get("TOUCHFIELD_ZIG_PYTHON", sys.executable)
    command = ["node", "build.mjs", str(tmp_path)]
    done = subprocess.run(
        command, cwd=WEB, env={**os.environ, "PYTHON": python}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    for name, page in PAGES.items():
        assert (tmp_path / name).read_text(encoding="utf-8") == page()


def test_the_parts_of_the_page_import_each_other_in_one_direction() -> None:
    files = [WEB / "src" / "main.ts", *(WEB / "src" / "page").glob("*.ts")]
    imports = {
        path: {
            (path.parent / f"{name}.ts").resolve()
            for name in re.findall(r'from "(\.[^"]+)"', path.read_text())
        }
        for path in files
    }
    order = [path for path in TopologicalSorter(imports).static_order() if path in imports]
    assert order[-1] == files[0], "a part of the page imports main.ts"
    assert len(order) == len(files) > 20


def test_the_page_is_small() -> None:
    packed = re.search(r'id="decoder">([^<]+)<', empty_page())
    assert packed and len(base64.b64decode(packed[1])) < WASM_GZ
    assert len(gzip.compress(empty_page().encode(), 9)) < PAGE_GZ
    assert len(gzip.compress(empty_timeline().encode(), 9)) < TIMELINE_GZ
    assert len(gzip.compress(empty_map_page().encode(), 9)) < MAP_GZ


@pytest.mark.parametrize("empty", PAGES.values(), ids=PAGES)
def test_a_page_allows_only_its_script_and_no_network(empty: Callable[[], str]) -> None:
    page = empty()
    policy = re.search(r'Content-Security-Policy" content="([^"]+)"', page)
    assert policy is not None
    rules = dict(rule.strip().split(" ", 1) for rule in policy[1].split(";"))
    assert rules["default-src"] == rules["connect-src"] == "'none'"
    assert "unsafe-inline" not in policy[1] and "'unsafe-eval'" not in policy[1]
    script = page[page.rindex("<script>") + 8 : page.rindex("</script>")]
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"'sha256-{digest}'" in rules["script-src"]
    markup = page.replace(script, "")
    assert not re.search(
        r"\son\w+=|<(link|iframe|img)\b|(src|href)=", re.sub(r'id="\w+">[^<]+</script', "", markup)
    )


def test_foreign_texts_are_escaped() -> None:
    page = page_of(b"abc", '"><script>alert(1)</script>', {"mode": "</script><script>alert(2)</script>"})
    assert page.count("<script") == empty_page().count("<script")
    assert "alert(1)</script>" not in page and base64.b64encode(b"abc").decode() in page


def test_view_states_the_error_bound_of_the_file() -> None:
    page = tf.view(GOLDEN / "touch-mask.touch")
    assert page.figures["mode"] == "mask" and page.figures["promise_kept"]
    assert 'data-name="touch-mask.touch"' in page.html
    figures = re.search(r'id="given-figures">(.*?)</script>', page.html)
    assert figures and json.loads(figures[1])["mode"] == "mask"
    assert page._repr_html_().startswith("<iframe srcdoc=")


def test_the_command_writes_and_opens(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stream, out, opened = str(GOLDEN / "touch-mask.touch"), tmp_path / "page.html", []
    monkeypatch.setattr("webbrowser.open", opened.append)
    assert _exit_code(["view", stream, "--out", str(out), "--no-open"]) == 0
    assert out.read_text(encoding="utf-8") == tf.view(stream).html and not opened
    assert _exit_code(["view", stream, "--out", str(out)]) == 0
    assert opened == [out.as_uri()]
    assert _exit_code(["view", stream]) == 0
    assert opened[1].endswith("/page.html")
    assert _exit_code(["view", stream, "--no-open"]) == 2


def test_a_page_states_the_capacity_of_devices(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The figures are those of the command `measure`; a page of a file alone has none."""
    stream, out = GOLDEN / "touch-solid.touch", tmp_path / "page.html"
    names = ("phantom-omni", "tshirt-32x32")
    options = [word for name in names for word in ("--device", name)]
    assert _exit_code(["view", str(stream), *options, "--out", str(out), "--no-open", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert _exit_code(["measure", str(stream), *options, "--no-limits", "--json"]) == 0
    expected = json.loads(capsys.readouterr().out)
    assert report["entropy_voxel_bits"] == expected["entropy_voxel"]["value"]
    assert report["entropy_frame_bits"] == expected["entropy_frame"]["value"]
    for name in names:
        of_page, found = report["capacity"][name], expected["capacity"][name]
        assert [of_page["capacity_bits"], of_page["wmr"], of_page["hil"]] == [
            found[key]["value"] for key in ("capacity", "wmr", "hil")
        ]
    within = re.search(r'id="given-figures">(.*?)</script>', out.read_text(encoding="utf-8"))
    assert within and json.loads(within[1])["capacity"] == report["capacity"]
    assert "capacity" not in tf.view(stream).figures
    assert "capacity" in tf.view(tf.decode(stream), devices=names[:1]).figures
    assert (
        _exit_code(["view", str(GOLDEN / "touch-empty.touch"), *options, "--out", str(out), "--no-open"]) == 2
    )


def test_a_page_with_the_source_states_its_bytes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    grid = tf.Grid((16, 16, 8), (0.005, 0.005, 0.005), (-0.0375, -0.0375, -0.0175))
    force = np.zeros((16, 16, 8, 3), np.float32)
    force[4:12, 4:12, 2:6, 2] = 1.0
    source, stream, out = (str(tmp_path / name) for name in ("field.npz", "block.touch", "page.html"))
    tf.write_field(source, tf.HapticMedium.from_array(force, grid))
    tf.encode(source, stream, tf.EncodeSpec(nw=4))
    assert _exit_code(["export", stream, out, "--source", source, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    within = re.search(r'id="given-source">([^<]+)<', Path(out).read_text(encoding="utf-8"))
    assert within and len(base64.b64decode(within[1])) == report["source_bytes"] > 0
    assert _exit_code(["export", stream, str(tmp_path / "drives.hjif"), "--source", source]) == 2
    assert _exit_code(["view", stream, "--source", source, "--out", source, "--no-open"]) == 2
    assert list(tf.view(stream, source).figures["capacity"]) == ["phantom-omni"]

    def source_fraction(max_bytes: int) -> float:
        monkeypatch.setattr("touchfield.tasks.view.MAX_SOURCE_BYTES", max_bytes)
        with tf.open_stream(stream) as opened:
            return fine_source(source, opened).error_fraction

    assert [source_fraction(report["source_bytes"] - n) for n in (0, 1)] == pytest.approx([0.1, 0.3])
    with pytest.raises(InvalidArgument, match="at most 100 in a page"):
        source_fraction(100)
    tf.encode(source, stream, tf.EncodeSpec(nw=4, touch=tf.codec.TouchSpec(k=0.002, f0_n=0.01)))
    assert source_fraction(1 << 20) == pytest.approx(0.5), "no finer than k = 0.001"
    nothing = tf.HapticMedium.from_frames([tf.ForceField.empty(grid)], 30.0)
    tf.encode(nothing, tmp_path / "nothing.touch", allow_empty=True)
    assert "capacity" not in tf.view(tmp_path / "nothing.touch", nothing).figures
    other = str(tmp_path / "other.npz")
    tf.write_field(
        other, tf.HapticMedium.from_array(force[:8], tf.Grid((8, 16, 8), grid.spacing_m, grid.origin_m))
    )
    assert _exit_code(["view", stream, "--source", other, "--out", out, "--no-open"]) == 2
    assert "Name its own source" in capsys.readouterr().err


def test_the_coder_paper_is_refused_with_a_remedy() -> None:
    with pytest.raises(InvalidArgument, match=r"touchfield encode .* NEW\.touch"):
        tf.view(GOLDEN / "paper-dct.touch")


def test_a_medium_shows_itself_in_a_notebook() -> None:
    grid = tf.Grid((16, 16, 8), (0.005, 0.005, 0.005), (-0.0375, -0.0375, -0.0175))
    force = np.zeros((40, 16, 16, 8, 3), np.float32)
    force[:, 4:12, 4:12, 2:6, 2] = 1.0
    page = tf.view(tf.HapticMedium.from_array(force, grid))
    assert page.figures["frames_of"] == 40
    assert "frames_of" not in tf.view(tf.HapticMedium.from_array(force[:30], grid)).figures
    assert "given-medium" in tf.HapticMedium.from_array(force[:1], grid)._repr_html_()
