"""`plane_means`: a frame reduced by its planes is the reduced picture, for each format and any size."""

from __future__ import annotations

import numpy as np
import pytest

from touchfield.sources.images.movies import map_size, reduced
from touchfield.sources.images.plane_means import has_planes, plane_means


@pytest.mark.parametrize("form", ["yuv420p", "yuv422p", "yuv444p", "yuvj420p", "yuvj444p"])
@pytest.mark.parametrize("size", [(640, 360), (322, 244), (131, 257), (66, 2)])
def test_means_of_planes_are_those_of_colours(form: str, size: tuple[int, int]) -> None:
    av = pytest.importorskip("av")
    width, height = size
    v, u = np.mgrid[:height, :width]
    waves = [120 + 90 * np.sin(u / 29 + k) * np.cos(v / 23 - k) for k in range(3)]
    colours = np.stack(waves, axis=2).astype(np.uint8)
    picture = av.VideoFrame.from_ndarray(colours, format="rgb24").reformat(format=form)
    assert has_planes(picture)
    found = plane_means(picture, map_size(width, height))
    expected = reduced(colours)
    assert found.shape == expected.shape
    difference = found.astype(int) - expected
    assert np.abs(difference).max() <= 6 and np.abs(difference.mean(axis=(0, 1))).max() < 2


def test_formats_without_such_planes_are_named() -> None:
    av = pytest.importorskip("av")
    for form in ("rgb24", "yuv420p10le", "nv12", "gray", "yuva420p"):
        assert not has_planes(av.VideoFrame(64, 48, form))
