"""touchfield: passive haptic media. Touch recorded, stored, processed and broadcast like sound and pictures.

    import touchfield as tf

    tf.encode("sample:terrain", "terrain.touch")
    with tf.open_stream("terrain.touch") as stream:
        print(stream.medium[0].sample_n([0.0, 0.0, 0.0]), "N")
    tf.compare("sample:terrain", "terrain.touch").draw("terrain.png")

Rooms, each reached as `tf.NAME`: `medium` (the values), `sources`, `devices`, `perception`, `filters`, `measure`,
`reduction`, `codec`, `container`, `stream` (seconds that come by file, network or live), `viewer`, `render` (the
receiver), `adapters` (devices and formats at the edge), `job` (the main job), `cli`. After Moustakas and Lalos,
*An information-theoretic treatment of passive haptic media*.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from touchfield._version import __version__
from touchfield.errors import TouchfieldError

if TYPE_CHECKING:
    from touchfield import (
        adapters,
        codec,
        container,
        filters,
        job,
        measure,
        medium,
        perception,
        reduction,
        render,
        sources,
        stream,
        viewer,
    )
    from touchfield.codec.paper.spec import PaperSpec
    from touchfield.codec.touch.spec import TouchSpec
    from touchfield.devices import device, devices
    from touchfield.filters.registry import filter_of
    from touchfield.job import (
        EncodeSpec,
        MeasureSpec,
        compare,
        encode,
        filter_report,
        measure_medium,
        open_stream,
        plan,
        prepare,
        write_field,
    )
    from touchfield.job.play import PlaySpec, play
    from touchfield.job.prepare import decode
    from touchfield.job.view import view
    from touchfield.medium import ForceField, Grid, HapticMedium, HapticObject, HapticScene, PoseTrack
    from touchfield.render.player import Player
    from touchfield.render.sampler import FieldSampler
    from touchfield.sources.options import SourceOptions
    from touchfield.sources.registry import open_source

__all__ = [
    "EncodeSpec", "FieldSampler", "ForceField", "Grid", "HapticMedium", "HapticObject", "HapticScene",
    "MeasureSpec", "PaperSpec", "PlaySpec", "Player", "PoseTrack", "SourceOptions", "TouchSpec", "TouchfieldError",
    "__version__", "adapters", "codec", "compare", "container", "decode", "device", "devices", "encode",
    "filter_of", "filter_report", "filters", "job", "measure", "measure_medium", "medium", "open_source",
    "open_stream", "perception", "plan", "play", "prepare", "reduction", "render", "sources", "stream", "view",
    "viewer", "write_field",
]  # fmt: skip

_NAMES = {
    "touchfield.job": (
        "EncodeSpec MeasureSpec compare encode filter_report measure_medium open_stream plan prepare write_field"
    ),
    "touchfield.medium": "ForceField Grid HapticMedium HapticObject HapticScene PoseTrack",
    "touchfield.render.sampler": "FieldSampler",
    "touchfield.codec.paper.spec": "PaperSpec",
    "touchfield.job.play": "PlaySpec play",
    "touchfield.render.player": "Player",
    "touchfield.sources.options": "SourceOptions",
    "touchfield.codec.touch.spec": "TouchSpec",
    "touchfield.job.prepare": "decode",
    "touchfield.devices": "device",
    "touchfield.filters.registry": "filter_of",
    "touchfield.sources.registry": "open_source",
    "touchfield.job.view": "view",
}
_ROOM = {name: room for room, names in _NAMES.items() for name in names.split()}


def __getattr__(name: str) -> Any:
    # the rooms are opened when they are first entered, so that the import stays fast
    if name in _ROOM:
        return getattr(import_module(_ROOM[name]), name)
    if name in __all__:
        return import_module(f"touchfield.{name}")
    raise AttributeError(f"module 'touchfield' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
