"""Real scenes that come with well-known libraries, for a first run with no download; and tiny ones for tests."""

from __future__ import annotations

from typing import TYPE_CHECKING

from touchfield.errors import InvalidArgument
from touchfield.sources.options import SourceOptions

if TYPE_CHECKING:
    from touchfield.sources.scene import Scene

__all__ = ["SAMPLES", "sample", "tiny_scenes"]

SAMPLES = ("terrain", "motorcycle")


def sample(name: str, options: SourceOptions | None = None) -> Scene:
    """A scene by name.

    "terrain" is the elevation model of the Jacksboro fault, Tennessee, that matplotlib carries (344 x 403
    samples of the Shuttle Radar Topography Mission); "motorcycle" is the Middlebury 2014 stereo pair that
    scikit-image carries, as a depth map.

    Raises
    ------
    InvalidArgument
        If there is no such sample, or the library that carries it is not installed.
    """
    options = options or SourceOptions()
    if name == "terrain":
        from touchfield.sources.height_map import jacksboro_scene

        return jacksboro_scene(options.exaggeration)
    if name == "motorcycle":
        from touchfield.sources.disparity import motorcycle_sequence
        from touchfield.sources.folder_sequence import depth_scene

        return depth_scene(motorcycle_sequence(), options)
    raise InvalidArgument("sample", repr(name), f"one of {', '.join(SAMPLES)}")


def tiny_scenes() -> list[Scene]:
    """One small scene for each kernel, to compile them all."""
    raise NotImplementedError
