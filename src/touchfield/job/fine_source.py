"""The source of a stream as a stream beside it, coded finely, for a page that shows both and what lies between."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from touchfield.codec.touch.spec import TouchSpec
from touchfield.errors import InvalidArgument
from touchfield.job.compare import source_medium
from touchfield.job.encode import encode_prepared
from touchfield.job.prepare import Prepared
from touchfield.job.spec import EncodeSpec
from touchfield.parallel import Report, silent

if TYPE_CHECKING:
    from touchfield.job.stream_scene import Source
    from touchfield.stream.opened import OpenStream


MOST_BYTES: Final = 1 << 25
"""Of the source within a page."""

_SHARES: Final = (0.1, 0.3)
_LEAST_K: Final = 1e-3


class FineSource(NamedTuple):
    """A source as the bytes of a ``.touch`` file; `share`: its error, of what the promise of the stream allows."""

    data: bytes
    share: float


def fine_source(source: Source, opened: OpenStream, report: Report = silent) -> FineSource:
    """Code the source of a stream on the stream's lattice, to a tenth of its mask, or three where that is too large.

    Raises
    ------
    InvalidArgument
        If the source lies elsewhere, has other frames, or takes more than `MOST_BYTES`.
    """
    head, original = opened.reader.head, source_medium(source, opened)
    if len(original.medium) != head.frame_count:
        found, expected = f"{len(original.medium)} frames", f"the stream's {head.frame_count}"
        raise InvalidArgument("the source", found, expected, "Name the source it came from.")
    size = 0
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "source.touch"
        for share in _SHARES:
            k = min(max(share * head.weber_fraction, _LEAST_K), 0.999)
            spec = EncodeSpec(touch=TouchSpec(k=k, f0_n=share * head.force_threshold_n, effort="fast"))
            prepared = Prepared(
                original.medium, opened.told_device, opened.placement, spec, original.notes, original.scene
            )
            size = encode_prepared(prepared, out, {}, report).file_bytes
            if size <= MOST_BYTES:
                return FineSource(out.read_bytes(), max(share, k / max(head.weber_fraction, k)))
    mend = "Leave it out, or take fewer frames."
    raise InvalidArgument("the source", f"{size:,} bytes, coded finely", f"at most {MOST_BYTES:,} in a page", mend)
