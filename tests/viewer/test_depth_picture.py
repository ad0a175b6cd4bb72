"""The page makes a file of a depth picture. Its field is that of Python's height map of the same picture, and
what the page cannot read is refused with an explanation.
"""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import ROOT, drive, needs_browser, step

import touchfield as tf
from touchfield.pipeline.preparation import Prepared, prepare
from touchfield.sources.camera import CodedSequence, DepthCode, Intrinsics
from touchfield.sources.images.pictures import ArrayFrames
from touchfield.sources.options import SourceOptions
from touchfield.sources.terrain.height_scene import HeightScene

pytestmark = needs_browser

SOLID = ROOT / "conformance" / "v1" / "touch-solid.touch"
SAVED = "!document.getElementById('saved').textContent.startsWith('Saving')"
PNG = b"\x89PNG\r\n\x1a\n"
TOLERANCE_N = 1e-6
"""Beyond the error bound: sums of the page are in another order than those of Python."""


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
    return png_of(struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, interlaced), bytes(out))


def png_of(head: bytes, rows: bytes) -> bytes:
    """A PNG of filtered rows, in two chunks IDAT."""
    body = zlib.compress(rows, 9)
    parts = [chunk(b"IHDR", head), chunk(b"IDAT", body[:40]), chunk(b"IDAT", body[40:]), chunk(b"IEND", b"")]
    return PNG + b"".join(parts)


