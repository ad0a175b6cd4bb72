"""The page makes a file of a depth picture: its field is that of Python's height map of the picture, and what cannot be
read is refused with an explanation.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import drive, needs_browser

import touchfield as tf
from touchfield.devices import device
from touchfield.pipeline.placement import mapping_of
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import open_source
from touchfield.viewer.browser import empty_page

pytestmark = needs_browser

SAVED = "!document.getElementById('saved').textContent.startsWith('Saving')"
TOLERANCE_N = 1e-4
"""Beyond the error bound: sums of the page are in another order than those of Python."""


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The address of the page without a file."""
    path = tmp_path_factory.mktemp("page") / "page.html"
    path.write_text(empty_page(), encoding="utf-8")
    return path.as_uri()


def step(do: str, **arguments: Any) -> dict[str, Any]:
    return {"do": do, **arguments}


def chunk(tag: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + tag + data + struct.pack(">I", zlib.crc32(tag + data))


def png(
    values: np.ndarray, filters: tuple[int, ...] = (0,), *, colour: int = 0, interlaced: int = 0
) -> bytes:
    """A PNG of uint8 or uint16 values [height, width]; row y has the filter filters[y % len(filters)]."""
    height, width = values.shape[:2]
    bits = 8 * values.dtype.itemsize
    step_bytes = values.dtype.itemsize * (values.shape[2] if values.ndim == 3 else 1)
    rows = values.astype(values.dtype.newbyteorder(">")).tobytes()
    stride, out, above = len(rows) // height, bytearray(), bytes(len(rows) // height)
    for y in range(height):
        row, kind = rows[y * stride : (y + 1) * stride], filters[y % len(filters)]
        out += bytes([kind]) + _filtered(row, above, kind, step_bytes)
        above = row
    head = struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, interlaced)
    body, middle = zlib.compress(bytes(out)), 40
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", head)
        + chunk(b"IDAT", body[:middle])
        + chunk(b"IDAT", body[middle:])
        + chunk(b"IEND", b"")
    )


