"""Coder `touch` in C (``c/touch.h`` and ``c/touch_encode.h``) as a module of Python.

Arrays are C-contiguous buffers of the given dtype and shape; results are bytes. Every function releases the
GIL while C works, and holds no state but in the objects that it returns. One that fails raises ValueError
with two arguments: a code of ``touch.h`` (2 truncated, 3 corrupt, 4 of another version, 5 out of memory, 6
an invalid argument), and a text that says what is wrong.
"""

from collections.abc import Buffer, Callable, Sequence

Shape = tuple[int, int, int]
Frame = tuple[Buffer, Buffer, Buffer | None]
"""Bricks int32 [n, 3], ascending; forces float32 [n, 8, 8, 8, 3], newtons; and the error that surrounding
forces hide, float32 [n, 512], newtons, or None."""
Support = tuple[Buffer, Buffer]
"""Bricks int32 [n, 3], ascending, and whether each sample is set, uint8 [n, 8, 8, 8]."""
Options = tuple[int, int, int, int, int, float, float, float, float]
"""The fields of `touch_options` in their order."""
Spline = tuple[tuple[int, int, int], int, tuple[int, int, int], Buffer]
"""Shifts, step, scales, and coefficients float64 [nodes]: the fields of `touch_spline`."""

def open_fields(shape: Shape, parameters: bytes, body: bytes, frame_count: int) -> object:
    """Open the body of a segment."""

def next_field(fields: object) -> tuple[bytes, bytes] | None:
    """Bricks int32 [n, 3], ascending, and forces float32 [n, 8, 8, 8, 3] of the next frame; None after the
    last one. Bricks whose forces are all zero bits are left out."""

def encode_segment(
    shape: Shape,
    spacing_m: tuple[float, float, float],
    options: Options,
    frames: Sequence[Frame],
    key_frame: Frame | None,
    fit_spline: Callable[[int, int], Spline | None] | None,
) -> tuple[bytes, list[int]]:
    """The body of a segment, and the number of decoded voxels with a force in each frame.

    `key_frame` is coded in place of the first frame. `fit_spline(frame, level)` fits a spline to the frame
    of that index (-1: the key frame), or returns None.
    """

def is_static(
    shape: Shape, spacing_m: tuple[float, float, float], options: Options, frame: Frame, earlier: Frame
) -> bool:
    """Whether segments of a static scene may share `earlier` in place of `frame` (`touch_is_static`)."""

def add_exact_samples(
    shape: Shape,
    spacing_m: tuple[float, float, float],
    options: Options,
    body: bytes,
    frames: Sequence[Frame],
    samples: Sequence[Buffer],
) -> tuple[bytes, list[int]]:
    """The body with samples of each frame, uint64 [m], sent exactly; decoded voxels as in
    `encode_segment`."""

def encode_support(shape: Shape, support: Support, previous: Support | None) -> bytes:
    """The code of a support (docs/format/bits.md)."""

def decode_support(shape: Shape, data: bytes, previous: Support | None) -> tuple[bytes, bytes]:
    """The inverse of `encode_support`: bricks int32 and samples uint8, as in `Support`."""

def encode_numbers(numbers: Buffer) -> bytes:
    """The code of whole numbers int64 [n], below 2^30."""

def decode_numbers(data: bytes, count: int) -> bytes:
    """The inverse of `encode_numbers`: int64 [count]."""

def encode_vibration(shape: Shape, frames: Sequence[tuple[Buffer, Buffer, Buffer]]) -> bytes:
    """The body of VIBR. A frame is positions int32 [n, 3] in raster order, amplitudes float32 [n], newtons,
    and frequencies float32 [n], hertz."""

def decode_vibration(shape: Shape, body: bytes, frame_count: int) -> list[tuple[bytes, bytes, bytes]]:
    """The inverse of `encode_vibration`: positions int32 [n, 3], steps of amplitude int32 [n], and hertz
    int32 [n] of each frame."""

def encode_poses(numbers: Buffer) -> bytes:
    """The code of poses int64 [n, 7] in steps."""

def decode_poses(data: bytes, count: int, quaternion_unit: int) -> bytes:
    """The inverse of `encode_poses`: int64 [count, 7]. `quaternion_unit` is the number of steps in 1."""
