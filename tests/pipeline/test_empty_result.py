"""A result in which nothing can be felt is refused, with an option that helps, and no file is left."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from touchfield.cli.main import _exit_code
from touchfield.codec.touch.spec import TouchSpec
from touchfield.errors import InvalidArgument, SourceError
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.pipeline import EncodeSpec, encode, open_file
from touchfield.pipeline.rate_control import Target, encode_to_target
from touchfield.tasks.library import similar
from touchfield.tasks.measure import MeasureSpec, measure_medium

SPEC = EncodeSpec(nw=4)
GRID = Grid((8, 8, 8), (0.001,) * 3, (-0.0035,) * 3)
WEAK = ForceField.from_dense(GRID, np.full((8, 8, 8, 3), 0.01))
STRONG = ForceField.from_dense(GRID, np.full((8, 8, 8, 3), 1.0))


@pytest.fixture
def far_ball(tmp_path: Path) -> Path:
    """Two spheres far apart, of which neither reaches a sample once both fit into the workspace."""
    path, kind = tmp_path / "far.toml", 'kind = "sphere"\nradius_m = 1e-7\n'
    centers = ("[-1.01, -1.0, -1.02]", "[1.0, 1.03, 1.0]")
    path.write_text("".join(f"[[shape]]\n{kind}center_m = {center}\n" for center in centers))
    return path


@pytest.mark.parametrize("by", ["this thread", "workers", "target", "command", "field"])
def test_an_empty_result_is_an_error_and_leaves_no_file(
    far_ball: Path, tmp_path: Path, by: str, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / ("out.npz" if by == "field" else "out.touch")
    if by in ("command", "field"):
        verb = ["encode"] if by == "command" else ["field"]
        arguments = [*verb, str(far_ball), str(out), "--nw", "4"]
        assert _exit_code(arguments) == 1 and not out.exists()
        message = capsys.readouterr().err
        assert _exit_code([*arguments, "--allow-empty"]) == 0 and out.exists()
    else:
        with ThreadPoolExecutor(1) as pool:
            calls: dict[str, Any] = {
                "this thread": lambda: encode(far_ball, out, SPEC),
                "workers": lambda: encode(far_ball, out, SPEC, executor=pool),
                "target": lambda: encode_to_target(far_ball, out, SPEC, Target(bytes=100_000)),
            }
            with pytest.raises(SourceError) as caught:
                calls[by]()
        message = "\n".join([str(caught.value), *(f"note: {note}" for note in caught.value.__notes__)])
        assert [path.name for path in tmp_path.iterdir()] == ["far.toml"]
    notes = [line for line in message.splitlines() if line.startswith("note: ")]
    assert len(notes) == 1 and "the surface fits into the workspace" in notes[0]
    message = " ".join(message.split())
    assert "Nothing can be felt: no sample has a force" in message
    assert "try --nw 5" in message and "--allow-empty" in message


@pytest.mark.parametrize(
    ("changes", "remedy"),
    [
        ({"mapping": "1"}, "try --mapping fit"),
        ({"mapping": "1", "stiffness_n_per_m": 0.5}, "in N/mm is --stiffness-n-per-m 500"),
        ({"thickness_m": 1e-6}, "try --thickness-m 0.0"),
        ({}, "try --nw 5"),
    ],
)
def test_the_remedy_fits_the_cause(
    far_ball: Path, tmp_path: Path, changes: dict[str, Any], remedy: str
) -> None:
    with pytest.raises(SourceError, match=remedy):
        encode(far_ball, tmp_path / "out.touch", replace(SPEC, **changes))


def test_forces_that_are_all_below_the_threshold_are_refused_with_one_that_works(tmp_path: Path) -> None:
    """One frame with a force is enough; the threshold that the message names gives a force."""
    out = tmp_path / "out.touch"
    with pytest.raises(SourceError, match=r"below F_0, 0.05 N. Try --f0-n 0.005"):
        encode(HapticMedium.from_frames([WEAK, WEAK], 30.0), out)
    assert not out.exists()
    encode(HapticMedium.from_frames([WEAK, STRONG], 30.0), out)
    encode(WEAK, out, EncodeSpec(touch=TouchSpec(f0_n=0.005)))
    with open_file(out) as stream:
        assert stream.medium[0].support_count == 512


def test_permission_to_be_empty_is_not_stored_and_not_read_from_a_file() -> None:
    text = EncodeSpec(allow_empty=True).to_json()
    assert "allow_empty" not in text
    assert not EncodeSpec.from_json(text[:-1] + ',"allow_empty":true}').allow_empty


@pytest.mark.parametrize("options", [[], ["--json"]])
def test_the_notes_on_a_source_go_with_the_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str]
) -> None:
    """A body that falls out of sight: the keyframe from which it falls is reported all the same."""
    pytest.importorskip("mujoco", reason='needs the simulator: pip install "touchfield[physics]"')
    model = tmp_path / "key.xml"
    model.write_text(
        '<mujoco><worldbody><body pos="0 0 .5"><freejoint/><geom size=".05"/></body></worldbody>'
        '<keyframe><key name="home" qpos="0 0 2 1 0 0 0"/></keyframe></mujoco>'
    )
    assert _exit_code(["encode", str(model), str(tmp_path / "out.touch"), "--nw", "4", *options]) == 1
    lines = capsys.readouterr().err.splitlines()
    notes = json.loads(lines[0])["notes"] if options else [line.removeprefix("note: ") for line in lines[1:]]
    assert any("starts from the keyframe 'home'" in note for note in notes)
    assert any("1 mm of the hand is" in note for note in notes)


def test_measurements_of_nothing_have_the_notes_too(tmp_path: Path) -> None:
    path = tmp_path / "thin.obj"  # far smaller than the distance of two samples
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1e-9\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    spec = EncodeSpec(nw=4, thin="keep", mapping="1e-6")
    for call in (lambda: measure_medium(path, MeasureSpec(encode=spec)), lambda: similar(path, path, spec)):
        with pytest.raises(InvalidArgument) as caught:
            call()
        assert any("Coordinates taken as metres" in note for note in caught.value.__notes__)
