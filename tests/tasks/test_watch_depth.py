"""Depth of a movie: what approaches is felt in its region and in time, and a scene that stands is quiet."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from depth_movie_makers import (
    COLUMNS,
    HEIGHT,
    RATE_HZ,
    ROWS,
    WIDTH,
    centre_of,
    kinect,
    movie_depth,
    room,
    with_board,
    write_depth_folder,
    write_depth_video,
)
from soundtrack_makers import pictures, strokes, write_movie
from touchfield.cli.main import _exit_code
from touchfield.errors import InvalidArgument, SourceError
from touchfield.medium import Grid
from touchfield.network.demux import demux
from touchfield.network.opening import open_stream
from touchfield.sources.depth.approach import FAR_S
from touchfield.tasks.touch_tracks import touch_tracks
from touchfield.tasks.watch import WatchSpec, watch
from touchfield.tasks.watch_depth import (
    MAX_GAP_S,
    MAX_NEAR,
    MIN_APPROACH,
    DepthFeatures,
    Regions,
    depth_features,
)

Depths = list[NDArray[np.float64]]
GRID = Grid.over_box((-0.16, -0.12, -0.1), (0.16, 0.12, 0.1), (COLUMNS, ROWS, 1))  # motors as the picture


def features_of(depths: Depths, times_s: Sequence[float] | None = None, scale: float = 1.0) -> DepthFeatures:
    return depth_features(movie_depth(depths, times_s, scale), GRID, (WIDTH, HEIGHT))


def approaching(
    row: int, column: int, speed_m_s: float = 2.0, first_m: float = 9.5, count: int = 90
) -> Depths:
    centre = centre_of(row, column)
    return [with_board(room(), centre, first_m - speed_m_s * n / RATE_HZ) for n in range(count)]


def noisy(depths: Depths, seed: int = 0) -> Depths:
    rng = np.random.default_rng(seed)
    return [kinect(depth, rng) for depth in depths]


def first_felt(drives: NDArray[np.float32]) -> NDArray[np.int64]:
    """The first frame that each motor is driven, [rows, columns]; the number of frames if none."""
    is_on = drives > 0
    return np.where(is_on.any(axis=0), is_on.argmax(axis=0), len(drives))


# -- the rule ----------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("row", "column"), [(0, 3), (1, 1), (2, 2), (0, 1)])
@pytest.mark.parametrize("speed_m_s", [1.5, 2.0])
def test_what_approaches_is_felt_in_its_region_when_it_is_four_seconds_away(
    row: int, column: int, speed_m_s: float
) -> None:
    drives = features_of(approaching(row, column, speed_m_s, 9.0)).drives
    threshold = RATE_HZ * (9.0 - FAR_S * speed_m_s) / speed_m_s  # frame at which z / v = 4 s
    felt = first_felt(drives)
    assert threshold - 0.01 <= felt[row, column] <= threshold + 1
    others = np.delete(felt.ravel(), row * COLUMNS + column)
    assert others.min() == len(drives), "the board stays within its region"
    assert drives[felt[row, column], row, column] == pytest.approx(MIN_APPROACH, abs=0.02)


def test_nearer_is_stronger_until_a_second_before_contact() -> None:
    depths = [with_board(room(), centre_of(1, 2), 8.0 - 2 * n / RATE_HZ) for n in range(110)]
    drive = features_of(depths).drives[20:, 1, 2]
    contact_s = (8.0 - 2 * np.arange(20, 110) / RATE_HZ) / 2
    assert (np.diff(drive[contact_s < 2.8]) >= 0).all() and drive.max() == pytest.approx(1)
    assert drive[np.abs(contact_s - 2.0).argmin()] == pytest.approx(MIN_APPROACH + 0.75 * 2 / 3, abs=0.03)


def test_unit_of_depth_does_not_matter() -> None:
    depths = approaching(1, 2)
    assert np.allclose(features_of(depths).drives, features_of(depths, scale=1234.0).drives, atol=1e-4)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_approach_is_found_in_noise(seed: int) -> None:
    depths = [with_board(room(), centre_of(1, 2), 5.5 - n / RATE_HZ, 0.25) for n in range(100)]
    drives = features_of(noisy(depths, seed)).drives
    felt = first_felt(drives)
    assert abs(int(felt[1, 2]) - RATE_HZ * 1.5) <= 9
    assert np.delete(felt.ravel(), COLUMNS + 2).min() == len(drives)


@pytest.mark.parametrize("seed", [0, 1])
def test_scene_that_stands_is_quiet_in_noise_with_holes(seed: int) -> None:
    scene = with_board(room(), centre_of(1, 2), 1.2, 0.2)
    features = features_of(noisy([scene] * 240, seed))
    assert not features.drives.any() and features.approaches == 0
    assert 0.5 < features.known_fraction < 1 and features.cuts == 0


def test_what_goes_away_is_not_felt() -> None:
    assert not features_of(approaching(1, 2)[::-1]).drives.any()


@pytest.mark.parametrize("frames", [30, 60])
def test_what_passes_by_is_near_and_no_approach(frames: int) -> None:
    depths = [with_board(room(), (-30 + 220 * n / frames, 45), 1.5, 0.25) for n in range(frames)]
    features = features_of(noisy(depths))
    assert features.approaches == 0
    assert 0 < features.drives.max() <= MAX_NEAR


def test_camera_that_tilts_towards_the_floor_is_quiet() -> None:
    """The nearest part of the floor comes in at the lower border, and nothing approaches."""
    rows = np.arange(HEIGHT + 60)[:, None] - 30.0
    tall = np.broadcast_to(1.2 * 150 / np.maximum(rows - 20, 25), (HEIGHT + 60, WIDTH))
    features = features_of([tall[round(0.8 * n) :][:HEIGHT].astype(np.float64) for n in range(75)])
    assert features.approaches == 0


def test_what_becomes_near_and_stays_fades() -> None:
    scene, centre = room(), centre_of(1, 2)
    depths = [scene] * 30 + [with_board(scene, centre, 1.5, 0.2)] * 300
    drive = features_of(depths).drives[:, 1, 2]
    assert not drive[:30].any() and drive[32] == pytest.approx(MAX_NEAR, abs=0.05)
    assert (np.diff(drive[32:]) <= 0).all() and not drive[200:].any()


def test_cut_to_something_near_is_not_felt() -> None:
    other = with_board(np.full((HEIGHT, WIDTH), 2.0), centre_of(1, 2), 0.5, 0.05)
    features = features_of(noisy([room()] * 40 + [other] * 60))
    assert features.cuts == 1 and not features.drives.any()


def test_missing_pictures_switch_off_and_start_anew() -> None:
    depths = approaching(1, 2, count=75)
    depths += [with_board(room(), centre_of(1, 2), 1.0, 0.2)] * 60
    times_s = [n / RATE_HZ + (2.0 if n >= 75 else 0.0) for n in range(135)]
    features = features_of(depths, times_s)
    assert features.is_uneven and features.rate_hz == pytest.approx(RATE_HZ) and features.cuts == 1
    drive = features.drives[:, 1, 2]
    last = round(74 / RATE_HZ * features.rate_hz)
    hold = round(MAX_GAP_S * features.rate_hz)
    assert drive[last + hold - 2] > 0 and not drive[last + hold + 3 :].any()
    assert len(drive) / features.rate_hz == pytest.approx(times_s[-1] + 1 / RATE_HZ, abs=0.05)


def test_lost_pictures_of_an_approach_do_not_end_it() -> None:
    depths = approaching(1, 2)
    rng = np.random.default_rng(4)
    chosen = np.sort(np.concatenate([[0, 89], rng.choice(np.arange(1, 89), 60, replace=False)]))
    features = features_of([depths[n] for n in chosen], (chosen / RATE_HZ).tolist())
    drive = features.drives[:, 1, 2]
    assert (drive[round(1.1 * features.rate_hz) :] > 0).all()
    assert np.delete(features.drives.reshape(len(drive), -1), COLUMNS + 2, axis=1).max() == 0


def test_long_pause_is_an_error() -> None:
    with pytest.raises(SourceError, match=r"3 depth pictures in 9000 s"):
        features_of([room()] * 3, (0.0, 1 / RATE_HZ, 9000.0))


def test_regions_are_those_of_the_picture() -> None:
    """A picture of 16:9 on four columns and five rows: three rows, as the track of the picture has them."""
    from touchfield.devices import device
    from touchfield.filters.device_spec import device_grid

    grid = device_grid(device("tactsuit-x40"))
    regions = Regions.of(grid, (1280, 720), (64, 36))
    assert regions.index.shape == (36, 64) and regions.index.min() == 4 and regions.index.max() == 15
    square = Regions.of(grid, (400, 400), (64, 64))
    assert sorted(np.unique(square.index)) == list(range(20))
    tall = Regions.of(grid, (300, 600), (32, 64))
    assert np.isin([1, 2, 17, 18], tall.index).all()


def test_array_of_as_many_motors_as_pixels_has_regions() -> None:
    grid = Grid.over_box((-0.16, -0.12, -0.1), (0.16, 0.12, 0.1), (32, 32, 1))
    features = depth_features(movie_depth(approaching(1, 2, count=60)), grid, (WIDTH, HEIGHT))
    rows, columns = np.nonzero(features.drives.any(axis=0))
    assert rows.min() >= 8 and rows.max() < 16 and columns.min() >= 16 and columns.max() < 24


# -- the movie ---------------------------------------------------------------------------------------------
def board_movie(count: int = 90) -> Depths:
    return approaching(1, 1, count=count)


@pytest.fixture(scope="module")
def movie(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("movie") / "movie.mp4"
    frames = pictures(90, (WIDTH, HEIGHT))
    return write_movie(path, frames, strokes((0.5,), 3.0), rate_hz=RATE_HZ)


def felt_s(path: Path) -> float:
    """When the depth of a movie is first felt, seconds of its clock."""
    folder = path.parent / f"{path.stem}-tracks"
    folder.mkdir()
    tracks, _ = touch_tracks(path, folder)
    track = next(track for track in tracks if track.name == "depth")
    with open_stream(track.path) as stream:
        assert stream.reader.head.tags == ("symbolic", "depth") and stream.medium.vibration is None
        is_on = [bool(len(stream.medium[i].bricks)) for i in range(len(stream.medium))]
    return track.at_s + is_on.index(True) / track.rate_hz


def test_movie_gets_a_third_track(movie: Path, tmp_path: Path) -> None:
    depth = write_depth_video(tmp_path / "map.mkv", board_movie())
    done = watch(movie, tmp_path / "both.mp4", WatchSpec(depth=depth))
    tracks, _ = touch_tracks(tmp_path / "both.mp4", tmp_path)
    assert [track.name for track in tracks] == ["picture", "sound", "depth"]
    assert felt_s(tmp_path / "both.mp4") == pytest.approx(0.78, abs=0.05)
    assert done.figures["approaches"] == 1 and done.figures["depth_rate_hz"] == RATE_HZ
    assert done.figures["tags"]["depth"] == ["symbolic", "depth"] and done.notes == ()
    demux(tmp_path / "both.mp4", tmp_path / "depth.touch", "depth")
    assert (tmp_path / "depth.touch").exists()


def test_track_of_depth_in_the_movie_is_used(tmp_path: Path) -> None:
    frames = pictures(90, (WIDTH, HEIGHT))
    path = write_depth_video(tmp_path / "rgbd.mkv", board_movie(), frames, title="DEPTH")
    done = watch(path, tmp_path / "both.mkv")
    assert any(note == "The depth is that of track 1 of the movie (gray16le)." for note in done.notes)
    assert felt_s(tmp_path / "both.mkv") == pytest.approx(0.78, abs=0.05)
    plain = write_movie(tmp_path / "plain.mkv", frames, rate_hz=RATE_HZ)
    watch(plain, tmp_path / "plain-both.mkv")
    for name in ("both", "plain-both"):
        demux(tmp_path / f"{name}.mkv", tmp_path / f"{name}.touch", "picture")
    with open_stream(tmp_path / "both.touch") as one, open_stream(tmp_path / "plain-both.touch") as other:
        assert len(one.medium) == len(other.medium) == 90
        assert (one.medium[60].forces_n == other.medium[60].forces_n).all()
    other_depth = write_depth_video(tmp_path / "map.mkv", [room()] * 90)
    done = watch(path, tmp_path / "both2.mkv", WatchSpec(depth=other_depth))
    assert "1 tracks of depth in the movie are copied, and not used." in done.notes
    assert done.figures["approaches"] == 0


def test_folder_of_depth_pictures_starts_by_the_times_of_the_colour(movie: Path, tmp_path: Path) -> None:
    folder = write_depth_folder(tmp_path / "rgbd", board_movie(), first_s=1000.4)
    (folder / "rgb").mkdir()
    (folder / "rgb" / "1000.000.png").write_bytes(b"x")
    (folder / "rgb.txt").write_text("# color\n999.0 rgb/999.0.png\n1000.000 rgb/1000.000.png\n")
    done = watch(movie, tmp_path / "both.mkv", WatchSpec(depth=folder))
    assert felt_s(tmp_path / "both.mkv") == pytest.approx(0.4 + 0.78, abs=0.05)
    assert any("By rgb.txt, the depth begins 0.400 s after" in note for note in done.notes)
    (folder / "rgb.txt").unlink()
    done = watch(movie, tmp_path / "both2.mkv", WatchSpec(depth=folder))
    assert felt_s(tmp_path / "both2.mkv") == pytest.approx(0.78, abs=0.05)
    assert any("shows with the first picture of the movie" in note for note in done.notes)


def test_other_rate_aspect_and_duration_are_noted(movie: Path, tmp_path: Path) -> None:
    wide = [depth[30:90] for depth in board_movie(60)]
    folder = write_depth_folder(tmp_path / "plain-depth", wide)
    notes = watch(movie, tmp_path / "both.mkv", WatchSpec(depth=folder)).notes
    for text in ("160 x 60, the picture 160 x 120", "states no times", "ends 1.00 s before the picture"):
        assert any(text in note for note in notes), text


def test_depth_that_starts_later_by_its_own_stamps(movie: Path, tmp_path: Path) -> None:
    times_s = [1.0 + n / RATE_HZ for n in range(60)]
    depth = write_depth_video(tmp_path / "late.mkv", board_movie(60), times_s=times_s)
    notes = watch(movie, tmp_path / "both.mkv", WatchSpec(depth=depth)).notes
    assert felt_s(tmp_path / "both.mkv") == pytest.approx(1.78, abs=0.05)
    assert any(note.startswith("The depth starts 1.00 s after the picture") for note in notes)


def test_depth_alone_and_depth_that_does_nothing(tmp_path: Path) -> None:
    path = write_depth_video(tmp_path / "alone.mkv", [room()] * 40)
    done = watch(path, tmp_path / "both.mkv", WatchSpec(only="depth"))
    assert any("Nothing approaches or becomes near" in note for note in done.notes)
    assert any("Without a picture" in note for note in done.notes)
    empty = write_depth_video(tmp_path / "empty.mkv", [0 * room()] * 40)
    done = watch(empty, tmp_path / "empty-both.mkv", WatchSpec(only="depth"))
    assert any("No depth is known in any picture" in note for note in done.notes)
    with pytest.raises(SourceError, match=r"a picture of deep grey.*--only depth"):
        watch(path, tmp_path / "none.mkv")


def test_what_is_no_depth_is_one_error(
    movie: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "both.mp4"
    (tmp_path / "nothing").mkdir()
    for depth, text in ((movie, "a source without depth pictures"), (tmp_path / "nothing", "nothing"),
                        (tmp_path / "missing.mkv", "nothing there")):  # fmt: skip
        assert _exit_code(["watch", str(movie), "-o", str(out), "--depth", str(depth)]) != 0
        lines = capsys.readouterr().err.splitlines()
        assert len(lines) == 1 and text in lines[0] and not out.exists()
    with pytest.raises(SourceError, match=r"no depth in the file.*--depth"):
        watch(movie, out, WatchSpec(only="depth"))
    with pytest.raises(InvalidArgument, match="only sound"):
        WatchSpec(only="sound", depth="depth.mkv")
    cut = write_depth_video(tmp_path / "cut.mkv", noisy([room()] * 30))
    cut.write_bytes(cut.read_bytes()[: cut.stat().st_size // 2])
    with pytest.raises(SourceError, match=r"cut\.mkv"):
        watch(movie, out, WatchSpec(depth=cut))
    assert not out.exists()


def test_timeline_has_a_row_for_the_depth(movie: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    from PIL import Image

    depth = write_depth_video(tmp_path / "map.mkv", board_movie())
    heights = []
    for name, options in (("a", []), ("b", ["--depth", str(depth)])):
        plot, out = tmp_path / f"{name}.png", tmp_path / f"{name}.mp4"
        assert _exit_code(["watch", str(movie), "-o", str(out), "--plot", str(plot), *options]) == 0
        with Image.open(plot) as image:
            heights.append(image.height)
    assert heights[1] > heights[0] + 100
