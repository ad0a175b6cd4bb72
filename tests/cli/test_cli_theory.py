"""`touchfield measure` and `touchfield filter` end to end."""

from __future__ import annotations

import json
import math
import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from touchfield import pipeline, tasks
from touchfield.cli.main import _exit_code
from touchfield.filters.registry import filter_of
from touchfield.measure.estimators import binary_entropy_bits
from touchfield.medium import HapticMedium
from touchfield.medium.stores.npz import read_npz
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.tiny_scenes import tiny_scenes
from touchfield.tasks.measure import MeasureSpec

Capture = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def stream(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("theory") / "ramp.touch"
    pipeline.encode(tiny_scenes()[0], path, EncodeSpec(nw=5, coder="paper"))
    return path


@pytest.fixture
def sphere(tmp_path: Path) -> Path:
    path = tmp_path / "sphere.toml"
    path.write_text('[[shape]]\nkind = "sphere"\ncenter_m = [0.0, 0.0, 0.0]\nradius_m = 0.05\n')
    return path


def test_measure_of_a_stream(stream: Path, tmp_path: Path, capsys: Capture) -> None:
    picture = tmp_path / "bits.png"
    assert _exit_code(["measure", str(stream), "--json", "--plot", str(picture)]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["quantiser"] == "distinct" and found["frames"] == 2
    p = found["occupancy"]
    voxel, on_object = (found[key]["value"] for key in ("entropy_voxel", "entropy_object"))
    assert voxel == pytest.approx(binary_entropy_bits(p) + p * on_object, abs=1e-12)
    assert found["entropy_frame"]["value"] == pytest.approx(voxel * 32**3)
    assert found["entropy_frame"]["unit"] == "bit/frame"
    assert 0 <= found["in_time"]["conditional_entropy"]["value"] <= voxel
    assert found["file_bits"] == 8 * stream.stat().st_size
    limits = found["coding_limits"]
    assert limits["voxel_entropy"]["bits_per_voxel"] == pytest.approx(voxel)
    assert all(c["bits_per_voxel"] <= voxel + 1e-12 for c in limits["contexts"].values())
    min_bits = min(c["bits_per_frame"] for c in limits["contexts"].values())
    assert 2 * min_bits < found["file_bits"], "the paper's coder is far from the limit"
    with Image.open(picture) as drawn:
        assert drawn.width > 600 and len(drawn.convert("RGB").getcolors(1 << 20)) > 20


def test_measure_prints_the_values_of_its_json(stream: Path, capsys: Capture) -> None:
    """For two frames: bits per supported voxel over both, and millijoules of a loop."""
    assert _exit_code(["measure", str(stream), "--json"]) == 0
    values = json.loads(capsys.readouterr().out)
    assert _exit_code(["measure", str(stream)]) == 0
    printed = capsys.readouterr().out
    supported = values["voxels_per_frame"] * values["frames"] * values["occupancy"]

    def number(row: str) -> float:
        return float(
            next(line for line in printed.splitlines() if line.startswith(row))[len(row) :].split()[0]
        )

    assert values["frames"] == 2 and supported == pytest.approx(values["supported_voxels"])
    assert number("this file") == pytest.approx(8 * stream.stat().st_size / supported, rel=1e-4)
    assert number("H(S)") == pytest.approx(values["entropy_voxel"]["value"], rel=1e-5)
    assert number("H(W)") == pytest.approx(values["entropy_frame"]["value"], rel=1e-5)
    assert number("relative curl") == pytest.approx(values["passivity"]["relative_curl"], rel=1e-3)
    assert number("worst square") == pytest.approx(1e3 * values["passivity"]["worst_square_j"], rel=1e-3)
    assert "mJ gained" in printed


def test_measure_of_devices(sphere: Path, capsys: Capture) -> None:
    arguments = ["measure", str(sphere), "--nw", "5", "--no-limits", "--json"]
    assert (
        _exit_code(
            [*arguments, "--device", "tshirt-32x32", "--device", "phantom-omni", "--quantiser", "weber:0.25"]
        )
        == 0
    )
    found = json.loads(capsys.readouterr().out)
    assert found["coding_limits"] is None and list(found["capacity"]) == ["tshirt-32x32", "phantom-omni"]
    for capacity in found["capacity"].values():
        wmr, hil = (capacity[key]["value"] for key in ("wmr", "hil"))
        assert wmr + hil == pytest.approx(1, abs=1e-12)
        assert capacity["rendered"]["value"] <= capacity["codomain_bits"] + 1e-9
    assert (
        found["capacity"]["tshirt-32x32"]["wmr"]["value"] < found["capacity"]["phantom-omni"]["wmr"]["value"]
    )
    assert any("finer than the medium's" in note for note in found["notes"])


def test_information_lost_by_the_device_of_the_paper(sphere: Path, capsys: Capture) -> None:
    """With five samples of W per device sample along each axis, about 1/125 of the bits remain
    (docs/theory).
    """
    arguments = ["measure", str(sphere), "--nw", "6", "--no-limits", "--json", "--device", "phantom-omni"]
    wmr = {}
    for density in ("1", "2", "5"):
        assert _exit_code([*arguments, "--density", density]) == 0
        capacity = json.loads(capsys.readouterr().out)["capacity"]["phantom-omni"]
        wmr[density] = capacity["wmr"]["value"]
        assert capacity["hil"]["value"] == pytest.approx(1 - wmr[density])
    assert wmr["1"] == 1 and 0.08 < wmr["2"] < 0.3 and 0.004 < wmr["5"] < 0.03
    assert _exit_code([*arguments, "--density", "0.5"]) == 2
    assert "--density" in capsys.readouterr().err


def test_measure_along_a_trace(stream: Path, tmp_path: Path, capsys: Capture) -> None:
    trace = tmp_path / "probe.csv"
    t = np.arange(60) / 1000
    with pipeline.open_file(stream) as opened:
        positions_m = opened.medium[0].grid.to_m(opened.medium[0].positions())
    trace_m = positions_m[:: len(positions_m) // 60][:60]
    rows = "\n".join(f"{a:.4f},{x:.6f},{y:.6f},{z:.6f}" for a, (x, y, z) in zip(t, trace_m))
    trace.write_text(f"t_s,x_m,y_m,z_m\n{rows}\n")
    arguments = [
        "measure",
        str(stream),
        "--no-limits",
        "--over",
        f"interaction:{trace}",
        "--estimator",
        "miller-madow",
    ]
    assert _exit_code([*arguments, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["entropy"]
    assert found["weighting"] == "interaction" and found["samples"] == 60
    assert found["value"] > 3, "the probe met many forces"
    assert any("fewer than" in note for note in found["notes"])
    assert _exit_code(arguments) == 0
    printed = capsys.readouterr().out
    assert "over the visits" in printed and "relative curl" in printed


def test_measure_over_several_contacts(stream: Path, tmp_path: Path, capsys: Capture) -> None:
    """Equal traces receive everything twice; a name with a comma is one trace; other times name the file."""
    with pipeline.open_file(stream) as opened:
        field = opened.medium[0]
    inside_m = field.grid.to_m(field.positions())[:60]
    paths = [tmp_path / name for name in ("thumb.csv", "a,b.csv", "index.csv", "late.csv")]
    orders = (np.arange(60), np.arange(60), np.random.default_rng(1).permutation(60), np.arange(60))
    for path, order in zip(paths, orders):
        late_s = 0.5 if path.stem == "late" else 0.0
        rows = "\n".join(
            f"{n / 1000 + late_s:.4f},{x:.6f},{y:.6f},{z:.6f}" for n, (x, y, z) in enumerate(inside_m[order])
        )
        path.write_text(f"t_s,x_m,y_m,z_m\n{rows}\n")
    thumb, comma, index, late = map(str, paths)

    def measured(over: str) -> dict[str, Any]:
        arguments = ["measure", str(stream), "--no-limits", "--over", f"interaction:{over}", "--json"]
        assert _exit_code(arguments) == 0
        return dict(json.loads(capsys.readouterr().out))

    one, same, two = measured(comma), measured(f"{thumb},{thumb}"), measured(f"{thumb},{index}")
    bits = one["entropy"]["value"]
    assert one["contacts"] == {} and one["entropy"]["name"] == "H(S)" and bits > 2
    assert same["entropy"]["value"] == pytest.approx(bits) and same["entropy"]["name"] == "H(S1,S2)"
    assert same["contacts"]["total_correlation"]["value"] == pytest.approx(bits)
    first, second, shared = (two["contacts"][key]["value"] for key in ("S1", "S2", "total_correlation"))
    assert first == pytest.approx(bits) and two["entropy"]["value"] == pytest.approx(first + second - shared)
    assert two["entropy"]["value"] > bits
    arguments = ["measure", str(stream), "--no-limits", "--over"]
    assert _exit_code([*arguments, f"interaction:{thumb},{index}"]) == 0
    printed = capsys.readouterr().out
    assert "of all contacts together" in printed and "received more than once" in printed
    assert _exit_code([*arguments, f"interaction:{thumb},{late}"]) == 1
    error = capsys.readouterr().err
    assert error.startswith(
        f"touchfield: {late}: found 60 samples from 0.5 to 0.559 s; expected the 60 times"
    )
    assert error.count("\n") == 1
    assert _exit_code([*arguments, f"interaction:{thumb},"]) == 2
    assert "interaction:TRACE.csv" in capsys.readouterr().err


def test_measure_takes_a_medium_and_a_scene() -> None:
    scene = tiny_scenes()[2]
    spec = MeasureSpec(quantiser="weber:0.1", limits=False, encode=EncodeSpec(nw=5))
    of_scene = tasks.measure.measure_medium(scene, spec)
    of_medium = tasks.measure.measure_medium(pipeline.prepare(scene, spec.encode).medium, spec)
    assert of_scene.voxel == of_medium.voxel and of_scene.voxel.value > 0
    assert of_scene.passivity is not None and of_scene.passivity.relative_curl < 0.2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--over", "room"], "voxel, object"),
        (["--over", "interaction"], "interaction:TRACE.csv"),
        (["--over", "interaction:none.csv"], "none.csv"),
        (["--estimator", "guess"], "plug-in"),
        (["--quantiser", "weber:7"], "Weber fraction"),
        (["--quantiser", "uniform:99"], "without any force"),
        (["--device", "glove-of-power"], "phantom-omni"),
        (["--nw", "99"], "3 to 10"),
    ],
)
def test_measure_error_names_the_cause(
    sphere: Path, options: list[str], message: str, capsys: Capture
) -> None:
    arguments = ["measure", str(sphere), *(["--nw", "4"] if "--nw" not in options else []), *options]
    assert _exit_code(arguments) == (1 if message == "none.csv" else 2)  # a missing file is no wrong option
    error, *notes = capsys.readouterr().err.splitlines()
    assert error.startswith("touchfield: ") and message in error
    assert all(note.startswith("note: ") for note in notes)


def test_measure_does_not_overwrite_its_medium(stream: Path, capsys: Capture) -> None:
    before = stream.read_bytes()
    assert _exit_code(["measure", str(stream), "--plot", str(stream)]) == 2
    assert stream.read_bytes() == before


def test_filters_apply_in_the_order_of_options(sphere: Path, tmp_path: Path, capsys: Capture) -> None:
    common = ["filter", str(sphere), "--nw", "5", "--thickness-m", "0.01"]
    coarse_option, texture_option = ["--multiresolution", "2"], ["--texture", "salt-pepper:seed=4,rms=0.3"]
    fields = {}
    for name, order in (("ab", [*coarse_option, *texture_option]), ("ba", [*texture_option, *coarse_option])):
        out = tmp_path / f"{name}.npz"
        assert _exit_code([*common, str(out), *order]) == 0
        fields[name] = read_npz(out)[0]
    capsys.readouterr()
    device_field = pipeline.prepare(sphere, EncodeSpec(nw=5, thickness_m=0.01)).medium[0]
    coarse, rough = filter_of("multiresolution", "2"), filter_of("texture", texture_option[1])
    expected = rough(coarse(device_field))
    assert fields["ab"].support_count == expected.support_count
    unclipped = np.linalg.norm(expected.to_dense(), axis=-1) < 3.2  # larger forces are clipped to F_max
    np.testing.assert_allclose(fields["ab"].to_dense()[unclipped], expected.to_dense()[unclipped], atol=1e-6)
    assert fields["ab"] != fields["ba"]
    assert float(np.linalg.norm(fields["ab"].to_dense(), axis=-1).max()) <= 3.3 + 1e-6


def test_filter_to_a_stream_with_its_report(sphere: Path, tmp_path: Path, capsys: Capture) -> None:
    out = tmp_path / "rough.touch"
    arguments = ["filter", str(sphere), str(out), "--nw", "5", "--texture", "salt-pepper:seed=4", "--report"]
    assert _exit_code([*arguments, "--json"]) == 0
    done = json.loads(capsys.readouterr().out)
    before, after = done["report"]["stages"]
    assert before["nmse_db"] is None and after["nmse_db"] < 0
    assert after["entropy_object_bits"] > before["entropy_object_bits"], "a texture is information"
    assert after["entropy_bits_per_frame"] == pytest.approx(after["entropy_voxel_bits"] * 32**3)
    assert not math.isnan(after["rms_n"]) and after["greatest_n"] <= 3.3 + 1e-6
    # the stream's provenance has the filter, so a comparison filters its source as well
    assert _exit_code(["compare", str(sphere), str(out), "--json", "--no-picture"]) == 0
    assert json.loads(capsys.readouterr().out)["nmse_db"] < -15
    picture = tmp_path / "rough.png"
    has_matplotlib = find_spec("matplotlib") is not None
    assert _exit_code([*arguments, *(["--plot", str(picture)] if has_matplotlib else [])]) == 0
    assert "mask_violation_share" in capsys.readouterr().out
    assert picture.exists() == has_matplotlib


def test_filter_of_a_stream(stream: Path, tmp_path: Path, capsys: Capture) -> None:
    out = tmp_path / "again.touch"
    assert _exit_code(["filter", str(stream), str(out), "--multiresolution", "1"]) == 0
    assert _exit_code(["compare", str(stream), str(out), "--json", "--no-picture"]) == 0
    assert _exit_code(["filter", str(stream), str(stream), "--multiresolution", "1"]) == 2
    assert _exit_code(["filter", str(stream), str(out)]) == 2
    assert "no filter" in capsys.readouterr().err
    assert _exit_code(["filter", str(stream), str(tmp_path / "x.touch"), "--texture", "salt:3"]) == 2
    assert not (tmp_path / "x.touch").exists()


def test_static_scene_lasts_for_the_whole_trace(sphere: Path, tmp_path: Path, capsys: Capture) -> None:
    trace = tmp_path / "slow.csv"
    t = np.arange(200) / 100  # two seconds, and a scene of one frame
    rows = "\n".join(
        f"{a:.3f},{20 * np.sin(3 * a):.4f},{15 * np.cos(2 * a):.4f},{5 * np.sin(a):.4f}" for a in t
    )
    trace.write_text(f"t_s,x_mm,y_mm,z_mm\n{rows}\n")
    arguments = [
        "measure",
        str(sphere),
        "--nw",
        "5",
        "--no-limits",
        "--over",
        f"interaction:{trace}",
        "--json",
    ]
    assert _exit_code(arguments) == 0
    assert json.loads(capsys.readouterr().out)["entropy"]["samples"] == 200


def test_report_on_forces_above_the_device_limit(stream: Path, tmp_path: Path, capsys: Capture) -> None:
    strong = tmp_path / "strong.npz"
    medium = pipeline.prepare(stream).medium
    pipeline.write_field(strong, HapticMedium.from_frames([medium[0].scaled(4.0)], 30.0))
    arguments = [
        "filter",
        str(strong),
        str(tmp_path / "o.npz"),
        "--nw",
        "5",
        "--gaussian",
        "6mm",
        "--report",
        "--json",
    ]
    assert _exit_code(arguments) == 0
    stages = json.loads(capsys.readouterr().out)["report"]["stages"]
    assert all(stage["greatest_n"] <= 3.3 + 1e-6 for stage in stages) and stages[0]["nmse_db"] is None


def test_filter_rejects_invalid_options_before_it_starts(
    stream: Path, tmp_path: Path, capsys: Capture
) -> None:
    out = tmp_path / "out.touch"
    assert _exit_code(["filter", str(stream), str(out), "--gaussian", "2mm", "--gaussian", "3mm"]) == 2
    assert "Filter twice" in capsys.readouterr().err and not out.exists()
    assert _exit_code(["filter", str(stream), str(tmp_path / "out.foo"), "--gaussian", "2mm"]) == 2
    assert "OUT.touch" in capsys.readouterr().err
    missing = str(tmp_path / "nowhere" / "a.png")
    assert _exit_code(["filter", str(stream), str(out), "--gaussian", "2mm", "--plot", missing]) == 2
    assert "no folder" in capsys.readouterr().err and not out.exists()


def test_the_picture_of_a_filter_shows_the_field_before_and_after(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    spec = pipeline.EncodeSpec(nw=5, filters=(("gaussian", "5mm"), ("gaussian", "2mm")))
    drawn: list[tuple[Any, ...]] = []
    monkeypatch.setattr(
        sys.modules["touchfield.pipeline.comparison"], "draw_comparison", lambda *a: drawn.append(a)
    )
    scene = tiny_scenes()[0]
    pipeline.draw_filtered(scene, spec, tmp_path / "x.png")
    before, after = (pipeline.prepare(scene, s).medium for s in (replace(spec, filters=()), spec))
    middle = len(before) // 2
    ((path, first, second, title, axes, mask, names),) = drawn
    assert (first, second) == (before[middle], after[middle]) and first != second
    assert path == tmp_path / "x.png" and axes == before.axes and names == ("before", "after", "change")
    assert mask == (spec.paper.k, 0.05) and "before and after gaussian, gaussian" in title
    pipeline.draw_filtered(scene, replace(spec, filters=()), tmp_path / "x.png")
    assert drawn[1][1] == drawn[1][2] and "no filter" in drawn[1][3]


def test_range_of_frames_uses_the_clock_of_the_trace(stream: Path, tmp_path: Path, capsys: Capture) -> None:
    with pipeline.open_file(stream) as opened:
        rate_hz, field = opened.medium.rate_hz, opened.medium[1]
    position_m = field.grid.to_m(field.positions()[len(field.positions()) // 2])
    t = (1 + np.linspace(0.05, 0.9, 30)) / rate_hz  # during the second frame
    trace = tmp_path / "second.csv"
    trace.write_text(
        "t_s,x_m,y_m,z_m\n" + "".join(f"{a},{position_m[0]},{position_m[1]},{position_m[2]}\n" for a in t)
    )
    arguments = [
        "measure",
        str(stream),
        "--no-limits",
        "--over",
        f"interaction:{trace}",
        "--frames",
        "1:2",
        "--json",
    ]
    assert _exit_code(arguments) == 0
    values = json.loads(capsys.readouterr().out)
    assert values["entropy"]["samples"] == 30 and values["file_bits"] is None, (
        "the file has other frames, too"
    )


def test_filtered_stream_has_its_provenance(stream: Path, tmp_path: Path, capsys: Capture) -> None:
    out = tmp_path / "again.touch"
    assert _exit_code(["filter", str(stream), str(out), "--gaussian", "5mm"]) == 0
    capsys.readouterr()
    assert _exit_code(["info", str(out), "--json"]) == 0
    provenance = json.loads(capsys.readouterr().out)["provenance"]
    assert provenance["source"] == "ramp.touch" and "gaussian" in provenance["spec"]
    assert provenance["source.source"] == "scene" and '"nw":5' in provenance["source.spec"]
