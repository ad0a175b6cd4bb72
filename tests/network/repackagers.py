"""Programs that copy a movie with touch, and what is left of the touch afterwards.

    python tests/network/repackagers.py [--write]

prints the table of docs/exchange.md for the programs that are installed; `--write` puts it there.
Programs are looked for on PATH.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from touchfield.codec.touch.spec import TouchSpec
from touchfield.errors import TouchfieldError
from touchfield.medium import Grid, HapticMedium
from touchfield.network.demux import demux
from touchfield.network.mux import mux
from touchfield.pipeline import encode
from touchfield.pipeline.spec import EncodeSpec

PAGE = Path(__file__).resolve().parents[2] / "docs" / "exchange.md"
MARKS = "<!-- table of repackagers: start -->", "<!-- table of repackagers: end -->"
AT_S = 1.0
TIMEOUT_S = 120
_FFMPEG = "ffmpeg -v error -y -i {source} -map 0 -c copy"
_FRAGMENTS = "-movflags frag_keyframe+empty_moov+default_base_moof"
_HLS = "-f hls -hls_time 1 -hls_list_size 0"
_QUEUE = "queue max-size-time=0 max-size-bytes=0 max-size-buffers=0"


class Repackager(NamedTuple):
    """A command that copies `source` to `result`; `{out}` is the result without its ending."""

    name: str
    source: str
    result: str
    command: str

    @property
    def program(self) -> str:
        """The executable that the command needs."""
        return self.command.split()[0]


REPACKAGERS = (
    Repackager("ffmpeg -map 0 -c copy", ".mp4", ".mp4", f"{_FFMPEG} {{out}}.mp4"),
    Repackager("the same, of its own copy", ".mp4", ".mp4", f"{_FFMPEG} {{out}}-1.mp4 && "
               "ffmpeg -v error -y -i {out}-1.mp4 -map 0 -c copy {out}.mp4"),
    Repackager("ffmpeg, fragments (empty_moov)", ".mp4", ".mp4", f"{_FFMPEG} {_FRAGMENTS} {{out}}.mp4"),
    Repackager("ffmpeg -map 0 -c copy", ".mov", ".mov", f"{_FFMPEG} {{out}}.mov"),
    Repackager("ffmpeg -map 0 -c copy", ".mp4", ".ts", f"{_FFMPEG} {{out}}.ts"),
    Repackager("ffmpeg -map 0 -c copy", ".ts", ".ts", f"{_FFMPEG} {{out}}.ts"),
    Repackager("ffmpeg -map 0 -c copy", ".ts", ".mov", f"{_FFMPEG} {{out}}.mov"),
    Repackager("ffmpeg -map 0 -c copy", ".mkv", ".mkv", f"{_FFMPEG} {{out}}.mkv"),
    Repackager("ffmpeg -f hls", ".mp4", ".m3u8", f"{_FFMPEG} {_HLS} {{out}}.m3u8"),
    Repackager("ffmpeg -f hls, fmp4", ".mp4", ".m3u8",
               f"{_FFMPEG} {_HLS} -hls_segment_type fmp4 {{out}}.m3u8"),
    Repackager("ffmpeg -c copy", ".mp4", ".mp4", "ffmpeg -v error -y -i {source} -c copy {out}.mp4"),
    Repackager("gst-launch-1.0 tsdemux, mpegtsmux", ".ts", ".ts",
               "gst-launch-1.0 -q mpegtsmux name=m ! filesink location={out}.ts filesrc location={source} "
               f"! tsdemux name=d d. ! {_QUEUE} ! h264parse ! m. d. ! {_QUEUE} ! meta/x-klv ! m. "
               f"d. ! {_QUEUE} ! aacparse ! m."),
    Repackager("gst-launch-1.0 qtdemux, mp4mux", ".mp4", ".mp4",
               "gst-launch-1.0 -q mp4mux name=m ! filesink location={out}.mp4 filesrc location={source} "
               f"! qtdemux name=d d.video_0 ! {_QUEUE} ! h264parse ! m. "
               f"d.audio_0 ! {_QUEUE} ! aacparse ! m."),
    Repackager("MP4Box -add -new", ".mp4", ".mp4", "MP4Box -quiet -add {source} -new {out}.mp4"),
    Repackager("MP4Box -inter", ".mov", ".mp4", "MP4Box -quiet -inter 500 {source} -out {out}.mp4"),
    Repackager("MP4Box -frag", ".mp4", ".mp4", "MP4Box -quiet -frag 500 {source} -out {out}.mp4"),
    Repackager("mp4fragment (Bento4)", ".mp4", ".mp4", "mp4fragment {source} {out}.mp4"),
    Repackager("mp4edit (Bento4)", ".mp4", ".mp4", "mp4edit --remove moov/udta {source} {out}.mp4"),
    Repackager("mkvmerge", ".mkv", ".mkv", "mkvmerge -q -o {out}.mkv {source}"),
    Repackager("mkvmerge", ".mp4", ".mkv", "mkvmerge -q -o {out}.mkv {source}"),
)  # fmt: skip


class Kept(NamedTuple):
    """What is left of the touch: where it was, the error of its start, and whether its bytes are equal."""

    where: str
    error_ms: float
    is_equal: bool


def write_movies(folder: Path) -> None:
    """Write a movie of four seconds with sound, a stream, and both together in every form, with sidecars."""
    import av

    rng = np.random.default_rng(1)
    with av.open(str(folder / "movie.mp4"), "w") as sink:
        video, audio = (
            sink.add_stream("libx264", rate=25, options={"g": "12"}),
            sink.add_stream("aac", rate=48000),
        )
        video.width, video.height, video.pix_fmt = 160, 96, "yuv420p"
        for i in range(100):
            picture = np.full((96, 160, 3), 2 * i, np.uint8)
            picture[:, i : i + 20] = rng.integers(0, 255, (96, 20, 3))
            sink.mux(video.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        sink.mux(video.encode(None))
        sound = av.AudioFrame.from_ndarray(np.zeros((1, 192000), np.float32), format="fltp", layout="mono")
        sound.sample_rate, sound.pts = 48000, 0
        sink.mux(audio.encode(sound))
        sink.mux(audio.encode(None))
    noise = rng.normal(0, 1, (20, 24, 24, 24, 3)).astype(np.float32)  # segments above 64 KiB
    medium = HapticMedium.from_array(noise, Grid((24,) * 3, (0.004,) * 3, (-0.046,) * 3), 10.0)
    touch = TouchSpec(segment_frames=3, effort="fast")
    encode(medium, folder / "stream.touch", EncodeSpec(touch=touch, vibration="gain=0.25,frequency=80..240"))
    for form in (".mp4", ".mov", ".ts", ".mkv"):
        (folder / form[1:]).mkdir()
        movie = folder / form[1:] / f"both{form}"
        mux(folder / "movie.mp4", folder / "stream.touch", movie, AT_S, has_sidecar=True)


def repackage(program: Repackager, folder: Path) -> Kept:
    """Run a program on the movie that `write_movies` wrote, and extract the touch of what it writes.

    RuntimeError with the program's message if it fails.
    """
    source = folder / program.source[1:] / f"both{program.source}"
    with tempfile.TemporaryDirectory(dir=folder) as out_folder:
        out = Path(out_folder) / "film"
        for command in program.command.format(source=source, out=out).split(" && "):
            done = subprocess.run(
                command.split(), capture_output=True, text=True, timeout=TIMEOUT_S, check=False
            )
            if done.returncode:
                raise RuntimeError(f"{command}: {done.stderr.strip()[-500:]}")
        movie, back = out.with_suffix(program.result), Path(out_folder) / "back.touch"
        where = "yes"
        try:
            found = demux(movie, back)
        except TouchfieldError as error:
            if "no track of touch" not in str(error):
                raise
            shutil.copyfile(source.with_suffix(".touch"), out.with_suffix(".touch"))
            where, found = "in the sidecar", demux(movie, back)
        shown_s = found.at_s - (0.0 if _is_ts(movie) else _first_picture_s(movie))
        is_equal = back.read_bytes() == (folder / "stream.touch").read_bytes()
        return Kept(where, 1000 * (shown_s - AT_S), is_equal)


def _is_ts(movie: Path) -> bool:
    """Whether a second of the movie counts from its first picture."""
    return movie.suffix == ".ts" or (movie.suffix == ".m3u8" and ".ts" in movie.read_text())


def _first_picture_s(movie: Path) -> float:
    """When the first picture shows, as ffmpeg reads the movie."""
    import av

    source: Any
    with av.open(str(movie)) as source:
        track = source.streams.video[0]
        return float(min(p.pts for p in source.demux(track) if p.pts is not None) * track.time_base)


def rows(folder: Path) -> Iterator[tuple[Repackager, Kept]]:
    """What each installed program leaves."""
    for program in REPACKAGERS:
        if shutil.which(program.program):
            yield program, repackage(program, folder)


def table(folder: Path) -> str:
    """The table in Markdown."""
    lines = ["| program | from | to | touch found | start, ms | bytes equal |", "|---|---|---|---|---|---|"]
    for program, kept in rows(folder):
        cells = program.source[1:], program.result[1:], kept.where, f"{round(kept.error_ms):+d}"
        lines.append(f"| {program.name} | {' | '.join(cells)} | {'yes' if kept.is_equal else 'NO'} |")
    return "\n".join(lines)


def main() -> None:
    """Print the table, or write it into the page."""
    with tempfile.TemporaryDirectory() as folder:
        write_movies(Path(folder))
        made = table(Path(folder))
    print(made)
    if "--write" in sys.argv[1:]:
        text = PAGE.read_text("utf-8")
        start, end = text.index(MARKS[0]) + len(MARKS[0]), text.index(MARKS[1])
        PAGE.write_text(f"{text[:start]}\n{made}\n{text[end:]}", "utf-8")


if __name__ == "__main__":
    main()
