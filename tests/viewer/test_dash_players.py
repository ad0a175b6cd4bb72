"""The DASH manifest with touch in the players of the web, dash.js and Shaka, and in ffprobe."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import drive, needs_browser, step
from test_served import served

import touchfield as tf
from touchfield.network.access import Access
from touchfield.network.demux import demux
from touchfield.network.mux import mux

av = pytest.importorskip("av", reason="movies need the extra video")

PACKAGES = {"dashjs": "dist/modern/umd/dash.all.min.js", "shaka-player": "dist/shaka-player.compiled.js"}
START = {
    "dashjs": """
        const player = dashjs.MediaPlayer().create();
        player.on(dashjs.MediaPlayer.events.ERROR, (event) => fault(event.error.message));
        player.initialize(video, "film.mpd", true);
    """,
    "shaka-player": """
        const player = new shaka.Player();
        player.addEventListener("error", (event) => fault(event.detail.code));
        player.attach(video).then(() => player.load("film.mpd")).then(() => video.play()).catch(fault);
    """,
}
PAGE = """<!doctype html><meta charset="utf-8"><video id="video" muted></video>
<script>{library}</script><script>
    const video = document.getElementById("video");
    const fault = (message) => {{ document.title = "fault: " + message; }};
    document.documentElement.dataset.state = "ready";
    {start}
</script>"""


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the manifest of a movie of four seconds with sound, and touch from 1 s on."""
    folder = tmp_path_factory.mktemp("film")
    force = np.zeros((8, 16, 16, 16, 3), np.float32)
    for i in range(8):
        force[i, :, : 4 + i] = (0, 2, 0)
    grid = tf.Grid((16,) * 3, (0.004,) * 3, (-0.03,) * 3)
    tf.encode(force, folder / "rise.touch", grid=grid)
    with av.open(str(folder / "source.mp4"), "w") as sink:
        video, audio = sink.add_stream("libvpx-vp9", rate=25), sink.add_stream("aac", rate=48000)
        video.width, video.height, video.pix_fmt = 160, 96, "yuv420p"
        for i in range(100):
            picture = np.full((96, 160, 3), 2 * i, np.uint8)
            sink.mux(video.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        sink.mux(video.encode(None))
        sound = av.AudioFrame.from_ndarray(np.zeros((1, 192000), np.float32), format="fltp", layout="mono")
        sound.sample_rate, sound.pts = 48000, 0
        sink.mux(audio.encode(sound))
        sink.mux(audio.encode(None))
    mux(folder / "source.mp4", folder / "rise.touch", folder / "film.mpd", 1.0)
    return folder


@pytest.fixture(scope="module")
def players(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A temporary folder with the packages of the players."""
    npm = shutil.which("npm")
    if npm is None:
        pytest.skip("there is no npm here")
    folder = tmp_path_factory.mktemp("players")
    (folder / "package.json").write_text('{"name": "players", "version": "1.0.0", "private": true}')
    command = [npm, "install", "--ignore-scripts", "--no-audit", "--no-fund", *PACKAGES]
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=180, check=False)
    except subprocess.TimeoutExpired:
        pytest.skip("npm install of dashjs and shaka-player takes more than 180 s")
    if done.returncode:
        pytest.skip(f"npm install of dashjs and shaka-player fails: {done.stderr.strip()[-200:]}")
    return folder / "node_modules"


@needs_browser
@pytest.mark.parametrize("name", PACKAGES)
def test_a_player_of_the_web_plays_the_movie_beside_the_touch(
    film: Path, players: Path, tmp_path: Path, name: str
) -> None:
    library = (players / name / PACKAGES[name]).read_text("utf-8").replace("</script", "<\\/script")
    (film / f"{name}.html").write_text(PAGE.format(library=library, start=START[name]), "utf-8")
    state: Any = step(
        "run",
        code="[document.title, video.currentTime, video.duration, video.videoWidth, "
        "video.webkitAudioDecodedByteCount]",
    )
    with served(film, Access(port=0)) as address:
        result = drive(
            tmp_path,
            step("goto", url=f"http://{address}/{name}.html"),
            step("until", code="document.title || video.currentTime > 2"),
            state,
            offline=False,
        )
    title, time_s, duration_s, width, sound_bytes = result.answers[2]
    assert title == "" and time_s > 2 and duration_s == pytest.approx(4, abs=0.1)
    assert width == 160 and sound_bytes > 0
    assert all(error.startswith("Failed to load resource") for error in result.errors)  # the page's icon
    names = {url.rsplit("/", 1)[-1] for url in result.requests}
    assert {"film.mpd", "film-0.mp4", "film-1.mp4"} <= names and "film.touch" not in names


@pytest.mark.skipif(shutil.which("ffprobe") is None, reason="there is no ffprobe here")
def test_ffprobe_reads_the_manifest(film: Path) -> None:
    command = ["ffprobe", "-v", "error", "-show_entries", "stream=codec_type,start_time", "-of", "csv=p=0"]
    done = subprocess.run(
        [*command, film / "film.mpd"], capture_output=True, text=True, check=True, timeout=60
    )
    assert "video,0.000000" in done.stdout and "audio," in done.stdout and not done.stderr


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="there is no ffmpeg here")
def test_a_movie_made_of_the_manifest_takes_the_sidecar(film: Path, tmp_path: Path) -> None:
    copy = [
        "ffmpeg",
        "-v",
        "error",
        "-i",
        film / "film.mpd",
        "-map",
        "0",
        "-c",
        "copy",
        tmp_path / "film.mp4",
    ]
    subprocess.run(copy, check=True, timeout=60)
    shutil.copyfile(film / "film.touch", tmp_path / "film.touch")
    done = demux(tmp_path / "film.mp4", tmp_path / "back.touch")
    assert (tmp_path / "back.touch").read_bytes() == (film / "rise.touch").read_bytes()
    assert "film.touch next to it is used" in done.notes[0] and "0 s is assumed" in done.notes[1]
