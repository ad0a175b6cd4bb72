"""Saliency of pictures: highlights what stands out, is causal, and becomes newtons along +z."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from touchfield.errors import InvalidArgument, MissingExtra, SourceError
from touchfield.medium import Grid
from touchfield.pipeline import prepare
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.images import movies
from touchfield.sources.images.movies import ColourPictures
from touchfield.sources.images.pictures import MAX_PIXELS
from touchfield.sources.laws import ForceProfile, LawSpec, profile_of
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import open_source
from touchfield.sources.video import saliency
from touchfield.sources.video.saliency import FADE_S, FLOORS, SaliencyMaps, SaliencyModel, SaliencyScene
from video_makers import write_video

HEIGHT, WIDTH, COUNT = 48, 64, 20
AS = SourceOptions(kind="saliency")
LAW = profile_of(LawSpec("penalty", 500.0, 3.3), 0.0066)


def blob_position(frame: int) -> tuple[int, int]:
    """Row and column of the blob, which moves from left to right and up and down."""
    return round(24 + 12 * np.sin(frame / 3)), 8 + 2 * frame % 48


def picture(frame: int, colour: tuple[int, int, int] = (240, 230, 80)) -> np.ndarray:
    """A bright blob of 6 pixels on dark ground."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    row, column = blob_position(frame)
    colours = np.full((HEIGHT, WIDTH, 3), 40, np.uint8)
    colours[(v - row) ** 2 + (u - column) ** 2 <= 9] = colour
    return colours


class Drawn:
    """Pictures in memory, with a list of those read."""

    size = (WIDTH, HEIGHT)

    def __init__(self, frames: list[np.ndarray] | None = None) -> None:
        self.frames = [picture(i) for i in range(COUNT)] if frames is None else frames
        self.frame_count = len(self.frames)
        self.read: list[int] = []

    def values(self, frame: int) -> np.ndarray:
        self.read.append(frame)
        return self.frames[frame]


def gif(path: Path, count: int = COUNT, **more: object) -> Path:
    first, *rest = [Image.fromarray(picture(i)) for i in range(count)]
    first.save(path, save_all=True, append_images=rest, **{"duration": 40, **more})
    return path


def run(frames: list[np.ndarray], rate_hz: float = 25.0) -> list[np.ndarray]:
    model, maps = SaliencyModel(rate_hz), []
    for colours in frames:
        found, model = model.update(colours)
        maps.append(found)
    return maps


def peak(values: np.ndarray) -> tuple[int, int]:
    row, column = np.unravel_index(values.argmax(), values.shape)
    return int(row), int(column)


# -- the model ---------------------------------------------------------------------------------------------


def test_the_peak_follows_the_blob() -> None:
    for frame, found in enumerate(run([picture(i) for i in range(COUNT)])):
        assert np.hypot(*np.subtract(peak(found), blob_position(frame))) <= 4, frame
        assert found.dtype == np.float32 and found.min() >= 0 and 0.7 < found.max() <= 1


def test_a_colour_of_the_same_luminance_stands_out() -> None:
    """Red on grey of equal luminance: only the colour opponents differ."""
    grey = np.full((HEIGHT, WIDTH, 3), round(0.299 * 200 + 0.587 * 60 + 0.114 * 60), np.uint8)
    grey[20:26, 40:46] = (200, 60, 60)
    assert abs(peak(run([grey])[0])[0] - 22.5) <= 3 and abs(peak(run([grey])[0])[1] - 42.5) <= 3


def test_the_moving_one_of_two_equal_objects_stands_out() -> None:
    frames = []
    for i in range(12):
        colours = np.full((HEIGHT, WIDTH, 3), 60, np.uint8)
        colours[10:16, 10:16] = colours[30:36, 20 + 2 * i : 26 + 2 * i] = 200
        frames.append(colours)
    last = run(frames)[-1]
    assert last[30:36, 42:48].max() > 1.2 * last[10:16, 10:16].max() > 0


def test_nothing_stands_out_of_an_even_picture_and_little_of_noise() -> None:
    even = np.full((HEIGHT, WIDTH, 3), 128, np.uint8)
    assert max(found.max() for found in run([even] * 3)) == 0
    random = np.random.default_rng(3)
    noisy = [np.clip(random.normal(128, 2, even.shape), 0, 255).astype(np.uint8) for _ in range(5)]
    assert max(found.max() for found in run(noisy)) < 0.4


def test_a_map_is_causal() -> None:
    frames = [picture(i) for i in range(COUNT)]
    other = [*frames[:8], *(255 - f for f in frames[8:])]
    for now, other_map in zip(run(frames)[:8], run(other)[:8], strict=True):
        assert np.array_equal(now, other_map)
    assert not np.array_equal(run(frames)[8], run(other)[8])


