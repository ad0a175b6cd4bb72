"""Writes a movie with touch as a DASH manifest (ISO/IEC 23009-1) and the files that it names.

Sound and picture are as ffmpeg segments them. The touch is an AdaptationSet whose single Representation is
the whole ``.touch`` file, as for captions; receivers read ranges of it. A SupplementalProperty gives the time
of the movie, in seconds, at which the touch starts.
"""

from __future__ import annotations

import os
import re
import shutil
from pathlib import Path
from typing import Any, Final
from xml.sax.saxutils import escape

from touchfield.atomic import temporary_folder
from touchfield.errors import InvalidArgument
from touchfield.files import readable
from touchfield.network.live import MEDIA_TYPE
from touchfield.network.movie_copy import MovieFile, copy_movie, tracks_of

START_SCHEME: Final = "urn:touchfield:begins-s"
_WEBM_ONLY: Final = {"vp8", "vorbis"}


def write_dash(source: Any, stream: Path, out: Path, at_s: float, rate_bits: float) -> tuple[str, ...]:
    """Write NAME.mpd, tracks as NAME-N.mp4 and the stream as NAME.touch; return the types of the tracks.

    `source` is a movie as `open_movie` returns it, `out` is NAME.mpd; the touch starts at the second `at_s`
    of the movie and has `rate_bits` bits a second. Raises InvalidArgument if a file that is written would
    replace the movie, or the format cannot contain one of its tracks.
    """
    tracks = tracks_of(source, "video", "audio")
    options = {
        "single_file": "1",
        "single_file_name": f"{out.stem}-$RepresentationID$.mp4",
        "global_sidx": "1",
    }
    if not {track.codec_context.name for track in tracks} & _WEBM_ONLY:  # else the choice is ffmpeg's
        options["dash_segment_type"] = "mp4"
    with temporary_folder(out) as folder:
        manifest = folder / out.name
        copy_movie(source, tracks, MovieFile(manifest, str(out), "dash", options))
        text = _with_segment_bases(manifest.read_text("utf-8"), folder)
        manifest.write_text(_with_touch(text, out.stem, at_s, rate_bits), "utf-8")
        with readable(out, "a folder that can be written"):
            shutil.copyfile(stream, folder / f"{out.stem}.touch")
            _move_all(folder, out.parent, Path(source.name))
    return tuple(track.type for track in tracks)


def _move_all(folder: Path, target: Path, movie: Path) -> None:
    """Move the files of a folder to another one, but replace nothing if one of them is the movie."""
    paths = sorted(folder.iterdir(), key=lambda path: path.suffix == ".mpd")
    for path in paths:
        if (target / path.name).exists() and (target / path.name).samefile(movie):
            raise InvalidArgument(str(target / path.name), "the movie that is read", "another name")
    for path in paths:  # the manifest last, after the files that it names
        os.replace(path, target / path.name)


def _with_segment_bases(manifest: str, folder: Path) -> str:
    """A manifest that refers to the index in each file (`sidx`) in place of ffmpeg's list of segments.

    ffmpeg itself does not read its lists of ranges, and other players need the times of the segments.
    """
    names = iter(re.findall(r"<BaseURL>([^<]*)</BaseURL>", manifest))

    def base(match: re.Match[str]) -> str:
        with (folder / next(names)).open("rb") as file:
            start = file.read(int(match[1]) + 1)
        index = start.rfind(b"sidx") - 4
        if index < 0:  # an ffmpeg that does not write one
            return match[0]
        return (
            f'<SegmentBase indexRange="{index}-{len(start) - 1}">'
            f'<Initialization range="0-{index - 1}"/></SegmentBase>'
        )

    lists = r'<SegmentList[^>]*>\s*<Initialization range="0-(\d+)" />.*?</SegmentList>'
    text = re.sub(lists, base, manifest, flags=re.DOTALL)
    text = text.replace("isoff-live:2011", "isoff-on-demand:2011")
    return text.replace("segmentAlignment=", "subsegmentAlignment=").replace(
        "startWithSAP=", "subsegmentStartsWithSAP="
    )


def _with_touch(manifest: str, stem: str, at_s: float, rate_bits: float) -> str:
    """A manifest of one period that ffmpeg wrote, with the AdaptationSet of the touch."""
    escaped = escape(stem)
    touch = f"""\t<AdaptationSet contentType="application" mimeType="{MEDIA_TYPE}">
\t\t\t<SupplementalProperty schemeIdUri="{START_SCHEME}" value="{at_s:g}"/>
\t\t\t<Representation id="touch" bandwidth="{max(1, round(rate_bits))}">
\t\t\t\t<BaseURL>{escaped}.touch</BaseURL>
\t\t\t</Representation>
\t\t</AdaptationSet>
\t</Period>"""
    return manifest.replace(stem, escaped).replace("</Period>", touch)  # ffmpeg does not escape the name
