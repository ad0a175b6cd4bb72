"""`c/touch_encode.h` writes the bytes that the encoder of the package writes."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from encode_content import GOLDEN, MODES, Segment, golden_segments, lossless_segment, random_segment
from native_encoder import COMPILER, NativeEncoder, build

from touchfield.codec.touch import base_layer_fit
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.medium import ForceField, Grid

HERE = Path(__file__).parent
WATCHED = ("-g", "-Og", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
SEEDS = 8

pytestmark = pytest.mark.skipif(COMPILER is None, reason="there is no C compiler here")


@pytest.fixture(scope="module")
def native(tmp_path_factory: pytest.TempPathFactory) -> NativeEncoder:
    """The library, compiled with every warning an error."""
    return NativeEncoder(build(tmp_path_factory.mktemp("c"), "-O2"))


def expected(segment: Segment) -> bytes:
    """The body that the encoder of the package writes."""
    return TouchEncoder(segment.grid, segment.spec).encode_segment(segment.frames).body


def segment_arguments(segment: Segment) -> tuple[Grid, TouchSpec, list[ForceField]]:
    """The arguments of `NativeEncoder.segment`."""
    return segment.grid, segment.spec, segment.frames


def assert_same_bytes(native: NativeEncoder, segment: Segment) -> None:
    """The same body from both encoders."""
    assert native.segment(*segment_arguments(segment)) == expected(segment)


@pytest.mark.parametrize("seed", range(SEEDS))
@pytest.mark.parametrize("mode", MODES)
def test_random_fields_without_base_layer(mode: str, seed: int, native: NativeEncoder) -> None:
    assert_same_bytes(native, random_segment(mode, seed, guess="off"))


@pytest.mark.parametrize("seed", range(SEEDS))
@pytest.mark.parametrize("mode", MODES)
def test_random_fields_with_columns(
    mode: str, seed: int, native: NativeEncoder, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(base_layer_fit, "_FITS", base_layer_fit._FITS[2:])
    assert_same_bytes(native, random_segment(mode, seed))


@pytest.mark.parametrize("seed", range(SEEDS))
@pytest.mark.parametrize("mode", MODES)
def test_random_fields_with_splines(mode: str, seed: int, native: NativeEncoder) -> None:
    """The coefficients are those of the package: their sums of float32 depend on the order of the processor."""
    segment = random_segment(mode, seed)
    assert native.segment(*segment_arguments(segment), has_splines=True) == expected(segment)


@pytest.mark.parametrize("seed", range(2 * SEEDS))
def test_lossless(seed: int, native: NativeEncoder) -> None:
    assert_same_bytes(native, lossless_segment(seed))


@pytest.mark.parametrize("name", GOLDEN)
def test_golden_segments(name: str, native: NativeEncoder) -> None:
    for segment in golden_segments(name):
        assert native.segment(*segment_arguments(segment), has_splines=True) == expected(segment)


def test_key_frame(native: NativeEncoder) -> None:
    segment = random_segment("mask", 1, guess="off")
    key_frame = segment.frames[0].scaled(1.0005)
    coder = TouchEncoder(segment.grid, segment.spec)
    body = coder.encode_segment(segment.frames, key_frame=key_frame).body
    assert native.segment(segment.grid, segment.spec, segment.frames, key_frame) == body


def test_too_little_memory_is_reported(native: NativeEncoder) -> None:
    segment = random_segment("mask", 1, guess="off")
    with pytest.raises(ValueError, match="5: no room for a segment"):
        native.segment(segment.grid, segment.spec, segment.frames, out_bytes=100)


def test_no_memory_is_touched_that_is_not_its_own(tmp_path: Path) -> None:
    """The same segments under the address sanitizer, in a process that has its library."""
    probe = tmp_path / "probe.c"
    probe.write_text("int main(void) { return 0; }\n")
    command = [str(COMPILER), *WATCHED, "-o", str(tmp_path / "probe"), str(probe)]
    asan = subprocess.run([str(COMPILER), "-print-file-name=libasan.so"], capture_output=True, text=True, check=False)
    if subprocess.run(command, capture_output=True, check=False).returncode or not Path(asan.stdout.strip()).is_file():
        pytest.skip("the compiler has no address sanitizer")
    library = build(tmp_path, *WATCHED, source=HERE / "encode_watched.c")
    env = {**os.environ, "LD_PRELOAD": asan.stdout.strip(), "ASAN_OPTIONS": "detect_leaks=0"}
    command = [sys.executable, str(HERE / "encode_all.py"), str(library)]
    done = subprocess.run(command, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-4000:]
