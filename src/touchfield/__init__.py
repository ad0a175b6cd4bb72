"""touchfield: passive haptic media. Touch recorded, stored, processed and broadcast like sound and pictures.

    import touchfield as tf

    tf.encode("sample:terrain", "terrain.touch")
    with tf.open_stream("terrain.touch") as stream:
        print(stream.medium[0].sample_n([0.0, 0.0, 0.0]), "N")
    tf.compare("sample:terrain", "terrain.touch").draw("terrain.png")

Rooms: `medium` (the values), `sources`, `devices`, `perception`, `filters`, `measure`, `codec`, `container`,
`viewer`, `render` (the receiver), `adapters` (devices and formats at the edge), `job` (the main job),
`cli`. After Moustakas and Lalos, *An information-theoretic treatment of passive haptic media*.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from touchfield._version import __version__
from touchfield.errors import TouchfieldError
from touchfield.medium import ForceField, Grid, HapticMedium, HapticObject, HapticScene, PoseTrack

if TYPE_CHECKING:
    from touchfield.codec.paper.spec import PaperSpec
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
        prepare,
        write_field,
    )
    from touchfield.sources.options import SourceOptions
    from touchfield.sources.registry import open_source

__all__ = [
    "EncodeSpec",
    "ForceField",
    "Grid",
    "HapticMedium",
    "HapticObject",
    "HapticScene",
    "MeasureSpec",
    "PaperSpec",
    "PoseTrack",
    "SourceOptions",
    "TouchfieldError",
    "__version__",
    "compare",
    "device",
    "devices",
    "encode",
    "filter_of",
    "filter_report",
    "measure_medium",
    "open_source",
    "open_stream",
    "prepare",
    "write_field",
]

_ROOM = {
    "EncodeSpec": "touchfield.job",
    "MeasureSpec": "touchfield.job",
    "PaperSpec": "touchfield.codec.paper.spec",
    "SourceOptions": "touchfield.sources.options",
    "compare": "touchfield.job",
    "device": "touchfield.devices",
    "devices": "touchfield.devices",
    "encode": "touchfield.job",
    "filter_of": "touchfield.filters.registry",
    "filter_report": "touchfield.job",
    "measure_medium": "touchfield.job",
    "open_source": "touchfield.sources.registry",
    "open_stream": "touchfield.job",
    "prepare": "touchfield.job",
    "write_field": "touchfield.job",
}


def __getattr__(name: str) -> Any:
    # the rooms are opened when they are first entered, so that the import stays fast
    if name in _ROOM:
        return getattr(import_module(_ROOM[name]), name)
    raise AttributeError(f"module 'touchfield' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