def _filtered(row: bytes, above: bytes, kind: int, step_bytes: int) -> bytes:
    """One row after a filter of the PNG specification."""
    now, up = np.frombuffer(row, np.uint8).astype(int), np.frombuffer(above, np.uint8).astype(int)
    left, corner = (np.concatenate([np.zeros(step_bytes, int), v[:-step_bytes]]) for v in (now, up))
    near_left, near_up, near_corner = abs(up - corner), abs(left - corner), abs(left + up - 2 * corner)
    paeth = np.where(near_up <= near_corner, up, corner)
    paeth = np.where((near_left <= near_up) & (near_left <= near_corner), left, paeth)
    predicted = {1: left, 2: up, 3: (left + up) // 2, 4: paeth}.get(kind, 0)
    return ((now - predicted) % 256).astype(np.uint8).tobytes()


def scene_mm(height: int = 90, width: int = 120) -> np.ndarray:
    """A wavy wall with a step, a box in front of it, and pixels without depth, uint16 millimetres."""
    v, u = np.mgrid[0:height, 0:width]
    depth = 1500 + 250 * np.sin(u / 17) * np.cos(v / 13) + 3 * u
    depth[30:60, 50:90] = 900 + 2 * v[30:60, 50:90]
    depth[70:, 60:] += 150  # less than a fifth of the median depth
    depth[:9, :14] = 0
    depth[70:74, 20] = 0xFFFF
    depth[-1, -1] = 0
    return depth.astype(np.uint16)


def encoded_by_python(picture: Path, size: tuple[int, int], units_per_m: float) -> Prepared:
    """What `touchfield encode --reading height` makes of a picture of `size`, width and height."""
    focal, middle = 525 / 640 * size[0], [(n - 1) / 2 for n in size]
    camera = f"{focal},{focal},{middle[0]},{middle[1]}"
    options = SourceOptions("depth-map", units_per_m, camera, reading="height")
    return prepare(picture, tf.EncodeSpec(source=options))


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
    prepared = encoded_by_python(picture, (120, 90), 1000)
    expected, placement = prepared.medium[0], prepared.placement
    assert len(expected.bricks) > 500
    assert 0.1 < largest_ratio(stream, expected, 0.02, 0.01) <= 1
    unknown = int((depth == 0).sum() + (depth == 0xFFFF).sum())
    assert answers[2].startswith("Recorded depth.png: 120 × 90 pixels (16 bits, millimetres), depth ")
    assert f"{unknown} pixels without depth, grid 128 × 128 × 128" in answers[2]
    assert answers[3]["state"] == "ready" and answers[3]["triangles"] > 100
    assert answers[6] == "depth-0.touch" and answers[8].startswith("Saved depth-0.touch")
    with tf.open_stream(stream) as opened:
        head = opened.reader.head
        assert head.mapping_scale == pytest.approx(placement.scale, rel=1e-12)
        assert head.mapping_offset_m == pytest.approx(placement.offset_m, abs=1e-12)
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
    expected = encoded_by_python(picture, (80, 61), units_per_m).medium[0]
    assert 0.1 < largest_ratio(stream, expected, 0.05, 0.02) <= 1


def test_eight_bits_and_few_depths(page: str, tmp_path: Path) -> None:
    """Of a file without a known ending. Python refuses 8 bits: its height map is built from the array."""
    grey, flat, halves = (scene_mm(40, 50) // 16).astype(np.uint8), np.full((12, 20), 77), np.full((8, 9), 90)
    halves[:, :4], halves[:4, 4] = 201, 201
    for name, values in (
        ("grey", grey),
        ("flat", flat.astype(np.uint8)),
        ("halves", halves.astype(np.uint8)),
    ):
        picture, (height, width) = tmp_path / f"{name}.dat", values.shape
        picture.write_bytes(png(values, (2, 4, 1)))
        focal = 525 / 640 * width
        camera = Intrinsics(focal, focal, (width - 1) / 2, (height - 1) / 2)
        frames = ArrayFrames(values[None])
        sequence = CodedSequence(name, frames, DepthCode(1000), camera, 30.0)
        expected = prepare(HeightScene.from_depth_sequence(sequence)).medium[0]
        stream, answers = record(page, tmp_path, picture, 0.05, 0.02)
        assert "(8 bits, millimetres)" in answers[2]
        assert len(expected.bricks) > 100
        assert 0.1 < largest_ratio(stream, expected, 0.05, 0.02) <= 1


def test_a_picture_is_chosen_by_the_keyboard_and_replaced(page: str, tmp_path: Path) -> None:
    """After it, a file is saved as what it is, and not as the picture."""
    picture, first, second = tmp_path / "Kitchen.PNG", tmp_path / "first.touch", tmp_path / "second.touch"
    picture.write_bytes(png(scene_mm(24, 32)))
    result = drive(
        tmp_path,
        step("goto", url=page),
        step("choose", key="o", file=picture),
        step("text", id="saved"),
        step("download", id="save-frame", path=str(first), key="Enter"),
        step("open", file=SOLID),
        step("text", id="saved"),
        step("download", id="save-frame", path=str(second)),
    )
    assert result.errors == []
    assert result.answers[2].startswith("Recorded Kitchen.PNG: 32 × 24 pixels")
    assert result.answers[3] == "Kitchen-0.touch" and result.answers[5] == ""
    with tf.open_stream(first) as opened:
        head = opened.reader.head
        assert (head.weber_fraction, head.force_threshold_n) == (0.1, 0.05)
    with tf.open_stream(second) as opened, tf.open_stream(SOLID) as solid:
        assert opened.reader.provenance["source"].startswith("frame 0 of touch-solid.touch")
        assert opened.grid == solid.grid


def refused() -> dict[str, tuple[bytes, str]]:
    """Files that are no picture of depth, by name, and a text of the message."""
    depth, whole = scene_mm(20, 30), png(scene_mm(20, 30), (4,))
    grey = struct.pack(">IIBBBBB", 30, 20, 16, 0, 0, 0, 0)
    damaged, head = bytearray(whole), bytearray(whole)
    damaged[-40] ^= 0x55
    head[17] ^= 1
    colour = np.zeros((4, 5, 3), np.uint8)
    large = struct.pack(">IIBBBBB", 4097, 8, 16, 0, 0, 0, 0)
    return {
        "colour.png": (png(colour, colour=2), "a PNG of RGB, 8 bits; the page reads one grey channel"),
        "palette.png": (png(colour[..., 0], colour=3), "a PNG of a palette, 8 bits"),
        "interlaced.png": (png(depth, interlaced=1), "16 bits, interlaced"),
        "large.png": (png_of(large, b""), "a picture of 4097 × 8 pixels; the page takes at most 4096 × 4096"),
        "thin.png": (png(depth[:1]), "a picture of 30 × 1 pixels; a surface needs 2 × 2"),
        "nothing.png": (png(0 * depth), "no pixel with depth"),
        "short.png": (whole[:20], "cut after 20 bytes"),
        "cut.png": (whole[:-30], "cut within the chunk"),
        "endless.png": (whole[:-12], "without its end (IEND)"),
        "byte.png": (bytes(damaged), "do not inflate"),
        "head.png": (bytes(head), "another CRC-32"),
        "few.png": (png_of(grey, bytes(500)), "inflate to 500 of 1220 bytes"),
        "bomb.png": (png_of(grey, bytes(1 << 27)), "do not inflate to 1220 bytes"),
        "filter.png": (png(depth, (0, 0, 0, 9)), "unknown filter 9 in row 3"),
        "text.png": (b"no picture", "the page reads PNG and .npy files"),
        "int.npy": (npy(depth.astype(np.int64)), "type i8, shape (20, 30)"),
        "frames.npy": (npy(depth[None]), "type u2, shape (1, 20, 30)"),
        "records.npy": (npy(np.zeros(3, [("z", "<f4")])), "of records"),
        "wide.npy": (npy(np.zeros((2, 4097), np.uint16)), "4097 × 2 pixels"),
        "cut.npy": (npy(depth)[:-1], "of 1327 bytes where 1328 are due"),
        "head.npy": (npy(depth)[:60], "cut within its head"),
        "short.npy": (npy(depth)[:7], "cut after 7 bytes"),
        "none.npy": (npy(np.full((3, 4), np.nan)), "no pixel with depth"),
        "unreadable.npy": (npy(depth).replace(b"fortran", b"FORTRAN"), "head is not readable"),
    }  # fmt: skip


def npy(values: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, values)
    return file.getvalue()


def test_what_is_no_picture_of_depth_is_refused(page: str, tmp_path: Path) -> None:
    cases, good = refused(), tmp_path / "good.png"
    good.write_bytes(png(scene_mm(20, 30)))
    steps = [step("goto", url=page)]
    for name, (data, _) in cases.items():
        (tmp_path / name).write_bytes(data)
        steps += [step("drop", file=tmp_path / name), step("text", id="fault"), step("text", id="saved")]
    steps += [step("press", key="p"), step("text", id="saved"), step("drop", file=good), step("state")]
    result = drive(tmp_path, *steps)
    assert result.errors == []
    for (name, (_, text)), fault, saved in zip(
        cases.items(), result.answers[2::3], result.answers[3::3], strict=False
    ):
        assert fault.startswith(f"{name} cannot be shown: ") and text in fault, (name, fault)
        assert "Error" not in fault, fault
        assert saved == f"Cannot be saved: {name} cannot be shown.", saved
    assert result.answers[-3].startswith("Cannot be saved")
    assert result.answers[-1]["state"] == "ready"


def test_damaged_pictures_end_in_a_message_or_a_field(page: str, tmp_path: Path) -> None:
    rng, steps = np.random.default_rng(7), [step("goto", url=page)]
    whole = [png(scene_mm(20, 30), (0, 1, 2, 3, 4)), npy(scene_mm(20, 30)), npy(scene_mm(20, 30) / 1000)]
    for i in range(90):
        data = bytearray(whole[i % 3])
        for at in rng.integers(0, (len(data), 128)[i % 2], 1 + i % 4):
            data[at] = rng.integers(256)
        path = tmp_path / f"{i}.{('png', 'npy', 'npy')[i % 3]}"
        path.write_bytes(data[: rng.integers(len(data)) if i % 5 == 0 else None])
        steps += [step("drop", file=path), step("state")]
    result = drive(tmp_path, *steps)
    assert result.errors == []
    states = [answer["state"] for answer in result.answers[2::2]]
    assert set(states) == {"ready", "fault"} and len(states) == 90