def test_the_scale_does_not_jump_when_a_bright_thing_leaves() -> None:
    """The remaining object grows to the full scale gradually."""
    small = np.full((HEIGHT, WIDTH, 3), 60, np.uint8)
    small[20:26, 50:56] = 120
    both = small.copy()
    both[30:38, 8:16] = 255
    maps = run([both] * 50 + [small] * 200)
    peaks = [found[20:26, 50:56].max() for found in maps]
    # 1/25 s of a scale that decays in 2 s
    steps = np.diff(peaks[52:])
    assert peaks[49] < 0.75 and peaks[-1] > 0.95
    assert steps.max() < 0.05 and steps.min() > -0.05


def test_a_model_is_never_changed() -> None:
    model = SaliencyModel(25.0)
    _, updated = model.update(picture(0))
    first, _ = updated.update(picture(1))
    updated.update(picture(9))
    assert np.array_equal(first, updated.update(picture(1))[0]) and model.mean is None


def test_a_model_refuses_invalid_pictures_and_rates() -> None:
    _, updated = SaliencyModel(25.0).update(picture(0))
    with pytest.raises(InvalidArgument, match="as before"):
        updated.update(picture(0)[:-1])
    for rate_hz in (0.0, np.nan, np.inf):
        with pytest.raises(InvalidArgument, match="rate_hz"):
            SaliencyModel(rate_hz)


@pytest.mark.parametrize(("width", "height"), [(1, 1), (640, 480), (480, 640), (2000, 3), (64, 64), (65, 2)])
def test_the_reduced_picture(width: int, height: int) -> None:
    columns, rows = movies.map_size(width, height)
    assert max(columns, rows) == min(64, max(width, height)) and min(columns, rows) >= 1
    colours = np.full((height, width, 3), 77, np.uint8)
    small = movies.reduced(colours)
    assert small.shape == (rows, columns, 3) and (small == 77).all()
    assert SaliencyModel(25.0).update(colours)[0].max() == 0


# -- maps in any order -------------------------------------------------------------------------------------


def test_maps_in_any_order_are_those_in_sequence() -> None:
    pictures = Drawn()
    maps = SaliencyMaps(pictures, 25.0)
    expected = run(pictures.frames)
    for frame in [*range(COUNT), 3, 19, 0, 12, 11, 12]:
        assert np.array_equal(maps.at(frame), expected[frame]), frame


def test_a_pass_in_order_reads_each_picture_once() -> None:
    pictures = Drawn()
    maps = SaliencyMaps(pictures, 25.0)
    for frame in range(COUNT):
        maps.at(frame)
        maps.at(frame)
    assert pictures.read == list(range(COUNT))


# -- the scene ---------------------------------------------------------------------------------------------


def test_the_field_is_saliency_in_newtons_along_z() -> None:
    scene = SaliencyScene(Drawn(), 25.0)
    assert scene.tags == ("symbolic",) and not scene.is_solid and scene.axes.startswith("x right, y up")
    assert np.allclose(scene.bounds_m(), [[-0.5, -0.375, -0.025], [0.5, 0.375, 0.025]])
    cell = 1 / WIDTH
    on_cells = Grid((WIDTH, HEIGHT, 6), (cell, cell, 0.01), (-0.5 + cell / 2, -0.375 + cell / 2, -0.025))
    forces = scene.field(5, on_cells, LAW).to_dense()
    expected = 3.3 * scene.saliency(5)[::-1].T  # row 0 is at the top
    expected[expected < 1e-5] = 0
    inside = np.abs(-0.025 + 0.01 * np.arange(6)) <= 0.025
    assert inside.sum() == 6
    assert np.allclose(forces[..., 2], expected[:, :, None], atol=1e-5) and not forces[..., :2].any()
    beyond = Grid((WIDTH, HEIGHT, 2), (cell, cell, 0.06), (-0.5 + cell / 2, -0.375 + cell / 2, -0.03))
    assert not scene.field(5, beyond, LAW).support_count


