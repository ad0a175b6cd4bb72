"""The steps behind `touchfield encode` and `touchfield decode` (figure 4 of the paper): from a scene to a
``.touch`` file, and back to a medium.

source -> device filter (M) -> haptic filters -> medium   `preparation`
    its stages                                            `source`, `placement`, `objects`, `notes`
medium -> coder -> segments -> container                  `encoding`, `provenance`, `segments`, `workers`
container -> segments -> decoder -> medium                `decoding`, `stream`
    its frames and objects                                `decoded_frames`, `decoded_objects`
decoded medium against its source                         `comparison`

source -> a file of a requested size or error             `rate_control`
source -> a huge lattice, as tiles of a zarr store        `tiles`
medium -> M(W) of a device, for measures in bits          `partition`
stream -> drives of an array of actuators                 `array_medium`
"""

from typing import TYPE_CHECKING

from touchfield._lazy import lazy_attributes

if TYPE_CHECKING:
    from touchfield.pipeline.comparison import (
        Comparison,
        compare,
        compare_prepared,
        draw_filtered,
        filter_report,
    )
    from touchfield.pipeline.decoding import open_file, write_field
    from touchfield.pipeline.encoding import Encoded, encode
    from touchfield.pipeline.partition import partition_workspace
    from touchfield.pipeline.preparation import Prepared, prepare
    from touchfield.pipeline.rate_control import Target, encode_to_target
    from touchfield.pipeline.source import decode
    from touchfield.pipeline.spec import EncodeSpec
    from touchfield.pipeline.stream import OpenStream
    from touchfield.pipeline.tiles import Tiled, encode_tiles

__all__ = [
    "Comparison",
    "EncodeSpec",
    "Encoded",
    "OpenStream",
    "Prepared",
    "Target",
    "Tiled",
    "compare",
    "compare_prepared",
    "decode",
    "draw_filtered",
    "encode",
    "encode_tiles",
    "encode_to_target",
    "filter_report",
    "open_file",
    "partition_workspace",
    "prepare",
    "write_field",
]

_MODULES = {
    "comparison": ("Comparison", "compare", "compare_prepared", "draw_filtered", "filter_report"),
    "decoding": ("open_file", "write_field"),
    "encoding": ("Encoded", "encode"),
    "partition": ("partition_workspace",),
    "preparation": ("Prepared", "prepare"),
    "rate_control": ("Target", "encode_to_target"),
    "source": ("decode",),
    "spec": ("EncodeSpec",),
    "stream": ("OpenStream",),
    "tiles": ("Tiled", "encode_tiles"),
}
__getattr__ = lazy_attributes(__name__, _MODULES)
