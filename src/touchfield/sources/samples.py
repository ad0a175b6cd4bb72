"""Opens sample scenes such as ``sample:terrain``, which need no download.

They are data of well-known libraries, and Scene 1 of the paper.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from touchfield.errors import InvalidArgument
from touchfield.sources.options import SourceOptions

if TYPE_CHECKING:
    from touchfield.sources.scene import Scene


SAMPLES = ("shapes", "terrain", "motorcycle", "falling-4", "falling-7")


def sample(name: str, options: SourceOptions | None = None) -> Scene:
    """Return a sample scene by name.

    "shapes" is a tray of six analytic shapes, which needs no optional library. "terrain" is the elevation
    model of the Jacksboro fault, Tennessee, from matplotlib (344 x 403 samples of the Shuttle Radar
    Topography Mission); "motorcycle" is the Middlebury 2014 stereo pair from scikit-image, as a depth map.
    "falling-4" and "falling-7" are Scene 1 of the paper (section 5.1), bodies of low complexity that fall on
    the ground, 2000 frames in 2 s: four as in its text, seven as in its figure 5. The ground itself exerts no
    force. The paper gives no shapes and positions; those of these samples are our choice.

    Raises `InvalidArgument` if there is no such sample, or the library that contains or simulates it is not
    installed.
    """
    options = options or SourceOptions()
    if name == "terrain":
        from touchfield.sources.terrain.height_files import jacksboro_scene

        return jacksboro_scene(options.exaggeration)
    if name == "motorcycle":
        from touchfield.sources.depth.inverse_depth import motorcycle_sequence
        from touchfield.sources.depth.layouts import depth_scene

        return depth_scene(motorcycle_sequence(), options)
    if name in ("shapes", "falling-4", "falling-7"):
        from importlib import resources

        from touchfield.sources.physics.toml_file import open_physics
        from touchfield.sources.shapes.analytic_scene import read_analytic

        with resources.as_file(resources.files("touchfield.sources") / "scenes" / f"{name}.toml") as path:
            return read_analytic(path, options.rate_hz) if name == "shapes" else open_physics(path, options)
    raise InvalidArgument("sample", repr(name), f"one of {', '.join(SAMPLES)}")
