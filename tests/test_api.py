"""touchfield from a program: lazily imported packages, media from arrays, errors of touchfield's
own classes.
"""

from __future__ import annotations

import copy
import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import touchfield as tf
from touchfield.codec import TouchSpec

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = (
    *(
        "cli",
        "codec",
        "compute",
        "container",
        "devices",
        "exchange",
        "filters",
        "guidance",
        "maps",
        "measure",
        "medium",
        "network",
    ),
    *("perception", "pipeline", "reduction", "render", "sources", "study", "tasks", "viewer"),
)
GRID = tf.Grid.over_box((-0.05,) * 3, (0.05,) * 3, (16, 16, 16))

USER = """
import numpy as np
import touchfield as tf

grid = tf.Grid.over_box((-0.05,) * 3, (0.05,) * 3, (16, 16, 16))
medium = tf.HapticMedium.from_array(np.zeros((2, 16, 16, 16, 3)), grid, 30.0)
one: tf.ForceField = medium[0]
some: tf.HapticMedium = medium[0:1].filtered("gaussian:sigma=2mm")
blended: tf.ForceField = medium.at(0.01)
total: float = float(medium.sample_n([[0.0, 0.0, 0.0]], 0.01).sum())
done = tf.encode(medium, "x.touch", tf.EncodeSpec(touch=tf.codec.TouchSpec(k=0.2)))
size: int = done.file_bytes
back: tf.HapticMedium = tf.decode("x.touch")
entry = tf.measure.descriptor(back)
sampler = tf.FieldSampler(back)
names: list[str] = [device.name for device in tf.devices()]
tf.play("x.touch", tf.tasks.PlaySpec(offline=True))
"""


@pytest.fixture
def forces() -> NDArray[np.float64]:
    """Three frames of a block that pushes outwards, with half the force in the second."""
    frames = np.zeros((3, *GRID.shape, 3))
    frames[:, 4:8, 4:8, 4:8, 2] = 5.0
    frames[1] /= 2
    return frames


def medium_of(forces: NDArray[np.float64]) -> tf.HapticMedium:
    return tf.HapticMedium.from_array(forces, GRID, 20.0)


# -- names -------------------------------------------------------------------------------------------------


def test_every_name_exists_and_packages_are_imported_lazily() -> None:
    program = f"""
import sys, touchfield as tf
heavy = [m for m in ("numba", "scipy", "trimesh", "matplotlib", "touchfield.pipeline") if m in sys.modules]
assert not heavy, heavy
for package in {PACKAGES}:
    assert getattr(tf, package).__name__ == "touchfield." + package
for name in tf.__all__:
    assert getattr(tf, name) is not None
assert tf.render.sampler.FieldSampler is tf.FieldSampler and tf.sources.laws and tf.codec.registry
assert tf.devices() == tf.devices.devices() and tf.devices.device is tf.device
assert all(callable(getattr(tf.exchange, name)) for name in tf.exchange.__all__)
assert set(dir(tf)) == {{*tf.__all__, *{PACKAGES}}}
"""
    subprocess.run([sys.executable, "-c", program], check=True, timeout=300)


def test_missing_names_raise_the_errors_of_python() -> None:
    for owner in (tf, tf.render, tf.sources):
        with pytest.raises(AttributeError, match="nothing"):
            _ = owner.nothing
    with pytest.raises(ImportError):
        from touchfield.render import nothing  # noqa: F401


@pytest.mark.thorough
def test_a_program_of_a_user_is_checked_by_mypy(tmp_path: Path) -> None:
    assert (ROOT / "src" / "touchfield" / "py.typed").is_file()
    pytest.importorskip("mypy")
    programs = {"good.py": USER, "bad.py": USER + "\nmedium[0].no_such_name()\nwrong: int = medium.at(0.0)\n"}
    for name, text in programs.items():
        (tmp_path / name).write_text(text)
    # a checkout on the path stands for the installation; py.typed exports its types
    command = [
        sys.executable,
        "-m",
        "mypy",
        "--strict",
        "--follow-imports=silent",
        "--ignore-missing-imports",
    ]
    command += ["--config-file=", f"--cache-dir={os.devnull}", *programs]
    environment = {"MYPYPATH": str(ROOT / "src"), "PATH": "/usr/bin:/bin"}
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=600, env=environment, check=False, cwd=tmp_path
    )
    assert done.returncode == 1 and done.stderr == "", done.stdout + done.stderr
    *errors, total = done.stdout.splitlines()
    assert "in 1 file (checked 2 source files)" in total and all(
        line.startswith("bad.py:") for line in errors
    ), errors
    assert "no_such_name" in done.stdout and "Incompatible types" in done.stdout


