"""A folder of media: indexed once, re-indexed only where changed, searched, compared, correlated
with pictures.
"""

from __future__ import annotations

import itertools
import json
import os
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

import touchfield as tf
from medium_corpus import GRID, PROFILE, shape
from touchfield.cli.main import _exit_code
from touchfield.errors import InvalidArgument, SourceError
from touchfield.measure.retrieval import ANY_POSE, WEIGHTS, MediumIndex
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.tasks import library as room
from touchfield.tasks.library import Library, correlate, index_folder, library_path, search, similar

BODIES = ("sphere", "plate", "torus")


def body(
    kind: str, size_m: float = 0.05, frames: int = 1, grid: tf.Grid = GRID, rate_hz: float = 30.0
) -> tf.HapticMedium:
    """A static body, or one that swells a little from frame to frame."""
    fields = [
        AnalyticScene([shape(kind, size_m * (1 + 0.02 * n))]).field(0, grid, PROFILE) for n in range(frames)
    ]
    return tf.HapticMedium.from_frames(fields, rate_hz, "x right, y up, z towards the viewer")


@pytest.fixture(scope="module")
def media_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two sizes of each body, one of them in a subfolder, a damaged file and one
    without a force.
    """
    folder = tmp_path_factory.mktemp("library") / "media"
    (folder / "deeper").mkdir(parents=True)
    for kind in BODIES:
        tf.encode(body(kind), folder / f"{kind}.touch")
        tf.encode(body(kind, 0.06), folder / "deeper" / f"{kind}-large.touch")
    intact = (folder / "sphere.touch").read_bytes()
    (folder / "cut.touch").write_bytes(intact[:-200])
    tf.encode(tf.ForceField.empty(GRID), folder / "still.touch", allow_empty=True)
    (folder / "notes.txt").write_text("no medium")
    return folder


@pytest.fixture
def folder(media_folder: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(media_folder, tmp_path / "media"))


@pytest.fixture
def decoded(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The names of the decoded files."""
    names: list[str] = []

    def record(path: Path) -> tf.HapticMedium:
        names.append(Path(path).name)
        return tf.decode(path)

    monkeypatch.setattr(room, "decode", record)
    return names


# -- indexing ----------------------------------------------------------------------------------------------


def test_every_medium_is_indexed_and_faults_are_reported(folder: Path) -> None:
    steps: list[tuple[int, int]] = []
    done = index_folder(folder, report=lambda n, total: steps.append((n, total)))
    assert done.path == folder.parent / "media.index.npz" and done.path.is_file()
    names = {f"{kind}.touch" for kind in BODIES} | {f"deeper/{kind}-large.touch" for kind in BODIES}
    assert set(done.library.rows) == names
    assert set(done.faults) == {"cut.touch", "still.touch"}
    assert (done.figures["described"], done.figures["left_out"]) == (6, 2), "who is left out is not described"
    with pytest.raises(SourceError, match=r"still\.touch, medium: found no force"):
        search(folder, folder / "still.touch")
    assert "expected" in done.faults["cut.touch"] and "no force" in done.faults["still.touch"]
    assert steps[-1] == (8, 8)
    index = MediumIndex.load(done.path)
    assert set(index.names) == names, "the file is an index for any program"
    for name in names:
        assert index[name] == tf.measure.descriptor(tf.decode(folder / name))


def test_a_folder_without_media_is_noted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "bare").mkdir()
    assert _exit_code(["index", str(tmp_path / "bare")]) == 0
    assert "note: no .touch file in" in capsys.readouterr().out
    assert _exit_code(["index", str(tmp_path / "bare"), "--json"]) == 0
    assert "no .touch file in" in json.loads(capsys.readouterr().out)["notes"][0]