def _filtered(row: bytes, above: bytes, kind: int, step_bytes: int) -> bytes:
    """One row after a filter of the PNG specification."""
    now, up = np.frombuffer(row, np.uint8).astype(int), np.frombuffer(above, np.uint8).astype(int)
    left, corner = (np.concatenate([np.zeros(step_bytes, int), v[:-step_bytes]]) for v in (now, up))
    away = [abs(up - corner), abs(left - corner), abs(left + up - 2 * corner)]
    paeth = np.where(
        (away[0] <= away[1]) & (away[0] <= away[2]), left, np.where(away[1] <= away[2], up, corner)
    )
    return ((now - [0 * now, left, up, (left + up) // 2, paeth][kind]) % 256).astype(np.uint8).tobytes()


def scene_mm(height: int = 90, width: int = 120) -> np.ndarray:
    """A wavy wall with a step, a box in front of it, and pixels without depth, uint16 millimetres."""
    v, u = np.mgrid[0:height, 0:width]
    depth = 1500 + 250 * np.sin(u / 17) * np.cos(v / 13) + 3 * u
    depth[30:60, 50:90] = 900 + 2 * v[30:60, 50:90]
    depth[:9, :14] = 0
    depth[70:74, 20] = 0xFFFF
    depth[-1, -1] = 0
    return depth.astype(np.uint16)


def python_field(path: Path, units_per_m: float, kind: str = "depth-map") -> tuple[tf.ForceField, Any]:
    """The field of Python's height map of the picture on the page's lattice, and its mapping."""
    with path.open("rb") as stream:
        width = (
            np.load(stream).shape[1] if path.suffix == ".npy" else struct.unpack(">8x8xI", stream.read(20))[0]
        )
    height = (
        np.load(path).shape[0] if path.suffix == ".npy" else struct.unpack(">I", path.read_bytes()[20:24])[0]
    )
    camera = f"{525 / 640 * width},{525 / 640 * width},{(width - 1) / 2},{(height - 1) / 2}"
    options = SourceOptions(kind=kind, depth_scale=units_per_m, intrinsics=camera, reading="height")
    scene = open_source(path, options)
    mapping = mapping_of(scene, device("phantom-omni"), tf.EncodeSpec())
    law = mapping.profile.rescaled(mapping.placement.scale)
    return scene.field(0, mapping.placement.to_scene(mapping.grid), law).on_grid(mapping.grid), mapping


def record(
    page: str, folder: Path, picture: Path, k: float, f0_n: float, how: str = "drop"
) -> tuple[Path, Any]:
    """The file that the page saves of a picture, with a bound other than the default, and all answers."""
    out = folder / "saved.touch"
    result = drive(
        folder,
        step("goto", url=page),
        step(how, file=picture),
        step("text", id="saved"),
        step("state"),
        step("fill", id="save-k", value=str(100 * k)),
        step("fill", id="save-f0", value=str(f0_n)),
        step("download", id="save-frame", path=str(out)),
        step("until", code=SAVED),
        step("text", id="saved"),
        step("text", id="fault"),
    )
    assert result.errors == [] and result.answers[9] == "", result.answers
    return out, result.answers


def largest_ratio(stream: Path, expected: tf.ForceField, k: float, f0_n: float) -> float:
    """Largest |error| - tolerance as a fraction of max(F_0, k |F|)."""
    medium = tf.decode(stream)
    assert len(medium) == 1 and medium.grid.is_close(expected.grid)
    true = expected.to_dense().astype(np.float64)
    error = np.linalg.norm(medium[0].to_dense() - true, axis=-1)
    return float(((error - TOLERANCE_N) / np.maximum(f0_n, k * np.linalg.norm(true, axis=-1))).max())


def test_a_dropped_png_becomes_the_field_of_python(page: str, tmp_path: Path) -> None:
    picture, depth = tmp_path / "depth.png", scene_mm()
    picture.write_bytes(png(depth, (0, 1, 2, 3, 4)))
    stream, answers = record(page, tmp_path, picture, 0.02, 0.01)
    expected, mapping = python_field(picture, 1000)
    assert len(expected.bricks) > 500
    assert 0.1 < largest_ratio(stream, expected, 0.02, 0.01) <= 1
    unknown = int((depth == 0).sum() + (depth == 0xFFFF).sum())
    assert answers[2].startswith("Recorded depth.png: 120 × 90 pixels (16 bits, millimetres), depth ")
    assert f"{unknown} pixels without depth, grid 128 × 128 × 128" in answers[2]
    assert answers[3]["state"] == "ready" and answers[3]["triangles"] > 100
    assert answers[6] == "depth-0.touch" and answers[8].startswith("Saved depth-0.touch")
    with tf.open_stream(stream) as opened:
        head = opened.reader.head
        assert head.mapping_scale == pytest.approx(mapping.placement.scale, rel=1e-12)
        assert head.mapping_offset_m == pytest.approx(mapping.placement.offset_m, abs=1e-12)
        assert (head.weber_fraction, head.force_threshold_n) == (0.02, 0.01)
        assert (head.axes, head.device_name, head.force_max_n, head.tags) == (
            "x right, y down, z forward",
            "phantom-omni",
            3.3,
            ("direct",),
        )
        assert opened.reader.provenance["source"] == "depth.png, recorded by the page"


@pytest.mark.parametrize(
    ("kind", "order", "units_per_m"),
    [("<u2", "C", 1000), (">f4", "C", 1), ("<f8", "F", 1)],
)
def test_an_opened_npy_becomes_the_field_of_python(
    page: str, tmp_path: Path, kind: str, order: Any, units_per_m: float
) -> None:
    picture, depth = tmp_path / "depth.npy", scene_mm(61, 80)
    values = depth.astype(kind) if units_per_m > 1 else np.where(depth == 0xFFFF, np.nan, depth / 1000)
    np.save(picture, np.asarray(values.astype(kind), order=order))
    stream, _ = record(page, tmp_path, picture, 0.05, 0.02, "open")
    expected, _ = python_field(picture, units_per_m)
    assert 0.1 < largest_ratio(stream, expected, 0.05, 0.02) <= 1
