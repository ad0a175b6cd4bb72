"""Options that reach their task (`test_every_option`) also change its result.

Each case is a command that runs without and with an option: its JSON or its files must differ.
Options of one mechanism, such as those of a coder, are tested on one of the commands that take them.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from depth_makers import write_frames
from effect_makers import band, channel, document, effect, keyframe, written
from gltf_makers import chain_rig
from touchfield.cli.main import _exit_code
from touchfield.codec.touch.spec import TouchSpec
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.medium.stores.npz import write_npz
from touchfield.pipeline import encode
from touchfield.pipeline.decoding import open_file
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.stored import StoredScene

VOLATILE = ("_ms", "_s", "_us")
"""Suffixes of the keys whose values may differ between two runs."""

SPHERE = '[[shape]]\nkind = "sphere"\ncenter_m = [0.0, 0.0, 0.0]\nradius_m = 0.05\n'
OTHER_AXES = "x right, y up, z towards the user"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Sources of every kind, and streams."""
    path = tmp_path_factory.mktemp("effects")
    (path / "sphere.toml").write_text(SPHERE)
    (path / "inside").mkdir()
    (path / "inside" / "far.toml").write_text(SPHERE)
    (path / "mine.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n")
    body = '[[body]]\nkind = "mesh"\nfile = "{}mine.obj"\nposition_m = [0, 0, 0]\nfixed = true\n'
    (path / "inside" / "outside.toml").write_text(body.format("../"))
    heights = (np.add.outer(np.arange(24), np.arange(20)) % 17 * 3000).astype(np.uint16)
    Image.fromarray(heights).save(path / "heights.png")
    write_frames(path / "depth")
    chain_rig(joints=4, triangles=300, frames=12).save(path / "snake.glb", "glb")
    static_spec = EncodeSpec(nw=4, frames=(0, 1), representation="voxel", touch=TouchSpec(effort="fast"))
    encode(path / "snake.glb", path / "snake.touch", static_spec)
    wave = band("VectorialWave", effect([keyframe(0, 0.5, 100), keyframe(100, 0.5, 200)]))
    written(path / "wave.hjif", document(channel(wave), channel(wave)))
    times = np.arange(4000) / 4000
    for number, name in enumerate(("one", "two")):
        rows = "\n".join(f"{t:.6f},{np.sin(900 * (1 + number) * t):.6f}" for t in times)
        (path / f"{name}.csv").write_text(f"t_s,a_m_s2\n{rows}\n")
    grey = np.random.default_rng(2).integers(0, 255, (48, 48), np.uint8)
    Image.fromarray(np.stack([grey] * 3, axis=-1)).save(path / "look.png")
    (path / "hand.csv").write_text("t_s,x_m,y_m,z_m\n0,0,0,0.02\n0.1,0.004,0.002,0.006\n0.2,0,0,0.002\n")
    encode(path / "sphere.toml", path / "sphere.touch", EncodeSpec(nw=4, thickness_m=0.01))
    encode(path / "sphere.toml", path / "fine.touch", EncodeSpec(nw=5, thickness_m=0.01))
    scene = StoredScene(HapticMedium.from_frames([growing_bump(n) for n in range(8)], 30.0, OTHER_AXES))
    encode(scene, path / "moving.touch", EncodeSpec(nw=4, touch=TouchSpec(k=0.02, segment_frames=4)))
    write_npz(
        path / "moving.npz", HapticMedium.from_frames([growing_bump(n) for n in range(8)], 30.0, OTHER_AXES)
    )
    return path


def growing_bump(number: int) -> ForceField:
    """A compliant wall with a bump that grows with the number of the frame."""
    grid = Grid((16, 16, 16), (0.004,) * 3, (-0.03,) * 3)
    x, y, z = positions(grid)
    depth = 0.01 + 0.0005 * number * np.exp(-(x**2 + y**2) / 1e-4) - z
    forces = np.zeros((*grid.shape, 3), np.float32)
    forces[..., 2] = np.where((depth > 0) & (depth < 0.02), 80 * depth, 0)
    forces[..., 0] = 0.2 * forces[..., 2] * np.sin(200 * y)
    return ForceField.from_dense(grid, forces)


def positions(grid: Grid) -> list[np.ndarray]:
    """x, y and z of every sample."""
    axes = [o + s * np.arange(n) for o, s, n in zip(grid.origin_m, grid.spacing_m, grid.shape, strict=True)]
    return list(np.meshgrid(*axes, indexing="ij"))