def test_only_changed_files_are_decoded_again(folder: Path, decoded: list[str]) -> None:
    first = index_folder(folder)
    assert len(decoded) == 8
    decoded.clear()
    before = first.path.read_bytes()
    again = index_folder(folder)
    assert not decoded and again.figures["described"] == 0 and again.figures["kept"] == 6
    assert first.path.read_bytes() == before
    os.utime(folder / "sphere.touch", ns=(1, 1))  # a new time, the same bytes
    (folder / "torus.touch").rename(folder / "ring.touch")
    shutil.copyfile(folder / "plate.touch", folder / "copy.touch")
    third = index_folder(folder)
    assert not decoded and third.figures["gone"] == 1
    assert {"ring.touch", "copy.touch"} < set(third.library.rows) and "torus.touch" not in third.library.rows
    tf.encode(body("lens"), folder / "plate.touch")
    (folder / "cut.touch").unlink()
    fourth = index_folder(folder)
    assert decoded == ["plate.touch"]
    assert set(fourth.faults) == {"still.touch"}
    fresh = Library.load(index_folder(folder, folder.parent / "fresh.npz").path)
    stored = Library.load(fourth.path)
    assert stored.entries == fresh.entries
    assert all(np.array_equal(stored.rows[name], fresh.rows[name]) for name in fresh.rows)