def test_the_force_is_zero_outside_and_linear_between_cells() -> None:
    scene = SaliencyScene(Drawn(), 25.0)
    grid = Grid((97, 61, 1), (0.0125, 0.02, 0.01), (-0.6, -0.6, 0.0))
    forces = scene.field(3, grid, LAW).to_dense()[:, :, 0, 2]
    x, y = -0.6 + 0.0125 * np.arange(97), -0.6 + 0.02 * np.arange(61)
    assert not forces[np.abs(x) > 0.501].any() and not forces[:, np.abs(y) > 0.376].any()
    values = scene.saliency(3)
    for i, j in ((40, 30), (50, 25), (33, 36)):
        u, v = 64 * (x[i] + 0.5) - 0.5, 64 * (0.375 - y[j]) - 0.5
        a, b = int(u), int(v)
        s, t = u - a, v - b
        corners = values[b : b + 2, a : a + 2]
        expected = (1 - t) * ((1 - s) * corners[0, 0] + s * corners[0, 1])
        expected += t * ((1 - s) * corners[1, 0] + s * corners[1, 1])
        assert forces[i, j] == pytest.approx(3.3 * expected, abs=1e-5)


def test_a_peak_fades_by_time_and_not_by_pictures() -> None:
    for rate_hz in (4.0, 12.0):
        _, first = SaliencyModel(rate_hz).update(picture(0))
        model = first
        for _ in range(round(FADE_S * rate_hz)):
            _, model = model.update(np.full((HEIGHT, WIDTH, 3), 40, np.uint8))
        assert model.peaks[:2] == pytest.approx(
            np.maximum(np.exp(-1) * np.array(first.peaks[:2]), FLOORS[:2])
        )
        assert first.peaks[0] > 3 * FLOORS[0]


def test_the_amplitude_is_the_largest_of_the_law() -> None:
    scene, grid = SaliencyScene(Drawn(), 25.0), Grid((64, 48, 1), (1 / 64,) * 3, (-0.49, -0.37, 0.0))
    largest = scene.saliency(0).max()
    for pieces, force in (
        (((-0.01, 0.0, 0.0, -200.0),), 2.0),
        (((-np.inf, -0.1, 1.5, 0.0), (0.0, 0.1, 0.5, 5.0)), 1.5),
        (((-0.01, 0.0, 0.0, -200.0), (0.0, 0.1, 2.5, 0.0)), 2.5),
    ):
        maximum_n = scene.field(0, grid, ForceProfile(pieces)).to_dense()[..., 2].max()
        assert 0.8 * force * largest < maximum_n <= force * largest * (1 + 1e-6)


def test_the_strongest_tactor_follows_the_blob() -> None:
    medium = prepare(SaliencyScene(Drawn(), 25.0), EncodeSpec(device="tshirt-32x32")).medium
    assert medium.tags == ("symbolic",) and medium.grid.shape == (32, 32, 1)
    for frame in range(0, COUNT, 3):
        amplitudes = medium[frame].to_dense()[:, :, 0, 2]
        column, row = np.unravel_index(amplitudes.argmax(), amplitudes.shape)
        at = medium.grid.to_m((column, row, 0))[:2] / 0.4 * WIDTH  # 64 pixels over the 400 mm of the shirt
        v, u = blob_position(frame)
        assert np.hypot(at[0] - (u + 0.5 - 32), at[1] - (24 - v - 0.5)) <= 5, frame
        assert 1.0 < amplitudes.max() <= 3.3


def test_a_point_device_gets_a_slab() -> None:
    field = prepare(SaliencyScene(Drawn(), 25.0), EncodeSpec(nw=4)).medium[2]
    assert field.support_count and not field.vectors_n()[:, :2].any()
    assert np.ptp(field.positions()[:, 2]) < 8  # of 16 samples along the line of sight


def test_frames_are_repeated_at_a_higher_rate_and_skipped_at_a_lower_one() -> None:
    for rate_hz, count, source_frames in (
        (100.0, 80, [0, 0, 0, 0, 1, 1]),
        (10.0, 8, [0, 2, 5, 7, 10, 12, 15, 17]),
    ):
        scene = SaliencyScene(Drawn(), 25.0, rate_hz)
        assert (scene.frame_count, scene.rate_hz) == (count, rate_hz)
        for frame, source in enumerate(source_frames):
            assert np.array_equal(scene.saliency(frame), run(scene.maps.pictures.frames[: source + 1])[-1])
    with pytest.raises(InvalidArgument, match="0 to 7"):
        scene.saliency(8)
    with pytest.raises(InvalidArgument, match="lower --rate-hz"):
        SaliencyScene(Drawn(), 25.0, 1e9)
    assert SaliencyScene(Drawn([picture(0)]), 25.0, 1000.0).frame_count == 1


# -- files -------------------------------------------------------------------------------------------------