CASES: dict[str, list[str]] = {
    "field sphere.toml out.npz --nw 4": [
        "--device novint-falcon", "--nw 5", "--mapping 0.25", "--stiffness-n-per-m 100",
        "--thickness-m 0.003",
        "--oversample 1", "--law proximity", "--representation object",
    ],
    "field sphere.toml out.npz --nw 4 --law proximity": ["--band-m 0.02"],
    "field moving.npz out.npz --nw 3": ["--frames 2:5", "--frames :3"],
    "field depth out.npz --nw 4 --as depth-folder --depth-scale 1000": [
        "--depth-scale 1500", "--intrinsics 30,30,6,4", "--reading height", "--frames 2:4", "--rate-hz 7",
        "--source-rate-hz 7",
    ],
    "field depth out.npz --nw 4 --as depth-folder --depth-scale 1000 --source-rate-hz 10 --rate-hz 15": [
        "--interpolation nearest",
    ],
    "field heights.png out.npz --nw 4 --as height-map --cell-size-m 0.01": [
        "--cell-size-m 0.02", "--height-scale 0.00001", "--exaggeration 3",
    ],
    "field mine.obj out.npz --nw 4 --mapping 0.02": ["--unit-m 2"],
    "field sphere.toml out.npz --device tshirt-32x32 --nw 4": ["--pool mean", "--cutoff literal"],
    "encode moving.npz out.touch --nw 4": [
        "--k 0.4", "--f0-n 0.5", "--mode mask-direction", "--mode nmse", "--segment-frames 2",
        "--support exact",
        "--interframe off", "--friction 0.7", "--damping-n-s-per-m 3", "--vibration gain=0.1,frequency=150",
    ],
    "encode moving.npz out.touch --nw 4 --mode mask-direction --direction-jnd-deg 3": [
        "--direction-jnd-deg 60",
    ],
    "encode moving.npz out.touch --nw 4 --mode nmse": ["--step-n 0.4"],
    "encode fine.touch out.touch --masking 0.3 --body-site palm --f0-n 0": [
        "--masking 0.9", "--body-site belly",
    ],
    "encode moving.npz out.touch --nw 4 --coder paper": [
        "--k 0.4", "--nq 3", "--directions ico1", "--amplitude uniform", "--deadband none",
        "--interframe none",
        "--stage dct",
    ],
    "filter fine.touch out.npz --gaussian 1mm": [
        "--fir 1/2/1", "--lowpass pitch=8mm", "--shading 6mm", "--perona-malik steps=9,kappa=0.5",
        "--multiresolution stages=1", "--texture salt-pepper:seed=1",
    ],
    "filter fine.touch out.npz --fir 1/2/1": ["--gaussian 3mm"],
    "edit moving.touch out.touch --operator gain:2": [
        "--region force:0.5..9", "--frames 2:5", "--operator limit:0.3", "--k 0.4",
    ],
    "edit moving.touch out.npz --operator gain:2 --region ball:0mm,0mm,0mm,8mm": ["--feather 9mm"],
    "splice moving.touch fine.touch out.touch": [
        "--kernel box", "--friction 0.7", "--damping-n-s-per-m 3", "--k 0.4",
    ],
    "splice moving.touch moving.touch out.touch": ["--fade-s 0.1"],
    "resample moving.touch out.npz --nw 3": ["--kernel box", "--rate-hz 12", "--nw 5"],
    "resample moving.touch out.touch --rate-hz 15": ["--shape 8,9,10", "--spacing 6mm", "--k 0.4"],
    "lod moving.touch": ["--levels 2", "--max-bytes 1200", "--k 0.4"],
    "partition fine.touch": ["--depth 1", "--penalty-bits 1", "--quantiser uniform:0.5"],
    "compare sphere.toml fine.touch --no-picture": ["--k 0.001 --f0-n 0.0001", "--k 0.001", "--f0-n 0.0001"],
    "play moving.touch --offline --seconds 0.3 --log out.csv": [
        "--profile novint-falcon", "--trajectory hand.csv", "--trace hand.csv", "--start-s 0.1",
        "--speed 4", "--device sim:spring",
        "--rate-hz 500", "--friction 0.8", "--damping-n-s-per-m 4", "--coupling-n-per-m 40", "--scale 1.5",
        "--force-scale 0.25",
        "--peak-n 0.3", "--slew-n-per-s 9", "--render field", "--wall-n-per-m 33", "--clutch-mm 1,2,3",
        "--gravity-n 0,-0.5,0.5", "--tool sphere:0.006", "--seconds 0.2",
    ],
    "play moving.touch --offline --seconds 0.3 --log out.csv --trajectory hand.csv": [
        "--continuous-n 0.05", "--loop --start-s 0.2",
    ],
    "play moving.touch --offline --seconds 0.3 --log out.csv --start-s 0.1": ["--no-blend"],
    "measure moving.touch": [
        "--quantiser uniform:0.3", "--over object", "--estimator miller-madow", "--no-limits",
        "--device phantom-omni",
    ],
    "measure moving.touch --device phantom-omni": ["--density 3"],
    "measure sphere.toml --nw 4": ["--reference novint-falcon", "--thickness-m 0.002"],
    "reduce moving.touch out.touch": ["--rank 1", "--k 0.4"],
    "reduce moving.touch": [
        "--modes bricks", "--nmse-db -60", "--push-n 0.05", "--mass-kg 9", "--speed-m-s 4",
        "--device novint-falcon", "--trace hand.csv",
    ],
    "similar moving.touch sphere.touch": ["--quantiser uniform:0.4", "--over voxel"],
    "similar moving.touch sphere.toml": ["--nw 4", "--looks 2"],
    "points 5 moving.touch": ["--modes 1"],
    "deform moving.touch -o out.npz --yield-m-per-n 0.002": [
        "--controls 5",
        "--yield-m-per-n 0.004",
        "--relax-s 0.2",
    ],
    "deform snake.touch snake.glb -o out.npz --controls 4": [
        "--frames 2:7",
        "--rest-frame 3",
        "--rate-hz 20",
        "--controls 6",
    ],
    "import wave.hjif out.touch": ["--rate-hz 50", "--force-max-n 2"],
    "export moving.touch out.hjif --trajectory hand.csv": ["--full-scale-n 4", "--device novint-falcon"],
    "export moving.touch out.html": ["--source moving.npz"],
    "correlate look.png moving.touch": ["--looks 2", "--reading first"],
    "texture one.csv two.csv -o out.json --speed-m-s 0.1,0.2 --force-n 1": [
        "--speed-m-s 0.1,0.3",
        "--force-n 2",
        "--name oak",
        "--friction 0.4",
    ],
}  # fmt: skip