def test_an_outdated_index_is_made_anew(
    folder: Path, decoded: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr("touchfield.measure.retrieval.DESCRIPTOR_VERSION", 1)
        index_folder(folder)
    assert _exit_code(["search", str(folder), str(folder / "torus.touch")]) != 0
    message = capsys.readouterr().err
    assert "descriptors of version 1" in message and "Make it anew: touchfield index" in message
    decoded.clear()
    done = index_folder(folder)
    assert len(decoded) == 8 and any("version 1" in note for note in done.notes)
    assert not index_folder(folder).notes
    assert (
        search(folder, folder / "torus.touch", 1).figures["matches"][0]["name"] == "deeper/torus-large.touch"
    )


def test_a_file_that_could_not_be_opened_is_tried_again(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = Path.open

    def refused(self: Path, *args: str, **more: str) -> object:
        if self.name == "torus.touch":
            raise PermissionError(13, "Permission denied", str(self))
        return opened(self, *args, **more)  # type: ignore[call-overload]

    def unread(path: Path) -> tf.HapticMedium:
        with Path(path).open("rb"):
            return tf.decode(path)

    monkeypatch.setattr(Path, "open", refused)
    monkeypatch.setattr(room, "decode", unread)
    assert "Permission" in index_folder(folder).faults["torus.touch"]
    monkeypatch.undo()
    assert "torus.touch" in index_folder(folder).library.rows


@pytest.mark.parametrize("kind", [KeyboardInterrupt, SystemExit])
def test_an_interrupted_run_is_resumed(
    folder: Path, decoded: list[str], monkeypatch: pytest.MonkeyPatch, kind: type[BaseException]
) -> None:
    counted = itertools.count()

    def broken(done: int, total: int) -> None:
        if next(counted) == 4:
            raise kind

    with pytest.raises(kind):
        index_folder(folder, report=broken)
    saved = Library.load(library_path(folder))
    assert len(saved.entries) == 4
    decoded.clear()
    complete = index_folder(folder)
    assert set(decoded).isdisjoint(Path(name).name for name in saved.entries)
    assert len(complete.library.entries) == 8


def test_the_index_is_saved_during_a_run(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(room, "SAVE_EVERY_S", 0.0)
    counts: list[int] = []
    save = Library.save

    def record(self: Library, path: Path) -> None:
        counts.append(len(self.entries))
        save(self, path)

    monkeypatch.setattr(Library, "save", record)
    index_folder(folder)
    assert counts[0] < 8 and counts[-1] == 8 and counts == sorted(counts)


@pytest.mark.parametrize(
    "harm",
    [
        lambda data: b"",
        lambda data: data[: len(data) // 2],
        lambda data: data.replace(b"plate.touch", b"plate.to\xff\xff\xff"),
        lambda data: b"not a zip" * 100,
    ],
)
def test_a_damaged_index_is_refused(folder: Path, harm: Callable[[bytes], bytes]) -> None:
    path = index_folder(folder).path
    path.write_bytes(harm(path.read_bytes()))
    with pytest.raises(SourceError):
        search(folder, folder / "sphere.touch")


def test_an_index_of_another_program_is_refused(folder: Path) -> None:
    MediumIndex().save(library_path(folder))
    with pytest.raises(SourceError, match="touchfield index"):
        index_folder(folder)


@pytest.mark.parametrize(
    "harm", [lambda data: b"", lambda data: data[: len(data) // 2], lambda data: data[:-30] + bytes(30)]
)
def test_a_damaged_index_is_made_anew(
    folder: Path, harm: Callable[[bytes], bytes], capsys: pytest.CaptureFixture[str]
) -> None:
    path = folder.parent / "an index.npz"
    intact = index_folder(folder, path).path.read_bytes()
    path.write_bytes(harm(intact))
    search_it = ["search", str(folder), str(folder / "torus.touch"), "--index", str(path)]
    assert _exit_code(search_it) == 1
    assert f"Make it anew: touchfield index {folder} --index '{path}'" in capsys.readouterr().err
    (note,) = index_folder(folder, path).notes
    assert f"{path} is damaged" in note and path.read_bytes() == intact
    assert _exit_code(search_it) == 0


@pytest.mark.parametrize("data", [b"no index", b"PK\3\4" + b"another archive" * 100])
def test_a_file_that_is_no_index_is_not_replaced(folder: Path, data: bytes) -> None:
    path = folder.parent / "other.npz"
    path.write_bytes(data)
    with pytest.raises(SourceError, match="Delete it, or name another file: --index"):
        index_folder(folder, path)
    assert path.read_bytes() == data


def test_the_counts_of_an_index_add_up(folder: Path) -> None:
    for described in (6, 0, 1):
        figures = index_folder(folder).figures
        assert figures["files"] == figures["media"] + figures["left_out"] == 8
        assert figures["media"] == figures["described"] + figures["kept"]
        assert figures["described"] == described
        tf.encode(body("lens"), folder / "plate.touch") if not described else None


def test_linked_folders_are_indexed_once_and_cycles_end(folder: Path, tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    (elsewhere / "more").mkdir(parents=True)
    shutil.copy(folder / "torus.touch", elsewhere / "more" / "far.touch")
    (elsewhere / "again").symlink_to(elsewhere)
    (folder / "far").symlink_to(elsewhere)
    (folder / "deeper" / "far").symlink_to(elsewhere / "more")  # of which "far" is walked, too
    (folder / "own").symlink_to(folder / "deeper")
    (folder / "up").symlink_to(tmp_path)
    (folder / "self").symlink_to(folder)
    done = index_folder(folder)
    assert [name for name in done.library.rows if "far" in name] == ["deeper/far/far.touch"]
    assert not any(name.startswith(("own/", "up/", "self/")) for name in done.library.entries)
    links = "links to folders that are indexed already or contain this one, left out"
    assert done.notes == (f"5 {links}, such as far/again",)
    again = index_folder(folder)
    assert again.figures["described"] == 0 and again.figures["gone"] == 0
    matches = search(folder, folder / "torus.touch").figures["matches"]
    assert matches[0]["name"] == "deeper/far/far.touch"


def test_a_folder_that_may_not_be_read_is_noted(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scandir = os.scandir

    def refuse(path: str) -> Any:
        if Path(path).name == "deeper":
            raise PermissionError(13, "Permission denied", str(path))
        return scandir(path)

    monkeypatch.setattr(os, "scandir", refuse)
    done = index_folder(folder)
    assert done.notes == ("1 folder that this user may not read, left out, such as deeper",)
    assert "plate.touch" in done.library.rows and "deeper/plate-large.touch" not in done.library.rows


def test_a_link_to_a_file_that_is_gone_is_noted(folder: Path) -> None:
    (folder / "deeper" / "lost.touch").symlink_to(folder / "nowhere.touch")
    (folder / "linked.touch").symlink_to(folder / "torus.touch")
    done = index_folder(folder)
    assert done.notes == ("1 link to files that are not there, left out, such as deeper/lost.touch",)
    assert "linked.touch" in done.library.rows


def test_an_index_whose_files_are_all_gone_finds_nothing(folder: Path) -> None:
    medium = tf.decode(folder / "torus.touch")
    index_folder(folder)
    for path in folder.rglob("*.touch"):
        path.unlink()
    with pytest.raises(SourceError, match="no medium that is still there"):
        search(folder, medium)


@pytest.mark.parametrize("weight", ["amplitude=-1", "shape=2", "shells=nan"])
def test_a_wrong_weight_names_the_option(
    folder: Path, weight: str, capsys: pytest.CaptureFixture[str]
) -> None:
    index_folder(folder)
    assert _exit_code(["search", str(folder), str(folder / "torus.touch"), "--weight", weight]) == 2
    assert capsys.readouterr().err.startswith("touchfield: --weight: found ")


def test_the_suggested_command_can_be_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "q 'q"
    folder.mkdir()
    tf.encode(body("torus"), folder / "torus.touch")
    assert _exit_code(["search", str(folder), str(folder / "torus.touch")]) == 1
    command = capsys.readouterr().err.strip().partition("Make it: touchfield ")[2]
    assert _exit_code(shlex.split(command)) == 0
    assert not search(folder, folder / "torus.touch").notes


def test_a_missing_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidArgument, match="no folder"):
        index_folder(tmp_path / "nowhere")


# -- searching ---------------------------------------------------------------------------------------------


def nearest(folder: Path, like: Any, weights: dict[str, float] | None = None) -> str:
    return str(search(folder, like, 1, weights).figures["matches"][0]["name"])


def test_the_nearest_is_of_the_same_kind(folder: Path) -> None:
    index_folder(folder)
    for kind in BODIES:
        found = search(folder, folder / f"{kind}.touch", 3)
        names, distances = ([row[key] for row in found.figures["matches"]] for key in ("name", "distance"))
        assert names[0] == f"deeper/{kind}-large.touch"
        assert f"{kind}.touch" not in names and len(names) == 3
        assert distances == sorted(distances)
        assert nearest(folder, body(kind, 0.057)).startswith(("deeper/" + kind, kind))
    assert nearest(folder, folder / "sphere.touch", ANY_POSE) == "deeper/sphere-large.touch"


def test_a_medium_outside_the_folder_is_described_for_the_query(folder: Path, tmp_path: Path) -> None:
    index_folder(folder)
    tf.encode(body("torus", 0.045), tmp_path / "like.touch")
    assert "torus" in nearest(folder, tmp_path / "like.touch")


def test_changes_since_the_index_are_noted(folder: Path) -> None:
    index_folder(folder)
    assert not search(folder, folder / "sphere.touch").notes
    tf.encode(body("lens"), folder / "sphere.touch")
    (folder / "plate.touch").unlink()
    found = search(folder, folder / "sphere.touch")
    assert found.notes[0].startswith("1 file changed") and found.notes[1].startswith(
        "1 file of the index gone"
    )
    assert "plate.touch" not in [row["name"] for row in found.figures["matches"]]
    assert len(search(folder, folder / "sphere.touch", 1).figures["matches"]) == 1
    expected = tf.measure.descriptor(tf.decode(folder / "sphere.touch"))
    best = MediumIndex.load(library_path(folder)).query(expected)
    assert found.figures["matches"][0]["distance"] == next(
        m.distance for m in best if m.name not in ("sphere.touch", "plate.touch")
    )
    index_folder(folder)
    (folder / "torus.touch").unlink()
    index_folder(folder)
    assert not search(folder, folder / "sphere.touch").notes, "a file that is gone is gone from the index"


def test_error_of_a_missing_index_names_the_command(folder: Path) -> None:
    with pytest.raises(SourceError, match=r"touchfield index .*media"):
        search(folder, folder / "sphere.touch")


# -- two media ---------------------------------------------------------------------------------------------


def test_a_medium_is_like_itself_and_less_like_others() -> None:
    torus = body("torus", frames=2)
    same, other = similar(torus, torus), similar(torus, body("plate", frames=2))
    assert same.figures["normalised"]["value"] == 1.0 and same.figures["variation"]["value"] == 0.0
    assert same.figures["descriptor_distance"] == 0.0 and not same.notes
    assert other.figures["normalised"]["value"] < 0.5 and other.figures["jensen_shannon"]["value"] > 0.1
    assert other.figures["descriptor_distance"] > 0.2
    parts = other.figures["descriptor_parts"]
    squares = [WEIGHTS.get(part, 1.0) * value**2 for part, value in parts.items()]
    assert other.figures["descriptor_distance"] == pytest.approx(sum(squares) ** 0.5)
    assert set(other.figures["descriptor_parts"]) == set(tf.measure.descriptors.PARTS)
    assert json.dumps(other.summary())


def test_media_of_other_lattices_rates_and_axes_are_compared() -> None:
    plate = body("plate", 0.06, frames=4)
    finer = tf.Grid.over_box((-0.08,) * 3, (0.08,) * 3, (64, 64, 64))
    other = body("plate", 0.06, frames=6, grid=finer, rate_hz=60.0)
    found = similar(plate, other)
    unlike = similar(plate, body("torus", frames=4))
    assert found.figures["normalised"]["value"] > unlike.figures["normalised"]["value"] + 0.1
    assert len(found.notes) == 2 and found.figures["frames"] == 3, "those that both have"


# -- videos ------------------------------------------------------------------------------------------------


def looks(video: Path, stream: Path, **options: Any) -> list[dict[str, Any]]:
    return list(correlate(video, stream, **options).figures["looks"])


def wavy(seed: int, axes: str) -> tuple[tf.HapticMedium, NDArray[np.float64]]:
    """A slab of varying stiffness, and the stiffness [y up, x]."""
    from scipy import ndimage

    rng = np.random.default_rng(seed)
    hard = ndimage.gaussian_filter(rng.normal(size=(64, 64)), 1.2)
    hard = 0.3 + 2.0 * (hard - hard.min()) / np.ptp(hard)
    grid = tf.Grid.over_box((-0.05,) * 3, (0.05,) * 3, (64, 64, 8))
    forces = np.zeros((64, 64, 8, 3))
    forces[:, :, 3:5, 2] = hard.T[:, :, None]
    return tf.HapticMedium.from_array(forces, grid, 25.0, axes), hard


@pytest.mark.parametrize("axes", ["x right, y up, z towards the viewer", "x right, y down, z forward"])
def test_a_picture_correlates_with_its_scene(axes: str, tmp_path: Path) -> None:
    medium, hard = wavy(3, axes)
    tf.encode(medium, tmp_path / "slab.touch")
    rows = hard[::-1] if "y up" in axes else hard
    for name, values in (("own", rows), ("turned", rows[:, ::-1]), ("other", wavy(4, axes)[1])):
        grey = (255 * (values - values.min()) / np.ptp(values)).astype(np.uint8)
        Image.fromarray(np.stack([grey] * 3, axis=-1)).save(tmp_path / f"{name}.png")
    found = {n: looks(tmp_path / f"{n}.png", tmp_path / "slab.touch")[0] for n in ("own", "turned", "other")}
    bits = {n: look["mutual_bits"] for n, look in found.items()}
    assert found["own"]["p"] <= 0.01 and bits["own"] > 1.0
    assert bits["own"] > 5 * max(bits["turned"], bits["other"])
    assert found["turned"]["p"] > 0.01 and found["other"]["p"] > 0.01


def test_the_rays_of_a_camera_find_its_pixels(tmp_path: Path) -> None:
    medium, hard = wavy(5, "x right, y down, z forward")
    medium = tf.HapticMedium.from_frames(
        [medium[0].on_grid(tf.Grid(medium.grid.shape, medium.grid.spacing_m, (-0.05, -0.05, 0.2)))],
        25.0,
        medium.axes,
    )
    tf.encode(medium, tmp_path / "slab.touch")
    depth_m = medium.grid.axis_m(2)[3]
    v, u = np.mgrid[:64, :64]
    x, y = ((n - 31.5) / focal_px * depth_m for n, focal_px in ((u, 100.0), (v, 140.0)))
    indices = medium.grid.to_index(np.stack([x, y, np.full_like(x, depth_m)], axis=-1)).round().astype(int)
    visible = hard[indices[..., 1].clip(0, 63), indices[..., 0].clip(0, 63)]
    grey = (255 * (visible - visible.min()) / np.ptp(visible)).astype(np.uint8)
    Image.fromarray(np.stack([grey] * 3, axis=-1)).save(tmp_path / "seen.png")
    camera = (100.0, 140.0, 31.5, 31.5)
    right = looks(tmp_path / "seen.png", tmp_path / "slab.touch", intrinsics=camera)[0]
    wrong = looks(tmp_path / "seen.png", tmp_path / "slab.touch", intrinsics=(100.0, 100.0, 31.5, 31.5))[0]
    assert right["p"] <= 0.01 and right["mutual_bits"] > 3 * wrong["mutual_bits"]
    tf.encode(wavy(5, "x right, y up, z towards the viewer")[0], tmp_path / "up.touch")
    with pytest.raises(InvalidArgument, match="axes"):
        correlate(tmp_path / "seen.png", tmp_path / "up.touch", intrinsics=camera)


def test_each_frame_is_correlated_with_the_picture_of_its_time(tmp_path: Path) -> None:
    first, hard = wavy(6, "x right, y up, z towards the viewer")
    second, softer = wavy(7, "x right, y up, z towards the viewer")
    medium = tf.HapticMedium.from_frames([first[0]] * 5 + [second[0]] * 5, 50.0, first.axes)
    tf.encode(medium, tmp_path / "slab.touch")
    pages = []
    for values in (hard, softer):
        grey = (255 * (values[::-1] - values.min()) / np.ptp(values)).astype(np.uint8)
        pages.append(Image.fromarray(np.stack([grey] * 3, axis=-1)))
    pages[0].save(tmp_path / "seen.gif", save_all=True, append_images=pages[1:], duration=100)
    found = looks(tmp_path / "seen.gif", tmp_path / "slab.touch", frames=3)
    assert [(look["frame"], look["picture"]) for look in found] == [(0, 0), (2, 0), (5, 1)]
    assert all(look["p"] <= 0.01 for look in found)


# -- the command line --------------------------------------------------------------------------------------


def test_index_search_and_similar_from_the_command_line(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _exit_code(["search", str(folder), str(folder / "sphere.touch")]) == 1
    assert "touchfield index" in capsys.readouterr().err
    assert _exit_code(["index", str(folder)]) == 0
    assert "left out: cut.touch" in capsys.readouterr().out
    assert _exit_code(["index", str(folder), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert (
        report["media"] == 6
        and report["described"] == 0
        and set(report["faults"]) == {"cut.touch", "still.touch"}
    )
    arguments = [
        "search",
        str(folder),
        str(folder / "sphere.touch"),
        "--count",
        "2",
        "--weight",
        "amplitude=2",
    ]
    assert _exit_code([*arguments, "--any-pose", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert [row["rank"] for row in report["matches"]] == [1, 2]
    assert report["matches"][0]["name"] == "deeper/sphere-large.touch"
    same = search(folder, folder / "sphere.touch", 2, {**ANY_POSE, "amplitude": 2.0}).summary()["matches"]
    assert [row["distance"] for row in report["matches"]] == [row["distance"] for row in same]
    assert _exit_code([*arguments, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["matches"][1]["distance"] > same[1]["distance"]
    assert _exit_code(arguments) == 0
    assert capsys.readouterr().out.splitlines()[1].endswith("deeper/sphere-large.touch")
    for bad in (["--weight", "amplitude"], ["--weight", "colour=1"], ["--count", "0"]):
        assert _exit_code([*arguments[:3], *bad]) == 2
    two = [str(folder / "sphere.touch"), str(folder / "plate.touch")]
    assert _exit_code(["similar", *two, "--json"]) == 0
    both = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert 0 < both["normalised"]["value"] < 1 and both["descriptor_distance"] > 0
    assert _exit_code(["similar", *two]) == 0
    output = capsys.readouterr().out
    assert "NMI" in output and "do nothing" not in output
    assert _exit_code(["similar", *two, "--nw", "5"]) == 0
    assert capsys.readouterr().out.count("options of the scene do nothing") == 1
    assert _exit_code(["similar", *two, "--over", "nothing"]) == 2


def test_correlate_from_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    medium, hard = wavy(8, "x right, y up, z towards the viewer")
    tf.encode(medium, tmp_path / "slab.touch")
    grey = (255 * (hard[::-1] - hard.min()) / np.ptp(hard)).astype(np.uint8)
    Image.fromarray(np.stack([grey] * 3, axis=-1)).save(tmp_path / "seen.png")
    arguments = ["correlate", str(tmp_path / "seen.png"), str(tmp_path / "slab.touch")]
    assert _exit_code([*arguments, "--json"]) == 0
    (look,) = json.loads(capsys.readouterr().out)["looks"]
    assert look["frame"] == 0 and look["p"] <= 0.01 and look["mutual_bits"] > 1
    assert _exit_code(arguments) == 0
    assert "mutual_bits" in capsys.readouterr().out
    assert _exit_code([*arguments, "--intrinsics", "1,2"]) == 2
    assert _exit_code([*arguments, "--looks", "0"]) == 2
