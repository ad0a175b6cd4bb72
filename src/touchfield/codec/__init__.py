"""The coders: each compresses a sequence of force fields, or of moving bodies, to bytes and back. A medium is
cut into segments (short runs of frames), and each segment is coded on its own.

`registry` lists them: `touch` is the default, `paper` the paper's coder, `objects` codes bodies with poses.
"""

from typing import TYPE_CHECKING

from touchfield._lazy import lazy_attributes

if TYPE_CHECKING:
    from touchfield.codec.paper.spec import PaperSpec
    from touchfield.codec.touch.spec import TouchSpec

__all__ = ["PaperSpec", "TouchSpec"]

__getattr__ = lazy_attributes(__name__, {"paper.spec": ("PaperSpec",), "touch.spec": ("TouchSpec",)})