def run_and_read(arguments: list[str], folder: Path, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    """The values that a command prints, and the contents of the file that it writes."""
    for old in folder.glob("out.*"):
        old.unlink()
    capsys.readouterr()
    assert _exit_code([*arguments, "--json"]) == 0, f"{arguments}: {capsys.readouterr().err}"
    values = json.loads(capsys.readouterr().out)
    names = ("file", "page", "notes")
    contents = {
        key: value for key, value in values.items() if not key.endswith(VOLATILE) and key not in names
    }
    for path in folder.glob("out.*"):
        contents[path.suffix] = file_content(path)
        contents.pop("file_bytes", None)  # the file contains the options as text
    return contents


def file_content(path: Path) -> Any:
    if path.suffix == ".npz":
        with np.load(path) as file:
            if "forces_n" not in file:  # a deformation
                return {key: file[key].tobytes() for key in file}
            return {key: file[key].tobytes() for key in ("forces_n", "origin_m", "spacing_m", "rate_hz")}
    if path.suffix == ".touch":
        with open_file(path) as stream:
            head = stream.reader.head
            fields = [field.forces_n.tobytes() for field in stream.medium]
            coefficients = (
                head.friction,
                head.damping_n_s_per_m,
                head.weber_fraction,
                head.force_threshold_n,
            )
            spans = [(segment.first_frame, segment.frame_count) for segment in stream.reader.segments]
            return fields, coefficients, spans, stream.bits
    return path.read_bytes()


@pytest.mark.thorough
@pytest.mark.parametrize("base", CASES)
def test_options_change_the_result(
    base: str, folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    expected = run_and_read(base.split(), folder, capsys)
    assert run_and_read(base.split(), folder, capsys) == expected, "two runs differ by themselves"
    ineffective = [
        option
        for option in CASES[base]
        if run_and_read([*base.split(), *option.split()], folder, capsys) == expected
    ]
    assert not ineffective, f"{base}: {ineffective} change nothing"


def test_comparison_uses_the_mask_of_its_options(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)

    def compare(*options: str) -> dict[str, Any]:
        capsys.readouterr()
        assert _exit_code(["compare", "sphere.toml", "fine.touch", "--no-picture", "--json", *options]) == 0
        values: dict[str, Any] = json.loads(capsys.readouterr().out)
        return values

    default, fraction, floor = compare(), compare("--k", "0.001"), compare("--f0-n", "0.001")
    assert default["mask_violations"] == 0 and (default["k"], default["f0_n"]) == (0.1, 0.05)
    assert (fraction["k"], fraction["f0_n"]) == (0.001, 0.05) and (floor["k"], floor["f0_n"]) == (0.1, 0.001)
    both = compare("--k", "0.001", "--f0-n", "0.001")
    assert default["worst_mask_ratio"] < fraction["worst_mask_ratio"] < both["worst_mask_ratio"]
    assert default["worst_mask_ratio"] < floor["worst_mask_ratio"] < both["worst_mask_ratio"]


def test_comparison_reads_outside_the_folder_only_if_allowed(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("mujoco")
    monkeypatch.chdir(folder)
    paths = ["inside/outside.toml", "outside.touch"]
    assert _exit_code(["encode", *paths, "--nw", "3", "--seconds", "0.02"]) == 1
    assert "--allow-outside" in capsys.readouterr().err and not (folder / "outside.touch").exists()
    assert _exit_code(["encode", *paths, "--nw", "3", "--seconds", "0.02", "--allow-outside"]) == 0
    assert _exit_code(["compare", *paths, "--no-picture"]) == 1
    assert "--allow-outside" in capsys.readouterr().err
    assert _exit_code(["compare", *paths, "--no-picture", "--allow-outside"]) == 0


def test_scene_is_measured_in_the_reference_workspace(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    found = []
    for options in ([], ["--reference", "novint-falcon"]):
        capsys.readouterr()
        arguments = ["measure", "sphere.toml", "--nw", "4", "--no-limits", "--json", *options]
        assert _exit_code(arguments) == 0
        found.append(json.loads(capsys.readouterr().out))
    assert found[0]["occupancy"] != found[1]["occupancy"], (
        "the sphere fills another share of another workspace"
    )
