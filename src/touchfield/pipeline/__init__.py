"""The main pipeline (paper, figure 4): a scene becomes a ``.touch`` file, and the file a medium again.

source -> workspace -> device filter (M) -> medium          `preparation`, `placement`
medium -> coder -> segments -> file                         `segments`, `encoding`
file -> segments -> decoder -> medium                       `decoding`
received medium against its source, and as a hand feels it  `comparison`
scene -> a file of a given size or error                    `rate_control`
scene -> a huge lattice, as tiles of a zarr store           `tiles`
medium -> workspace in boxes that each fill the device      `mapping`
"""

from typing import TYPE_CHECKING

from touchfield._lazy import lazy_attributes

if TYPE_CHECKING:
    from touchfield.pipeline.comparison import Comparison, compare, filter_report
    from touchfield.pipeline.decoding import OpenStream, open_stream, write_field
    from touchfield.pipeline.encoding import Encoded, encode
    from touchfield.pipeline.mapping import partition_workspace
    from touchfield.pipeline.preparation import Prepared, decode, prepare
    from touchfield.pipeline.rate_control import Target, encode_to_target
    from touchfield.pipeline.spec import EncodeSpec
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
    "decode",
    "encode",
    "encode_tiles",
    "encode_to_target",
    "filter_report",
    "open_stream",
    "partition_workspace",
    "prepare",
    "write_field",
]

_MODULES = {
    "comparison": ("Comparison", "compare", "filter_report"),
    "decoding": ("OpenStream", "open_stream", "write_field"),
    "encoding": ("Encoded", "encode"),
    "mapping": ("partition_workspace",),
    "preparation": ("Prepared", "decode", "prepare"),
    "rate_control": ("Target", "encode_to_target"),
    "spec": ("EncodeSpec",),
    "tiles": ("Tiled", "encode_tiles"),
}
__getattr__ = lazy_attributes(
    __name__, {name: module for module, names in _MODULES.items() for name in names}
)
