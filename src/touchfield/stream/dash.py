"""A DASH manifest of a movie with touch (ISO/IEC 23009-1): sound and picture as ffmpeg cuts them, touch as a file.

The touch is an AdaptationSet of its own, whose one Representation is the whole ``.touch`` file, as captions have it:
receivers read ranges of it. A SupplementalProperty tells the second of the movie at which it begins.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final
from xml.etree import ElementTree

from touchfield.errors import InvalidArgument, SourceError

MEDIA_TYPE: Final = "haptics/vnd.touchfield"
BEGINS: Final = "urn:touchfield:begins-s"
_SPACE: Final = "urn:mpeg:dash:schema:mpd:2011"


def write_dash(source: Any, stream: Path, out: Path, at_s: float, rate_bits: float) -> tuple[str, ...]:
    """Write `out`, the movie's tracks as .mp4 files beside it, and a copy of the stream; the kinds of the tracks.

    Parameters
    ----------
    source : av.container.InputContainer
        The movie.
    stream : Path
        A ``.touch`` file.
    out : Path
        NAME.mpd; the files beside it are NAME-N.mp4 and NAME.touch.
    at_s : float
        The movie's second at which the touch begins.
    rate_bits : float
        Bits a second of the stream.

    Raises InvalidArgument if the form cannot hold a track of the movie; SourceError if a file cannot be written.
    """
    import av

    kept = [one for one in source.streams if one.type in ("video", "audio")]
    names = {"single_file": "1", "single_file_name": f"{out.stem}-$RepresentationID$.mp4"}
    with TemporaryDirectory(prefix=".touchfield-", dir=out.parent) as folder:
        made = Path(folder) / out.name
        try:
            with av.open(str(made), "w", format="dash", options=names) as sink:
                tracks = {one.index: sink.add_stream_from_template(one) for one in kept}
                for packet in source.demux(kept):
                    if packet.dts is not None:
                        packet.stream = tracks[packet.stream.index]
                        sink.mux(packet)
        except (av.FFmpegError, ValueError) as error:
            raise InvalidArgument(str(out), str(error), "a form that holds the tracks of the movie") from None
        _add_touch(made, f"{out.stem}.touch", at_s, rate_bits)
        try:
            shutil.copyfile(stream, Path(folder) / f"{out.stem}.touch")
            for path in Path(folder).iterdir():
                if (out.parent / path.name).exists() and (out.parent / path.name).samefile(source.name):
                    raise InvalidArgument(str(out.parent / path.name), "the movie that is read", "another name")
            for path in sorted(Path(folder).iterdir(), key=lambda path: path.suffix == ".mpd"):  # what it names first
                os.replace(path, out.parent / path.name)
        except OSError as error:
            raise SourceError(str(out), error.strerror or str(error), "a folder that can be written") from None
    return tuple(one.type for one in kept)


def _add_touch(manifest: Path, name: str, at_s: float, rate_bits: float) -> None:
    """Add the set of the touch to a manifest."""
    ElementTree.register_namespace("", _SPACE)
    tree = ElementTree.parse(manifest)  # ffmpeg's own, written a moment ago
    period = tree.getroot().find(f"{{{_SPACE}}}Period")
    assert period is not None

    def add(parent: ElementTree.Element, kind: str, **given: str) -> ElementTree.Element:
        return ElementTree.SubElement(parent, f"{{{_SPACE}}}{kind}", given)

    touch = add(period, "AdaptationSet", contentType="application", mimeType=MEDIA_TYPE)
    add(touch, "SupplementalProperty", schemeIdUri=BEGINS, value=f"{at_s:g}")
    whole = add(touch, "Representation", id="touch", bandwidth=str(max(1, round(rate_bits))))
    add(whole, "BaseURL").text = name
    ElementTree.indent(tree)
    tree.write(manifest, encoding="utf-8", xml_declaration=True)
