"""An option that has no effect beside the others is refused, before anything is read."""

from __future__ import annotations

from pathlib import Path

import pytest

from touchfield.cli.main import _exit_code

UNUSED = {
    "deform in.touch --yield-m-per-n 0.002 --rest-frame 3": "--rest-frame has no effect without MODEL",
    "deform in.touch fox.glb --relax-s 0.1": "--relax-s has no effect without --yield-m-per-n",
    "texture drag.csv -o oak.json --full-scale-m-s2 20": "--full-scale-m-s2 has no effect without a .wav",
    "points 5 in.touch --next --k 0.2": "--k has no effect with --next",
    "points 5 in.touch --next --segment-frames 3": "--segment-frames has no effect with --next",
    "play in.touch --check --loop": "--loop has no effect with --check, which plays nothing",
    "play in.touch --check --friction 0.2": "--friction has no effect with --check",
    "play in.touch --check --log log.csv": "--log has no effect with --check",
    "play in.touch --device pins:h:9 --friction 0.2": "--friction has no effect with --device pins:h:9",
    "play in.touch --device osc:h:9 --bridge": "--bridge has no effect with --device osc:h:9, an array",
    "view in.touch --rerun --source scan.stl": "--source has no effect with --rerun",
    "view in.touch --rerun --no-open": "--no-open has no effect with --rerun",
    "view in.touch --rerun --device pins": "--device has no effect with --rerun",
    "view in.touch --log felt.csv": "--log has no effect without --rerun",
    "view in.touch --rerun --out page.html": "page.html: found the ending '.html'; expected OUT.rrd",
    "play in.touch --panel back": "--panel has no effect with --device sim, which is no array",
    "compare scan.stl in.touch --no-picture --picture out.png": "--picture has no effect with --no-picture",
    "compare scan.stl in.touch --no-picture --frame 0": "--frame has no effect with --no-picture",
    "measure in.touch --density 4": "--density has no effect without --device",
    "export in.touch page.html --device tshirt-32x32": "--device: found one for .html",
    "export in.touch page.html --panel back": "--panel: found 'back'",
    "export in.touch out.wav --trajectory hand.csv --panel back": "--panel: found 'back'",
    "study run design.toml out --observer threshold=2 --wait 1s": "--wait: found no device to wait for",
}


@pytest.mark.parametrize("words", UNUSED)
def test_an_option_without_effect_is_refused(
    words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert _exit_code(words.split()) == 2
    stderr = capsys.readouterr().err
    assert stderr.startswith(f"touchfield: {UNUSED[words]}") and stderr.count("\n") == 1, stderr
    assert not list(tmp_path.iterdir())
