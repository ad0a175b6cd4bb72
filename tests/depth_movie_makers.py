"""Depth over time with a known truth, as arrays, videos of depth and folders of pictures."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from touchfield.sources.depth.movie_depth import MovieDepth

Depths = Sequence[NDArray[np.float64]]
WIDTH, HEIGHT, FOCAL_PX = 160, 120, 150.0
ROWS, COLUMNS = 4, 4
RATE_HZ = 30


def room() -> NDArray[np.float64]:
    """A wall at 10 m, a floor, and a cupboard at 3 m on the left: metres, [HEIGHT, WIDTH]."""
    depth = np.full((HEIGHT, WIDTH), 10.0)
    rows = np.arange(90, HEIGHT)
    depth[90:] = np.minimum(10.0, 1.4 * FOCAL_PX / (rows - 65))[:, None]
    depth[30:95, 4:20] = 3.0
    return depth


def with_board(
    scene: NDArray[np.float64], centre_px: tuple[float, float], depth_m: float, half_m: float = 0.3
) -> NDArray[np.float64]:
    """A square board in front of a scene, at right angles to the axis of the camera."""
    v, u = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    half_px = FOCAL_PX * half_m / depth_m
    is_board = np.maximum(np.abs(u - centre_px[0]), np.abs(v - centre_px[1])) <= half_px
    return np.where(is_board, np.minimum(scene, depth_m), scene)


def centre_of(row: int, column: int) -> tuple[float, float]:
    """Centre in pixels of one of ROWS x COLUMNS equal regions of the picture."""
    return (column + 0.5) * WIDTH / COLUMNS, (row + 0.5) * HEIGHT / ROWS


def kinect(depth: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    """Depth with the noise and steps of disparity of a Kinect, holes, and flying pixels at edges."""
    inverse = 1 / depth + rng.normal(size=depth.shape) * 0.0012
    noisy = 1 / np.maximum(np.round(inverse / 0.0029) * 0.0029, 0.05)
    rows, columns = (np.abs(np.diff(depth, axis=a, prepend=0)) > 0.1 for a in (0, 1))
    is_edge = rows | columns
    noisy *= np.where(is_edge & (rng.random(depth.shape) < 0.3), rng.uniform(0.7, 1.2, depth.shape), 1)
    noisy[(is_edge & (rng.random(depth.shape) < 0.5)) | (rng.random(depth.shape) < 0.03)] = 0
    for _ in range(5):
        v, u = rng.integers(0, HEIGHT - 12), rng.integers(0, WIDTH - 12)
        noisy[v : v + rng.integers(3, 12), u : u + rng.integers(3, 12)] = 0
    return noisy


def movie_depth(depths: Depths, times_s: Sequence[float] | None = None, scale: float = 1.0) -> MovieDepth:
    """Depths as `MovieDepth`."""
    times = np.arange(len(depths)) / RATE_HZ if times_s is None else np.array(times_s)
    height, width = depths[0].shape

    def selected(frame: int, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> NDArray[np.float32]:
        return (scale * depths[frame][rows, columns]).astype(np.float32)

    return MovieDepth("depth", (width, height), times, (), selected)


def millimetres(depth: NDArray[np.float64]) -> NDArray[np.uint16]:
    return np.rint(1000 * depth).astype(np.uint16)


def write_depth_folder(folder: Path, depths: Depths, first_s: float | None = None) -> Path:
    """A folder of depth pictures: of TUM with times if `first_s` is given, else numbered."""
    image = pytest.importorskip("PIL.Image")
    (folder / "depth").mkdir(parents=True)
    lines = []
    for n, depth in enumerate(depths):
        stamp = 0.0 if first_s is None else first_s + n / RATE_HZ
        name = f"depth/{n:04d}.png" if first_s is None else f"depth/{stamp:.6f}.png"
        image.fromarray(millimetres(depth)).save(folder / name)
        lines.append(f"{stamp:.6f} {name}\n")
    if first_s is not None:
        (folder / "depth.txt").write_text("".join(lines))
    return folder


def write_depth_video(
    path: Path,
    depths: Depths,
    colours: Sequence[NDArray[np.uint8]] = (),
    *,
    times_s: Sequence[float] | None = None,
    title: str = "",
) -> Path:
    """A video of depth, FFV1 with 16 bits, in millimetres; with `colours`, as the second track of a movie."""
    av = pytest.importorskip("av")
    with av.open(str(path), "w") as container:
        picture = container.add_stream("mpeg4", rate=RATE_HZ) if len(colours) else None
        if picture is not None:
            picture.height, picture.width = colours[0].shape[:2]
            picture.pix_fmt = "yuv420p"
        track = container.add_stream("ffv1", rate=RATE_HZ)
        track.height, track.width = depths[0].shape
        track.pix_fmt, track.codec_context.time_base = "gray16le", Fraction(1, 1000)
        if title:
            track.metadata["title"] = title
        for n, depth in enumerate(depths):
            frame = av.VideoFrame.from_ndarray(millimetres(depth), format="gray16le")
            time_s = n / RATE_HZ if times_s is None else times_s[n]
            frame.pts, frame.time_base = round(1000 * time_s), Fraction(1, 1000)
            container.mux(track.encode(frame))
            if picture is not None and n < len(colours):
                container.mux(picture.encode(av.VideoFrame.from_ndarray(colours[n], format="rgb24")))
        for stream in (track, picture):
            if stream is not None:
                container.mux(stream.encode(None))
    return path