# -- media -------------------------------------------------------------------------------------------------


def test_an_array_becomes_a_medium_that_can_be_sliced_and_sampled(forces: NDArray[np.float64]) -> None:
    medium = medium_of(forces)
    assert len(medium) == 3 and medium.rate_hz == 20.0
    assert np.array_equal(medium[0].to_dense(), forces[0].astype(np.float32))
    assert len(tf.HapticMedium.from_array(forces[0], GRID)) == 1
    assert [len(medium[1:]), len(medium[:-1]), len(medium[:])] == [2, 2, 3]
    assert medium[1:][0] == medium[1] and medium[-1] == medium[2]


def test_a_medium_is_linear_between_frames_and_constant_outside(forces: NDArray[np.float64]) -> None:
    medium = medium_of(forces)
    assert medium.at(0.05) == medium[1] and medium.at(-1.0) == medium[0] and medium.at(9.0) == medium[2]
    quarter = medium.at(0.0125)
    assert quarter.to_dense()[5, 5, 5, 2] == pytest.approx(5.0 - 0.25 * 2.5)
    points = np.array([[[-0.015, -0.016, -0.017]], [[0.04, 0.0, 0.0]]])
    assert medium.sample_n(points, 0.0125) == pytest.approx(quarter.sample_n(points), abs=1e-6)
    assert medium.sample_n(points).shape == (2, 1, 3)


def test_a_filter_as_text_equals_the_filter(forces: NDArray[np.float64]) -> None:
    medium = medium_of(forces)
    gaussian = tf.filters.filter_of("gaussian", "sigma=4mm")
    filtered = medium.filtered("gaussian:sigma=4mm", "gaussian:sigma=4mm")
    assert filtered[1] == gaussian(gaussian(medium[1]))
    assert filtered.provenance["filters"].count("gaussian") == 2


