"""`c/touch_write.h` writes whole files, which Python reads with the error bound that they state."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest
from second import decoder
from test_c import COMPILER, STRICT, C, built

import touchfield as tf
from touchfield.codec.touch.encoder import TouchEncoder

pytestmark = pytest.mark.skipif(COMPILER is None, reason="there is no C compiler here")

SHAPE, SPACING_M, K, F0_N = (20, 17, 12), 0.004, 0.1, 0.02
FRAMES = 19  # two segments, of 15 frames and 4


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`touch_write`, compiled with warnings as errors and, where there are some, sanitizers."""
    folder = tmp_path_factory.mktemp("write")
    watched = ("-Og", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
    probe = folder / "probe.c"
    probe.write_text("int main(void) { return 0; }\n")
    command = [str(COMPILER), *watched, "-o", str(folder / "probe"), str(probe)]
    has_sanitizers = not subprocess.run(command, capture_output=True, check=False).returncode
    return built(folder, "touch_write", *(watched if has_sanitizers else ("-O2",)))


def moving_field() -> np.ndarray:
    """A surface that moves through a lattice that is no multiple of a brick, float32 [frames, x, y, z, 3]."""
    x, y, z = np.meshgrid(*(np.arange(n) for n in SHAPE), indexing="ij")
    forces = np.zeros((FRAMES, *SHAPE, 3), np.float32)
    for i in range(FRAMES):
        depth = 4 + i / 4 + np.sin(x / 5) - z
        forces[i, ..., 2] = np.where(depth > 0, 0.3 * depth, 0)
        forces[i, ..., 0] = np.where(depth > 0, 0.2 * np.cos(y / 6), 0)
    return forces


def write(program: Path, folder: Path, forces: np.ndarray, *numbers: float) -> tuple[int, str, Path]:
    """Exit code, text and file of `touch_write`."""
    raw, stream = folder / "raw", folder / "out.touch"
    raw.write_bytes(forces.astype("<f4").tobytes())
    command = [program, raw, stream, *(str(n) for n in (*forces.shape[1:4], SPACING_M, *numbers))]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert "Sanitizer" not in done.stderr and "runtime error" not in done.stderr, done.stderr
    return done.returncode, done.stdout.strip() + done.stderr, stream


def test_a_written_file_decodes_within_its_error_bound(program: Path, tmp_path: Path) -> None:
    forces = moving_field()
    assert write(program, tmp_path, forces, K, F0_N)[:2] == (0, "0")
    stream = tmp_path / "out.touch"
    head = decoder.read_file(stream.read_bytes()).head
    assert (head["weber_fraction"], head["force_threshold_n"], head["coder"]) == (K, F0_N, "touch")
    with tf.open_stream(stream) as opened:
        assert [entry.frame_count for entry in opened.reader.segments] == [15, 4]
    medium = tf.decode(stream)
    assert medium.grid.shape == SHAPE and medium.grid.spacing_m == pytest.approx((SPACING_M,) * 3)
    decoded = np.stack([medium[i].to_dense() for i in range(FRAMES)])
    allowed = np.maximum(F0_N, K * np.linalg.norm(forces, axis=-1))
    ratio = np.linalg.norm(decoded.astype(np.float64) - forces, axis=-1) / allowed
    assert 0.5 < ratio.max() <= 1 + 1e-6
    assert stream.stat().st_size < forces.nbytes / 50


def test_the_bytes_are_those_of_the_package(program: Path, tmp_path: Path) -> None:
    """Noise has no base layer, whose fit differs: everything else is coded alike."""
    rng = np.random.default_rng(4)
    forces = rng.standard_normal((3, *SHAPE, 3)).astype(np.float32)
    forces[:, :, :, 9:] = 0
    stream = write(program, tmp_path, forces, K, F0_N)[2]
    grid = tf.decode(stream).grid
    coder = TouchEncoder(grid, tf.codec.TouchSpec(k=K, f0_n=F0_N))
    frames = list(tf.HapticMedium.from_array(forces, grid, 30.0))
    with tf.open_stream(stream) as opened:
        assert opened.reader.head.coder_parameters == coder.parameters
    assert coder.encode_segment(frames).body in stream.read_bytes()


@pytest.mark.parametrize(
    ("numbers", "message"),
    [((0.0, 0.1), "6 a Weber fraction k"), ((1.0, 0.1), "6 a Weber fraction k"),
     ((0.1, -1.0), "6 a force F_0"), ((0.1, float("nan")), "6 a force F_0")],
)  # fmt: skip
def test_a_bound_out_of_range_is_refused(
    numbers: tuple[float, float], message: str, program: Path, tmp_path: Path
) -> None:
    code, text, _ = write(program, tmp_path, np.ones((1, 8, 8, 8, 3)), *numbers)
    assert code == 6 and message in text


def test_a_force_that_is_not_finite_is_refused(program: Path, tmp_path: Path) -> None:
    forces = np.ones((2, 8, 8, 8, 3))
    forces[1, 1, 2, 3, 1] = np.nan
    code, text, stream = write(program, tmp_path, forces, 0.1, 0.1)
    assert code == 6 and "not finite" in text and not stream.exists()


SMALL = """
#define TOUCH_ENCODE_IMPLEMENTATION
#include "touch_write.h"
#include <stdio.h>
#include <stdlib.h>

/* Write one brick with ever more memory: all sizes of `out` fail with TOUCH_MEMORY until one is enough. */
int main(void) {
    static float forces[1536];
    static const int32_t brick[3];
    touch_options options = {TOUCH_MASK, 0, TOUCH_INTER_AUTO, 1, 1, 0.1, 0.05, 0, 0};
    touch_source frame = {1, brick, forces, 0};
    touch_head head;
    touch_bytes file = {0, 0};
    memset(&head, 0, sizeof head);
    for (int n = 0; n < 3; n++) head.grid.shape[n] = 8, head.grid.spacing_m[n] = 0.01;
    head.rate_hz = 30, head.frame_count = 1, head.device_type = 1, head.force_max_n = head.mapping_scale = 1;
    for (int n = 2; n < 1536; n += 3) forces[n] = 1;
    uint64_t room = touch_encode_room(&head.grid, &options, 1), failed = 0;
    void *work = malloc((size_t)room);
    for (uint64_t size = 0; size < 1 << 16; size += 16) {
        touch_file_writer writer;
        uint8_t *out = (uint8_t *)malloc((size_t)size + 1);
        int code = touch_write_start(&writer, &head, &options, touch_arena_of(out, size));
        if (!code) code = touch_write_segment(&writer, &frame, 0, 1, touch_arena_of(work, room));
        if (!code) code = touch_write_finish(&writer, &file);
        free(out);
        if (!code) return printf("%d %d\\n", (int)failed, (int)file.size), 0;
        if (code != TOUCH_MEMORY || !writer.error[0]) return 1;
        failed++;
    }
    return 2;
}
"""


def test_too_little_memory_is_reported_at_every_size(tmp_path: Path) -> None:
    source = tmp_path / "small.c"
    source.write_text(SMALL)
    command = [str(COMPILER), *STRICT, "-O2", f"-I{C}", "-o", str(tmp_path / "small"), str(source), "-lm"]
    assert subprocess.run(command, check=False).returncode == 0
    done = subprocess.run([tmp_path / "small"], capture_output=True, text=True, check=False)
    assert done.returncode == 0
    failed, size = map(int, done.stdout.split())
    assert 16 * failed >= size > 250