def test_a_video_is_recognised_and_its_peak_follows(tmp_path: Path) -> None:
    pytest.importorskip("av")
    path = write_video(tmp_path / "a.mkv", np.stack([picture(i) for i in range(COUNT)]), "bgr0")
    scene = open_source(path)
    assert isinstance(scene, SaliencyScene)
    assert (scene.frame_count, scene.rate_hz) == (COUNT, 25.0)
    for frame, found in enumerate(run([picture(i) for i in range(COUNT)])):
        assert np.array_equal(scene.saliency(frame), found)
    assert open_source(path, SourceOptions(rate_hz=50.0)).frame_count == 2 * COUNT
    deep = write_video(tmp_path / "deep.mkv", np.full((3, 20, 30), 900, np.uint16), "gray16le")
    assert not saliency.KIND.recognise(deep)
    with pytest.raises(SourceError, match="depth-video"):
        open_source(deep, AS)


def test_without_the_extra_pictures_are_read_and_a_video_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    Image.fromarray(picture(0)).save(tmp_path / "a.jpg")
    assert open_source(tmp_path / "a.jpg", AS).frame_count == 1
    for name in ("a.mp4", "a.gif"):
        (tmp_path / name).write_bytes(b"anything")
        with pytest.raises(MissingExtra, match=r"touchfield\[video\]"):
            open_source(tmp_path / name, AS)


def test_a_gif_in_any_order(tmp_path: Path) -> None:
    pytest.importorskip("av")
    path = gif(tmp_path / "a.gif")
    assert saliency.KIND.recognise(path)
    pictures = movies.ColourVideo(path)
    assert (pictures.frame_count, pictures.rate_hz) == (COUNT, 25.0)
    for frame in [*range(COUNT), 4, 3, 19, 0]:
        difference = np.abs(pictures.values(frame).astype(int) - picture(frame))
        assert difference.max() <= 8, frame  # a palette
    assert open_source(path).rate_hz == 25.0
    clear = Image.fromarray(np.zeros((HEIGHT, WIDTH, 4), np.uint8))
    clear.save(tmp_path / "clear.gif")
    assert not movies.ColourVideo(tmp_path / "clear.gif").values(0).any()


@pytest.mark.parametrize("name", ["a.webp", "a.png"])
def test_other_animated_pictures_are_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(SourceError, match=r"a picture that moves.*a video or a GIF"):
        open_source(gif(tmp_path / name), AS)


def test_a_folder_of_pictures_only_if_it_is_named(tmp_path: Path) -> None:
    for i in range(11):
        Image.fromarray(picture(i)).save(tmp_path / f"{i}.png")
    assert not saliency.KIND.recognise(tmp_path)
    scene = open_source(tmp_path, SourceOptions(kind="saliency", rate_hz=12.5))
    assert (scene.frame_count, scene.rate_hz) == (11, 12.5)
    assert isinstance(scene, SaliencyScene)
    assert np.array_equal(scene.saliency(10), run([picture(i) for i in range(11)], 12.5)[10])  # by number
    slow = open_source(tmp_path, SourceOptions(kind="saliency", source_rate_hz=5.0, rate_hz=10.0))
    assert (slow.frame_count, slow.rate_hz) == (22, 10.0)
    Image.fromarray(picture(11)[:-1]).save(tmp_path / "11.png")
    other = open_source(tmp_path, AS)
    with pytest.raises(SourceError, match=r"11\.png: found 64 x 47 pixels"):
        other.field(11, Grid((8, 8, 8), (0.1,) * 3, (-0.4,) * 3), LAW)


def test_the_pictures_of_files_in_any_order(tmp_path: Path) -> None:
    paths = tuple(tmp_path / f"{i}.png" for i in range(6))
    for i, path in enumerate(paths):
        Image.fromarray(picture(i)).save(path)
    pictures = ColourPictures(paths)
    for frame in (4, 0, 2, 3, 5, 1):
        assert np.array_equal(pictures.values(frame), picture(frame)), frame