def test_a_plot_is_a_figure_and_a_file(forces: NDArray[np.float64], tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    figure = medium_of(forces).plot(tmp_path / "seen.png")
    assert len(figure.axes) >= 3
    assert (tmp_path / "seen.png").read_bytes().startswith(b"\x89PNG")


# -- encoding ----------------------------------------------------------------------------------------------


def test_media_fields_and_arrays_are_encoded_directly(forces: NDArray[np.float64], tmp_path: Path) -> None:
    exact = tf.EncodeSpec(touch=TouchSpec(mode="lossless"))
    out = tmp_path / "x.touch"
    for source, grid, frames in (
        (medium_of(forces), None, 3),
        (medium_of(forces)[0], None, 1),
        (forces, GRID, 3),
    ):
        done = tf.encode(source, out, exact, grid=grid)
        back = tf.decode(out)
        assert len(back) == frames and back.grid == GRID
        assert np.array_equal(back[0].to_dense(), forces[0].astype(np.float32)), (
            "5 N, beyond F_max, and not scaled"
        )
        assert done.file_bytes == out.stat().st_size
        summary = tf.compare(medium_of(forces)[:frames], out).summary()
        assert summary["nmse_db"] is None and summary["mask_violations"] == 0
    assert tf.tasks.measure_medium(tf.decode(out)).summary()


def test_the_file_of_a_decoded_medium_stays_open_while_it_is_used(
    forces: NDArray[np.float64], tmp_path: Path
) -> None:
    out = tmp_path / "x.touch"
    tf.encode(medium_of(forces), out)
    assert tf.decode(out)[1:][0].support_count == 64


# -- copies ------------------------------------------------------------------------------------------------


def test_values_can_be_copied_and_sent_to_other_processes(forces: NDArray[np.float64]) -> None:
    medium = medium_of(forces)
    for value in (medium, medium[1:], medium[2]):
        for copied in (copy.deepcopy(value), pickle.loads(pickle.dumps(value))):
            assert repr(copied) == repr(value)
    copied = pickle.loads(pickle.dumps(replace(medium[1:], provenance={"a": "b"})))
    assert copied[0] == medium[1] and dict(copied.provenance) == {"a": "b"}
    with pytest.raises(TypeError):
        copied.provenance["a"] = "c"
    device = tf.device("phantom-omni")
    assert pickle.loads(pickle.dumps(device)) == device == copy.deepcopy(device)


def test_only_fields_are_added(forces: NDArray[np.float64]) -> None:
    with pytest.raises(TypeError, match="unsupported operand"):
        medium_of(forces)[0] + 1.0  # type: ignore[operator]


# -- texts -------------------------------------------------------------------------------------------------


def test_values_and_results_have_a_one_line_representation(
    forces: NDArray[np.float64], tmp_path: Path
) -> None:
    medium = medium_of(forces)
    done = tf.encode(medium, tmp_path / "x.touch")
    compared = tf.compare(medium, tmp_path / "x.touch")
    assert not compared.notes  # no option was given that could be idle
    with tf.open_stream(tmp_path / "x.touch") as stream:
        texts = [
            repr(v)
            for v in (medium, medium[0], done, done.prepared, compared, stream.medium, tf.EncodeSpec())
        ]
    assert all("\n" not in text and len(text) < 1600 for text in texts)
    assert all(len(text) < 300 for text in texts[:-1])
    assert texts[0] == (
        "<HapticMedium: 3 frames at 20 Hz on 16 x 16 x 16 samples of 6.25 x 6.25 x 6.25 mm; x, y, z>"
    )
    assert "64 of 4,096 samples" in texts[1]


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (lambda f: tf.encode(f, "x.touch"), "without its grid"),
        (lambda f: tf.encode(3, "x.touch"), "HapticMedium"),
        (lambda f: tf.plan(medium_of(f), 64e3), "a path"),
        (lambda f: tf.HapticMedium.from_array(f * np.nan, GRID), "not finite"),
        (lambda f: tf.HapticMedium.from_array(f[..., :2], GRID), "shape"),
        (lambda f: tf.HapticMedium.from_array(f[0, 0], GRID), "as the grid says"),
        (lambda f: tf.HapticMedium.from_array("forces", GRID), "no array of numbers"),
        (lambda f: tf.ForceField.from_dense(GRID, "forces"), "no array of numbers"),
        (lambda f: tf.ForceField.from_support(GRID, [[1, 2, 3]], [1.0, 2.0]), "no array of numbers"),
        (lambda f: tf.ForceField.from_bricks(GRID, [[0, 0, 0]], f), "no array of numbers"),
        (lambda f: tf.Grid(8, 1.0, 0.0), "three numbers"),
        (lambda f: tf.Grid.over_box((0, 0), (1, 1), (4, 4)), "three numbers"),
        (lambda f: medium_of(f)[0].sample_n([1.0, 2.0]), "metres"),
        (lambda f: medium_of(f).at(float("nan")), "finite"),
        (lambda f: medium_of(f)[::2], "step"),
        (lambda f: medium_of(f)[2:2], "2:2"),
        (lambda f: medium_of(f).filtered("wish:1"), "one of"),
        (lambda f: medium_of(f).filtered(tf.filters.Gain(2.0)), "one of"),  # type: ignore[arg-type]
        (lambda f: tf.HapticMedium.from_array(f + 1j, GRID), "complex"),
        (lambda f: tf.HapticMedium.from_array(np.ma.masked_greater(f, 1.0), GRID), "masked"),
        (lambda f: tf.HapticMedium.from_array([[1.0], [1.0, 2.0]], GRID), "no array of numbers"),
        (lambda f: tf.HapticMedium.from_array(f, GRID, "30"), "rate_hz"),  # type: ignore[arg-type]
        (lambda f: tf.HapticMedium.from_array(f, GRID.shape), "a Grid"),  # type: ignore[arg-type]
        (lambda f: tf.HapticMedium.from_frames(list(f), 30.0), "from_array"),
        (lambda f: tf.ForceField.from_support(GRID, [[0.5, 0, 0]], [[1.0, 0, 0]]), "not whole"),
        (lambda f: tf.ForceField.from_bricks(GRID, np.array([[1 << 32, 0, 0]]), f), "beyond int32"),
        (lambda f: tf.Grid((1.5, 8, 8), (1, 1, 1), (0, 0, 0)), "counts"),  # type: ignore[arg-type]
        (lambda f: tf.Grid.over_box((0, 0, 0), (1, 1, 1), (4.5, 4, 4)), "counts"),  # type: ignore[arg-type]
        (lambda f: medium_of(f)["1"], "whole number"),  # type: ignore[call-overload]
        (lambda f: medium_of(f)[1.5:2], "whole number"),  # type: ignore[misc]
        (lambda f: medium_of(f).at("0"), "time_s"),  # type: ignore[arg-type]
        (lambda f: tf.FieldSampler(medium_of(f)[0]), "stream.medium"),  # type: ignore[arg-type]
        (lambda f: tf.FieldSampler(medium_of(f)).force_n(0.0, [[1.0], [1.0, 2.0]]), "points_m"),
        (lambda f: tf.FieldSampler(medium_of(f)).force_n("now", [0.0, 0.0, 0.0]), "time_s"),
        (lambda f: tf.FieldSampler(medium_of(f)).at(0, "x", 0, 0), "no array of"),  # type: ignore[arg-type]
        (lambda f: tf.EncodeSpec(filters=("gaussian:2mm",)), "names and words"),  # type: ignore[arg-type]
        (lambda f: tf.encode(medium_of(f), "x.touch", TouchSpec()), "EncodeSpec"),  # type: ignore[arg-type]
        (lambda f: tf.encode(medium_of(f), None), "a path"),  # type: ignore[arg-type]
        (lambda f: tf.plan("sample:shapes", "64 parsecs"), "64kbit/s"),
        (lambda f: tf.tasks.PlaySpec(seconds="1"), "^seconds: found '1'.* number"),  # type: ignore[arg-type]
        (lambda f: tf.encode(medium_of(f), "x.npz"), "'.npz'; expected OUT.touch"),
        (lambda f: tf.tasks.MeasureSpec(estimator="x"), "^estimator: "),
        (lambda f: tf.EncodeSpec(nw="6"), "^nw: found '6'.* a whole number"),  # type: ignore[arg-type]
        (lambda f: tf.EncodeSpec(nw=99), "^nw: found 99; expected a whole number from 3 to 10"),
        (lambda f: tf.EncodeSpec(mapping="-1"), "^mapping: .*positive"),
        (lambda f: tf.EncodeSpec(mapping="wide"), "^mapping: .*fit, fill"),
        (lambda f: tf.EncodeSpec(frames=(3, 1)), "^frames: .*START below STOP"),
        (lambda f: tf.EncodeSpec(fit_frames=3), "^fit_frames: "),  # type: ignore[arg-type]
        (lambda f: tf.EncodeSpec(law="glue"), "one of penalty"),
        (lambda f: tf.EncodeSpec(pool="deep"), "^pool: "),
        (lambda f: tf.EncodeSpec(representation="x"), "^representation: "),
        (lambda f: tf.EncodeSpec(surface_damping_n_s_per_m=-1), "^surface_damping"),
        (lambda f: tf.EncodeSpec(filters=(("glue", "2mm"),)), "^filters: .*one of gaussian"),
        (lambda f: tf.EncodeSpec(touch=3), "TouchSpec"),  # type: ignore[arg-type]
        (lambda f: TouchSpec(k="0.1"), "^k: .*a number"),  # type: ignore[arg-type]
        (lambda f: tf.sources.SourceOptions(allow_outside=1), "True or False"),  # type: ignore[arg-type]
        (lambda f: tf.filters.Gain("2"), "gain"),  # type: ignore[arg-type]
        (lambda f: tf.filters.gaussian("signal", 1.0), "no array of numbers"),
    ],
)
def test_bad_arguments_raise_touchfield_errors(
    bad: Callable[[NDArray[np.float64]], object], message: str, forces: NDArray[np.float64]
) -> None:
    with pytest.raises(tf.TouchfieldError, match=message):
        bad(forces)
