"""Stored media edited, joined, resampled, coarsened and partitioned: from text, into files."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import touchfield as tf
from touchfield.cli.main import _exit_code
from touchfield.errors import InvalidArgument, SourceError
from touchfield.tasks.edit_syntax import operator_of, region_of
from touchfield.tasks.editing import edit, levels_of_detail, resample_file, splice
from touchfield.tasks.matching import change_lattice, change_rate, match_medium, read_medium

AXES = "x right, y up, z towards the viewer"
GRID = tf.Grid.over_box((-0.04,) * 3, (0.04,) * 3, (32, 32, 32))
EXACT = tf.EncodeSpec(touch=tf.codec.TouchSpec(mode="lossless"))


def ball(grid: tf.Grid, centre_m: tuple[float, float, float], radius_m: float = 0.015) -> NDArray[np.float32]:
    """A soft ball that pushes outwards, up to 2 N."""
    positions_m = (
        np.stack(np.meshgrid(*(grid.axis_m(n) for n in range(3)), indexing="ij"), axis=-1) - centre_m
    )
    away = np.linalg.norm(positions_m, axis=-1, keepdims=True)
    depth = np.clip(radius_m - away, 0, None)
    return (np.minimum(200 * depth, 2.0) * positions_m / np.maximum(away, 1e-9)).astype(np.float32)


def rolling(
    grid: tf.Grid = GRID, frames: int = 6, rate_hz: float = 30.0, axes: str = AXES
) -> tf.HapticMedium:
    """The ball, which moves 12 mm in a tenth of a second along x."""
    centres_m = [(-0.015 + 0.12 * n / rate_hz, 0.004, -0.003) for n in range(frames)]
    return tf.HapticMedium.from_array(np.stack([ball(grid, p) for p in centres_m]), grid, rate_hz, axes)


@pytest.fixture(scope="module")
def stream(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("editing") / "ball.touch"
    tf.encode(rolling(), path, EXACT)
    return path


def assert_near(found: NDArray[np.float32], expected: NDArray[np.float32], atol: float = 1e-6) -> None:
    """Like pytest.approx, which takes a second for each field."""
    np.testing.assert_allclose(found, expected, rtol=0, atol=atol)


def points() -> NDArray[np.float64]:
    return GRID.to_m(np.stack(np.meshgrid(*(np.arange(n) for n in GRID.shape), indexing="ij"), axis=-1))


# -- texts -------------------------------------------------------------------------------------------------


def test_texts_of_regions() -> None:
    x, y, z = np.moveaxis(points(), -1, 0)
    box = (x >= -0.01) & (x <= 0.01) & (z <= 0.005)
    in_ball = (x - 0.01) ** 2 + y**2 + z**2 <= 0.01**2
    above = y >= 0.002
    for text, expected in (
        ("everywhere", np.ones_like(box)),
        ("box:-1cm,-inf,-inf,10mm,inf,5mm", box),
        ("ball:10mm,0,0,10mm", in_ball),
        ("half-space:0,2,0,0,2mm,0", above),
        ("box:-10mm,-inf,-inf,10mm,inf,5mm | ball:10mm,0mm,0mm,10mm", box | in_ball),
        (
            "ball:10mm,0,0,1cm & ~half-space:0,1,0,0,2mm,0 | box:-10mm,-inf,-inf,10mm,inf,5mm",
            in_ball & ~above | box,
        ),
    ):
        assert np.array_equal(region_of(text).holds(points()), expected), text
    field = rolling()[0]
    amplitudes = np.linalg.norm(field.to_dense(), axis=-1)
    assert np.array_equal(
        region_of("force:0.5..1.5").on(field).holds(points()), (amplitudes >= 0.5) & (amplitudes <= 1.5)
    )
    assert np.array_equal(region_of("force:0.5..").on(field).holds(points()), amplitudes >= 0.5)


@pytest.mark.parametrize(
    "text", ["", "cube:1mm", "ball:1mm,2mm,3mm", "ball:1,2,3,4", "box:1mm,1mm,1mm,0mm,0mm,0mm", "force:b..2",
              "everywhere:1", "ball:0,0,0,5mm |", "half-space:0,0,0,0,0,0"]
)  # fmt: skip
def test_invalid_texts_of_regions_are_refused(text: str) -> None:
    with pytest.raises(InvalidArgument):
        region_of(text)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("ball:0,0,0,15", "'15'; expected a length with its unit"),
        ("half-space:x,0,1,0,0,0", "'x'; expected a number"),
    ],
)
def test_a_length_without_a_unit_is_named_as_such(text: str, message: str) -> None:
    with pytest.raises(InvalidArgument, match=message):
        region_of(text)


def test_texts_of_operators(stream: Path) -> None:
    opened = read_medium(stream)
    field = opened.medium[0]
    dense = field.to_dense()
    step = GRID.spacing_m[0]
    results = {
        text: operator_of(text, opened)(field).to_dense()
        for text in (
            "gain:-0.5",
            "erase",
            "limit:0.7",
            f"move:{step!r}m,0,0",
            "turn:0,0,1,90",
            "mirror:1,0,0",
            "mirror:1,0,0,5mm,0,0",
            "gaussian:sigma=3mm",
        )
    }
    assert np.array_equal(results["gain:-0.5"], -0.5 * dense)
    assert not results["erase"].any()
    assert np.linalg.norm(results["limit:0.7"], axis=-1).max() == pytest.approx(0.7, abs=1e-6)
    assert_near(results[f"move:{step!r}m,0,0"][1:], dense[:-1])
    assert_near(results["mirror:1,0,0"], dense[::-1] * [-1, 1, 1])
    assert_near(results["turn:0,0,1,90"], np.rot90(dense, 1, (0, 1))[..., [1, 0, 2]] * [-1, 1, 1])
    assert_near(results["mirror:1,0,0,5mm,0,0"][4:], dense[::-1][:-4] * [-1, 1, 1])
    assert np.array_equal(
        results["gaussian:sigma=3mm"], tf.filters.filter_of("gaussian", "sigma=3mm")(field).to_dense()
    )
    for text in (
        "",
        "gain",
        "gain:x",
        "erase:1",
        "limit:-1",
        "move:1mm,2mm",
        "turn:0,0,0,90",
        "over:nowhere.touch",
        "wish",
    ):
        with pytest.raises(tf.TouchfieldError):
            operator_of(text, opened)


# -- edit --------------------------------------------------------------------------------------------------


def test_an_edit_is_exact_outside_its_region_and_its_frames(stream: Path, tmp_path: Path) -> None:
    region = "ball:0,0,0,15mm"
    done = edit(stream, tmp_path / "e.touch", region, ["gain:2", "limit:1.5"], frames=(2, 5), spec=EXACT)
    before, after = tf.decode(stream), tf.decode(tmp_path / "e.touch")
    inside = region_of(region).holds(points())
    for n in range(6):
        a, b = before[n].to_dense(), after[n].to_dense()
        assert np.array_equal(a[~inside], b[~inside])
        assert np.array_equal(a, b) == (not 2 <= n < 5)
    assert np.linalg.norm(after[3].to_dense()[inside], axis=-1).max() == pytest.approx(1.5, abs=1e-5)
    summary = done.summary()
    changed = (before[3].to_dense() != after[3].to_dense()).any(axis=-1)
    assert summary["looked_at_frame"] == 3 and summary["samples_changed"] == changed.sum()
    assert summary["file_bytes"] == (tmp_path / "e.touch").stat().st_size
    assert "gain" in after.provenance["edits"] and "limit" in after.provenance["edits"]
    again = edit(tmp_path / "e.touch", tmp_path / "f.touch", operators=["erase"], spec=EXACT)
    assert again.medium[0].support_count == 0
    history = tf.decode(tmp_path / "f.touch").provenance["edits"]
    assert history.index("gain") < history.index("erase"), "a file tells all that was done to it"
    edit(
        stream, tmp_path / "g.touch", " | ".join(["everywhere"] * 400), ["gain:2"], frames=(0, 1), spec=EXACT
    )
    assert len(tf.decode(tmp_path / "g.touch").provenance["edits"]) == 1000, (
        "or as much of it as a file holds"
    )


def test_another_medium_is_composed_over_one(stream: Path, tmp_path: Path) -> None:
    grid = tf.Grid.over_box((-0.04,) * 3, (0.04,) * 3, (16, 16, 16))
    tf.encode(
        tf.HapticMedium.from_array(ball(grid, (0.0, 0.0, 0.0)), grid, 30.0, AXES), tmp_path / "o.touch", EXACT
    )
    edit(stream, tmp_path / "x.npz", operators=[f"add:{tmp_path / 'o.touch'}"], frames=(2, 4))
    composed = read_medium(tmp_path / "x.npz").medium
    for n in (2, 3):  # a static medium is present in each frame
        expected = tf.decode(stream)[n] + change_lattice(tf.decode(tmp_path / "o.touch"), GRID)[0]
        assert_near(composed[n].to_dense(), expected.to_dense())
    assert composed[1] == tf.decode(stream)[1]
    tf.encode(rolling(frames=2), tmp_path / "short.touch", EXACT)
    with pytest.raises(InvalidArgument, match="2 frames"):
        edit(stream, tmp_path / "x.touch", operators=[f"over:{tmp_path / 'short.touch'}"])
    both = edit(
        stream, tmp_path / "y.npz", operators=[f"max:{tmp_path / 'short.touch'}"], frames=(3, 5)
    ).medium
    assert (
        float(both[4].support().amplitudes_n.max()) <= 2.0 and both[4].support_count > both[2].support_count
    )


def test_inputs_are_never_overwritten_and_outputs_are_complete(stream: Path, tmp_path: Path) -> None:
    original = stream.read_bytes()
    for out in (stream, stream.parent / "." / stream.name):
        with pytest.raises(InvalidArgument, match="read"):
            edit(stream, out, operators=["erase"])
    with pytest.raises(tf.TouchfieldError):
        edit(stream, tmp_path / "e.touch", "ball:0,0,0,5mm", ["gain:nan"])
    with pytest.raises(InvalidArgument, match="ending"):
        edit(stream, tmp_path / "e.wav", operators=["erase"])
    with pytest.raises(InvalidArgument, match="operator"):
        edit(stream, tmp_path / "e.touch")
    with pytest.raises(SourceError, match="encode"):
        read_medium(_sphere(tmp_path))
    assert stream.read_bytes() == original and not list(tmp_path.glob("*.touch"))


def _sphere(folder: Path) -> Path:
    path = folder / "sphere.toml"
    path.write_text('[[shape]]\nkind = "sphere"\ncenter_m = [0.0, 0.0, 0.0]\nradius_m = 0.05\n')
    return path


# -- other lattices, rates and axes ------------------------------------------------------------------------


def test_another_rate_is_linear_between_the_frames() -> None:
    medium = rolling()
    twice, less = change_rate(medium, 60.0), change_rate(medium, 20.0)
    assert (len(twice), len(less)) == (12, 4) and twice.rate_hz == 60.0
    assert twice[4] == medium[2] and less[2] == medium[3] and twice[11] == medium[5]
    assert_near(twice[5].to_dense(), (medium[2].to_dense() + medium[3].to_dense()) / 2)
    assert change_rate(medium, 30.0) is medium and len(change_rate(medium[:4], 20.0)) == 3
    with pytest.raises(InvalidArgument):
        change_rate(medium, 0.0)


def test_a_source_frame_is_computed_once() -> None:
    computed: list[int] = []
    medium = rolling()

    def make(i: int) -> tf.ForceField:
        computed.append(i)
        return medium[i]

    counted = tf.HapticMedium(medium.grid, 30.0, 6, make, AXES)
    assert len(list(change_rate(counted, 210.0))) == 42
    assert computed == list(range(6))


def test_media_are_joined_in_space_time_and_axes() -> None:
    like = rolling()
    grid = tf.Grid.over_box((-0.04,) * 3, (0.04,) * 3, (48, 48, 48))
    finer = rolling(grid, 12, 60.0)
    same, notes = match_medium(finer, like)
    assert (same.grid, same.rate_hz, len(same), len(notes)) == (GRID, 30.0, 6, 2)
    error = np.linalg.norm(same[3].to_dense() - like[3].to_dense(), axis=-1)
    assert error.sum() < 0.12 * np.linalg.norm(like[3].to_dense(), axis=-1).sum()
    permuted = tf.HapticMedium.from_array(
        np.stack([frame.to_dense()[:, ::-1, ::-1] * np.float32([1, -1, -1]) for frame in like]), GRID, 30.0,
        "x right, y down, z forward",
    )  # fmt: skip
    back, notes = match_medium(permuted, like)
    assert_near(back[2].to_dense(), like[2].to_dense())
    assert "turned" in notes[0]
    flat, high = ((0.04, 0.03, 0.02), (32, 24, 16)), ((0.04, 0.02, 0.03), (32, 16, 24))
    lying, standing = (
        tf.Grid.over_box([-n for n in corner], corner, shape) for corner, shape in (flat, high)
    )
    permuted = tf.HapticMedium.from_array(
        rolling(standing)[0].to_dense(), standing, 30.0, "x right, y forward, z up"
    )
    back, notes = match_medium(permuted, rolling(lying))
    swapped = permuted[0].to_dense().transpose(0, 2, 1, 3)[:, :, ::-1, [0, 2, 1]] * np.float32([1, 1, -1])
    assert back.grid == lying and len(notes) == 1
    assert_near(back[0].to_dense(), swapped)
    small = tf.Grid.over_box((-0.04, -0.04, -0.04), (0.0, 0.04, 0.04), (16, 32, 32))
    note = match_medium(like, rolling(small))[1][1]
    fraction = np.mean(like.grid.to_m(like[3].positions())[:, 0] > 0)
    assert f": {100 * fraction:.3g} % of its samples lie outside" in note and 0.1 < fraction < 0.9
    assert match_medium(like, like)[0][1] == like[1] and not match_medium(like, like)[1]


def test_media_of_other_rates_and_lattices_are_spliced(stream: Path, tmp_path: Path) -> None:
    grid = tf.Grid.over_box((-0.04,) * 3, (0.04,) * 3, (24, 24, 24))
    tf.encode(rolling(grid, 10, 50.0), tmp_path / "b.touch", EXACT)
    done = splice([f"{stream}@1:5", str(tmp_path / "b.touch")], tmp_path / "s.touch", fade_s=0.09, spec=EXACT)
    spliced, first = tf.decode(tmp_path / "s.touch"), tf.decode(stream)
    second, _ = match_medium(tf.decode(tmp_path / "b.touch"), first)
    assert len(spliced) == 4 + 6 - 3 and spliced.grid == GRID and spliced.rate_hz == 30.0
    assert spliced[0] == first[1]
    assert_near(spliced[4].to_dense(), second[3].to_dense())
    blend = 0.5 * first[3].to_dense() + 0.5 * second[1].to_dense()
    assert_near(spliced[2].to_dense(), blend, 1e-5)
    assert done.summary()["parts"] == [4, 6] and any("50 Hz to 30 Hz" in note for note in done.notes)
    assert "splices" in spliced.provenance
    cut = splice([f"{stream}@:2", f"{stream}@4:"], tmp_path / "cut.touch", spec=EXACT)
    assert [cut.medium[n] == first[n if n < 2 else n + 2] for n in range(4)] == [True] * 4
    tf.encode(rolling(frames=1), tmp_path / "v.touch", replace(EXACT, vibration="gain=0.1,frequency=150"))
    single, repeated = (
        splice([str(tmp_path / "v.touch")] * n, tmp_path / "cut.touch", spec=EXACT) for n in (1, 2)
    )
    assert single.medium.vibration is not None and not any("vibration" in note for note in single.notes)
    assert (
        repeated.medium.vibration is None
        and repeated.notes[:2] == ("v.touch: the vibration is left out",) * 2
    )
    for bad in ([f"{stream}@4"], [f"{stream}@9:"], [str(tmp_path / "none.touch")], []):
        with pytest.raises(tf.TouchfieldError):
            splice(bad, tmp_path / "x.touch")
    with pytest.raises(InvalidArgument, match="cross-fade"):
        splice([str(stream), str(stream)], tmp_path / "x.touch", fade_s=1.0)
    assert not (tmp_path / "x.touch").exists()


def test_forces_beyond_the_first_device_are_clipped(stream: Path, tmp_path: Path) -> None:
    strong = tf.EncodeSpec(device="omega.3", touch=tf.codec.TouchSpec(mode="lossless"))
    medium = tf.HapticMedium.from_frames([frame.scaled(5.0) for frame in rolling()], 30.0, AXES)
    tf.encode(medium, tmp_path / "strong.touch", strong)
    done = splice([str(stream), str(tmp_path / "strong.touch")], tmp_path / "s.touch", spec=EXACT)
    assert float(done.medium[7].support().amplitudes_n.max()) == pytest.approx(3.3, abs=1e-5)
    assert any("forces above 3.3 N are clipped to it" in note for note in done.notes)


def test_resampling_a_file_reports_its_error(stream: Path, tmp_path: Path) -> None:
    coarse = resample_file(stream, tmp_path / "c.touch", (4, None, None), spec=EXACT).summary()
    fine = resample_file(
        stream, tmp_path / "f.touch", (None, (64, 64, 64), None), 15.0, "trilinear", EXACT
    ).summary()
    assert coarse["grid_shape"] == [16, 16, 16] and coarse["nmse_db"] < -5
    assert fine["grid_shape"] == [64, 64, 64] and fine["frames"] == 3 and fine["nmse_db"] < coarse["nmse_db"]
    assert fine["mask_violation_share"] < coarse["mask_violation_share"] < 1
    spaced = resample_file(stream, tmp_path / "p.touch", (None, None, 0.004), spec=EXACT)
    assert spaced.medium.grid.shape == (20, 20, 20)
    for lattice, rate in (
        ((None, None, None), None),
        ((4, (8, 8, 8), None), None),
        ((2, None, None), None),
        ((5, None, None), 30.0),
        ((4, None, None), 0.0),
    ):
        with pytest.raises(InvalidArgument):
            resample_file(stream, tmp_path / "x.touch", lattice, rate)


# -- levels and boxes --------------------------------------------------------------------------------------


def test_each_level_of_detail_reports_its_bytes_and_error(stream: Path, tmp_path: Path) -> None:
    done = levels_of_detail(stream, tmp_path / "levels", spec=EXACT)
    sizes = [row["file_bytes"] for row in done.figures["levels"]]
    errors = [row["mask_violations_per_supported_voxel"] for row in done.figures["levels"]]
    assert [row["grid_shape"] for row in done.figures["levels"]] == [[32] * 3, [16] * 3, [8] * 3]
    assert sizes == sorted(sizes, reverse=True) and errors == sorted(errors) and errors[0] == 0
    for level, row in enumerate(done.figures["levels"]):
        path = tmp_path / "levels" / f"level-{level}.touch"
        assert row["file"] == str(path) and path.stat().st_size == row["file_bytes"]
        assert list(tf.decode(path).grid.shape) == row["grid_shape"]
    assert levels_of_detail(stream, max_bytes=sizes[1], spec=EXACT).figures["level"] == 1
    none = levels_of_detail(stream, levels=1, max_bytes=10, spec=EXACT)
    assert none.figures["level"] is None and "10 bytes" in none.notes[0]
    with pytest.raises(InvalidArgument):
        levels_of_detail(stream, levels=9)
    with pytest.raises(InvalidArgument, match="found a file; expected a folder"):
        levels_of_detail(stream, stream, spec=EXACT)


def test_a_level_that_is_worse_than_no_force_is_noted(tmp_path: Path) -> None:
    """Between the kept samples there is the opposite force."""
    dense = np.zeros((32, 32, 32, 3), np.float32)
    dense[::2, ..., 0], dense[1::2, ..., 0] = 1, -1
    tf.encode(tf.ForceField.from_dense(GRID, dense), tmp_path / "ripples.touch", EXACT)
    notes = levels_of_detail(tmp_path / "ripples.touch", levels=1, spec=EXACT).notes
    assert any(note.startswith("level 1: farther from the medium than no force") for note in notes)


def test_interrupted_levels_leave_no_folder(stream: Path, tmp_path: Path) -> None:
    def interrupt(done: int, total: int) -> None:
        raise KeyboardInterrupt

    out_folder = tmp_path / "mine"
    out_folder.mkdir()
    for folder in (tmp_path / "new", out_folder):
        with pytest.raises(KeyboardInterrupt):
            levels_of_detail(stream, folder, spec=EXACT, report=interrupt)
    assert not (tmp_path / "new").exists() and out_folder.is_dir()


# -- the command line --------------------------------------------------------------------------------------


def json_output(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict[str, object]:
    assert _exit_code([*map(str, arguments), "--json"]) == 0
    values: dict[str, object] = json.loads(capsys.readouterr().out.splitlines()[-1])
    return values


def test_the_commands_from_the_command_line(
    stream: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "o.touch"
    output = json_output(capsys, "edit", stream, out, "--region", "ball:0,0,0,2cm", "--operator", "gain:0.5",
                 "--feather", "2mm", "--frames", "0:3", "--mode", "lossless")  # fmt: skip
    assert output["operators"] == ["gain:0.5"] and output["frames"] == 6 and out.is_file()
    output = json_output(
        capsys, "splice", f"{stream}@0:2", out, tmp_path / "s.touch", "--fade-s", "0.03", "--friction", "0.2"
    )
    assert output["parts"] == [2, 6] and tf.decode(tmp_path / "s.touch").friction == 0.2
    output = json_output(
        capsys, "resample", stream, tmp_path / "r.npz", "--spacing", "4mm", "--rate-hz", "60"
    )
    assert output["grid_shape"] == [20, 20, 20] and output["frames"] == 12
    output = json_output(capsys, "lod", stream, "--levels", "1", "--max-bytes", "1000000")
    assert output["level"] == 0
    assert _exit_code(["lod", str(stream), str(tmp_path / "levels"), "--max-bytes", "1000000"]) == 0
    assert "level 0 is the finest that fits" in capsys.readouterr().out
    output = json_output(capsys, "partition", stream, "--depth", "2", "--penalty-bits", "1")
    boxes = output["boxes"]
    assert isinstance(boxes, list) and len(boxes) == output["box_count"] > 1
    volume = sum(float(np.prod(np.subtract(box["high_mm"], box["low_mm"]))) for box in boxes)
    assert volume == pytest.approx(80.0**3)
    assert json_output(capsys, "partition", stream, "--depth", "1", "--penalty-bits", "1e9")["box_count"] == 1
    undivided = json_output(capsys, "partition", stream, "--depth", "0")
    assert undivided["box_count"] == 1 and undivided["boxes"][0]["lost_bits"] == 0  # type: ignore[index]
    assert _exit_code(["partition", str(stream)]) == 0
    capsys.readouterr()
    for bad in (
        ["edit", stream, out], ["edit", stream, stream, "--operator", "erase"], ["splice", out],
        ["edit", stream, out, "--operator", "erase", "--frames", "3"],
        ["resample", stream, out, "--shape", "8,8"],
        ["edit", stream, out, "--operator", "erase", "--feather", "2"], ["partition", stream, "--depth", "9"],
        ["partition", stream, "--depth", "-1"], ["resample", stream, out], ["lod", stream, "--levels", "-1"],
    ):  # fmt: skip
        assert _exit_code([str(word) for word in bad]) == 2, bad
        error = capsys.readouterr().err
        assert error.count("\n") == 1 and error.startswith("touchfield: ")


def test_errors_name_the_kind_of_a_file_that_is_no_medium(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mesh.off").write_text("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    np.savez(tmp_path / "heights.npz", heights_m=np.zeros((4, 4)))
    for name, found in ((".", "a folder"), ("mesh.off", "a file named .off"), ("heights.npz", "forces_n")):
        assert _exit_code(["lod", str(tmp_path / name)]) == 1
        error = capsys.readouterr().err
        assert found in error and "--as" not in error and "redwood" not in error


def test_idle_options_are_noted(stream: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for options, is_noted in (((), False), (("--unit-m", "0.001"), True)):
        notes = json_output(capsys, "measure", stream, "--no-limits", *options)["notes"]
        assert isinstance(notes, list) and any("options of the scene" in note for note in notes) == is_noted


def test_a_start_after_the_end_is_refused(stream: Path, capsys: pytest.CaptureFixture[str]) -> None:
    play = ["play", str(stream), "--offline", "--start-s"]
    assert _exit_code([*play, "0.2"]) == 2
    assert "--start-s: found 0.2 s; expected 0 to below 0.2 s, the medium's end" in capsys.readouterr().err
    assert _exit_code([*play, "0.25", "--loop", "--seconds", "0.1"]) == 0  # the loop starts again
    output = capsys.readouterr().out
    assert (
        "ticks" in output and "jitter" not in output and "lateness" not in output
    )  # absent in a run without a clock


def test_positions_are_not_printed_as_sizes(stream: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert _exit_code(["info", str(stream)]) == 0
    rows = dict(
        line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines() if len(line.split()) > 1
    )
    assert rows["grid_shape"].strip() == "32 x 32 x 32" and rows["spacing_mm"].strip() == "2.5 x 2.5 x 2.5"
    assert rows["mapping_offset_m"].strip() == "0, 0, 0"


def test_a_name_that_is_not_utf_8_is_encoded(tmp_path: Path) -> None:
    source = os.fsencode(tmp_path) + b"/ball\xff\x07.npz"
    with open(source, "wb") as file:
        np.savez(file, forces_n=rolling()[0].to_dense(), origin_m=GRID.origin_m, spacing_m=GRID.spacing_m)
    tf.encode(os.fsdecode(source), tmp_path / "out.touch")
    with tf.open_stream(tmp_path / "out.touch") as opened:
        assert opened.reader.provenance["source"] == "ball\ufffd\ufffd.npz"