def test_a_single_picture_is_upright_and_transparency_is_black(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[0x0112] = 6  # to be rotated clockwise by a quarter
    Image.fromarray(picture(0)).save(tmp_path / "a.jpg", exif=exif, quality=95)
    pictures = ColourPictures((tmp_path / "a.jpg",))
    assert (pictures.size, pictures.frame_count, pictures.rate_hz) == ((HEIGHT, WIDTH), 1, None)
    assert np.abs(pictures.values(0).astype(int) - np.rot90(picture(0), -1)).mean() < 5
    clear = np.dstack([picture(0), np.zeros((HEIGHT, WIDTH), np.uint8)])
    Image.fromarray(clear, "RGBA").save(tmp_path / "clear.png")
    assert not ColourPictures((tmp_path / "clear.png",)).values(0).any()
    assert open_source(tmp_path / "a.jpg", AS).frame_count == 1


def test_invalid_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(SourceError, match="no picture"):
        open_source(tmp_path / "empty", AS)
    Image.fromarray(np.full((9, 9), 900, np.uint16)).save(tmp_path / "deep.png")
    with pytest.raises(SourceError, match="8 bits a colour"):
        open_source(tmp_path / "deep.png", AS)
    (tmp_path / "text.gif").write_text("no picture")
    with pytest.raises(SourceError, match="a video that cannot be read"):
        open_source(tmp_path / "text.gif", AS)
    intact = gif(tmp_path / "a.gif").read_bytes()
    for fraction in (0.002, 0.1, 0.5, 0.9):
        (tmp_path / "cut.gif").write_bytes(intact[: int(fraction * len(intact))])
        try:
            scene = open_source(tmp_path / "cut.gif", AS)
            assert isinstance(scene, SaliencyScene) and scene.frame_count < COUNT
            scene.saliency(scene.frame_count - 1)
        except SourceError:
            continue
    header = bytearray(intact)
    header[6:10] = b"\x20\x4e\x10\x27"  # 20000 x 10000 pixels
    (tmp_path / "large.gif").write_bytes(header)
    with pytest.raises(SourceError, match=f"at most {MAX_PIXELS} pixels"):
        open_source(tmp_path / "large.gif")


def test_a_depth_scale_requests_depth_instead_of_saliency(tmp_path: Path) -> None:
    path = gif(tmp_path / "blob.gif")
    with pytest.raises(SourceError, match=r"blob\.gif.*16-bit grey depth.*--as saliency"):
        open_source(path, SourceOptions(depth_scale=1000.0))
    assert open_source(path, SourceOptions(depth_scale=1000.0, kind="saliency")).tags == ("symbolic",)


def expected_maps(frames: list[np.ndarray], rate_hz: float) -> list[np.ndarray]:
    """An independent implementation of the model: three parts, each normalised by its peak, and
    their normalised mean.
    """
    mean, peaks, maps = None, np.zeros(4), []
    for colours in frames:
        r, g, b = (colours[..., n] / 255.0 for n in range(3))
        channels = [0.299 * r + 0.587 * g + 0.114 * b, r - g, b - (r + g) / 2]
        mean = channels if mean is None else mean
        centre, surround = (
            [ndimage.gaussian_filter(c, sigma, mode="nearest") for c in channels] for sigma in (1.5, 8.0)
        )
        contrast = sum(np.abs(c - s) for c, s in zip(centre, surround, strict=True))
        moves = ndimage.gaussian_filter(
            sum(np.abs(c - m) for c, m in zip(channels, mean, strict=True)), 1.0, mode="nearest"
        )
        spectrum = np.fft.fft2(channels[0] - channels[0].mean())
        size = np.abs(spectrum) + 0.02 * np.sqrt(spectrum.size)
        neighbours = sum(np.roll(np.log(size), (i, j), (0, 1)) for i in (-1, 0, 1) for j in (-1, 0, 1)) / 9
        residual = np.abs(np.fft.ifft2(spectrum / size * np.exp(np.log(size) - neighbours))) ** 2
        residual = ndimage.gaussian_filter(residual, 2.0, mode="nearest") * 2 * np.pi * 2.0**2
        parts = [residual, contrast, moves]
        fade = np.exp(-1 / (2.0 * rate_hz))
        for n, (part, floor) in enumerate(zip(parts, (0.02, 0.15, 0.15), strict=True)):
            peaks[n] = max(part.max(), fade * peaks[n], floor)
        total = sum(part / peaks[n] for n, part in enumerate(parts)) / 3
        peaks[3] = max(total.max(), fade * peaks[3], 1 / 3)
        maps.append(np.clip(total / peaks[3], 0, 1))
        rate = 1 - np.exp(-1 / (0.3 * rate_hz))
        mean = [m + rate * (c - m) for m, c in zip(mean, channels, strict=True)]
    return maps


@pytest.mark.parametrize("rate_hz", [5.0, 60.0])
def test_a_map_equals_the_formulas(rate_hz: float) -> None:
    rng = np.random.default_rng(3)
    frames = [np.clip(rng.normal(100, 20, (36, 50, 3)), 0, 255).astype(np.uint8) for _ in range(4)]
    frames[1][5:12, 30:40, 0] = 250  # red, then blue elsewhere, then absent
    frames[2][20:30, 4:12, 2] = 255
    for found, expected in zip(run(frames, rate_hz), expected_maps(frames, rate_hz), strict=True):
        np.testing.assert_allclose(found, expected, atol=2e-4)
        assert 0.05 < expected.mean() < 0.9
