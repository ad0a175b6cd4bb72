"""Functions of the compiled module `touchfield._native`, which is coder `touch` in C (``c/touch.h`` and
``c/touch_encode.h``). Python code of the package calls them to encode and decode segments.

Arrays are C-contiguous buffers of the given dtype and shape; results are bytes. Every function releases the
GIL while C works, unless stated otherwise, and holds no state but in the objects that it returns, each of
which one thread uses at a time. One that fails raises ValueError with two arguments: a code of ``touch.h`` (2
truncated, 3 corrupt, 4 of another version, 5 out of memory, 6 an invalid argument, 8 more than a limit that
the caller gives), and a text that says what is wrong.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

from numpy.typing import NDArray

Buffer = bytes | memoryview | NDArray[Any]
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
CodedBody = tuple[bytes, list[int], tuple[float, int, Shape]]
"""The body of a segment; the number of decoded voxels with a force in each frame; and the largest error over
the error bound, with its frame and voxel."""

def open_fields(shape: Shape, parameters: Buffer, body: Buffer, frame_count: int) -> object:
    """Open the body of a segment before its first frame, after a check of its layout: the lengths of all its
    parts. `parameters` are those of HEAD."""

def next_field(fields: object) -> tuple[bytes, bytes] | None:
    """Bricks int32 [n, 3], ascending, and forces float32 [n, 8, 8, 8, 3] of the next frame; None after the
    last one, and after an error. Bricks whose forces are all zero bits are left out."""

def encode_segment(
    shape: Shape,
    spacing_m: tuple[float, float, float],
    options: Options,
    frames: Iterable[Frame],
    key_frame: Frame | None,
    longest_n: float | None,
    fit_spline: Callable[[int, int, float, float, float], Spline | None] | None,
) -> CodedBody:
    """Code frames, at least one, as a segment.

    `key_frame` is coded in place of the first frame. `longest_n` is an upper limit of the length of all
    forces; if it is given, each frame is coded before the next one is taken from `frames`. `fit_spline(frame,
    level, unit_n, k, f0)` fits a spline to the frame of that index (-1: the key frame), or returns None;
    `unit_n` is a unit in newtons, and max(`f0`, `k` |F|) the error that is allowed, in units. An exception of
    `frames` or `fit_spline` is passed on.
    """

def is_static(
    shape: Shape, spacing_m: tuple[float, float, float], options: Options, frame: Frame, earlier: Frame
) -> bool:
    """Whether segments of a static scene may share `earlier` in place of `frame` (`touch_is_static`)."""

def add_exact_samples(
    shape: Shape,
    spacing_m: tuple[float, float, float],
    options: Options,
    body: Buffer,
    frames: Iterable[Frame],
    samples: Sequence[Buffer],
) -> CodedBody:
    """A body with samples of each frame sent exactly: uint64 [m], ascending, 512 times the number of the
    brick plus the sample."""

def encode_support(shape: Shape, support: Support, previous: Support | None) -> bytes:
    """The code of a support (docs/format/bits.md)."""

def decode_support(shape: Shape, data: Buffer, previous: Support | None) -> tuple[bytes, bytes]:
    """The inverse of `encode_support`: bricks int32 and samples uint8, as in `Support`."""

def encode_numbers(numbers: Buffer) -> bytes:
    """The code of whole numbers int64 [n], below 2^30."""

def decode_numbers(data: Buffer, count: int) -> bytes:
    """The inverse of `encode_numbers`: int64 [count]."""

def encode_vibration(shape: Shape, frames: Sequence[tuple[Buffer, Buffer, Buffer]]) -> bytes:
    """The body of VIBR. A frame is positions int32 [n, 3] in raster order, amplitudes float32 [n], newtons,
    and frequencies float32 [n], hertz."""

def decode_vibration(
    shape: Shape, body: Buffer, frame_count: int, max_samples: int
) -> list[tuple[bytes, bytes, bytes]]:
    """The inverse of `encode_vibration`: positions int32 [n, 3], steps of amplitude int32 [n], and hertz
    int32 [n] of each frame. An error if all frames together have more than `max_samples` samples."""

def encode_poses(numbers: Buffer) -> bytes:
    """The code of poses int64 [n, 7] in steps."""

def decode_poses(data: Buffer, count: int, quaternion_unit: int) -> bytes:
    """The inverse of `encode_poses`: int64 [count, 7]. `quaternion_unit` is the number of steps in 1."""

# -- the receiver: memory is a `touch_receiver` (c/touch_receiver.h) and what lies behind it, a writable
# buffer that is aligned to eight bytes. Functions of one tick or order take a microsecond and hold the GIL.
# An offset of a frame is in bytes from the start of the memory; what lies there is not checked.

Vector = tuple[float, float, float]

def tick(
    memory: Buffer, before: int, after: int, blend: float, x: float, y: float, z: float, dt_s: float
) -> Vector:
    """The force of a tick, newtons in the device's axes, for a device at x, y, z metres (`touch_tick`).

    `before` and `after` are the offsets of the frames around this time, 0 for none.
    """

def release(memory: Buffer, dt_s: float) -> Vector:
    """The next force on the way to zero, newtons (`touch_release`)."""

def cycle(memory: Buffer, x: float, y: float, z: float, now_ns: int) -> Vector:
    """The force at a time of the clock, newtons, with orders, media clock, log and counts
    (`touch_receiver_tick`); the torque is in ``state.torque.output``."""

def limited(memory: Buffer, x: float, y: float, z: float, dt_s: float) -> Vector:
    """The force that the limits allow where one is wanted, newtons (`touch_limit_output`)."""

def contact_force(
    memory: Buffer, before: int, after: int, blend: float, x: float, y: float, z: float
) -> Vector:
    """The force of the proxy on a hand at x, y, z metres, newtons, without friction, in one tick
    (`touch_contact_force`).
    """

def give_order(
    memory: Buffer, generation: int, start_s: float, speed: float, mode: int, is_stopping: int
) -> None:
    """Write an order of the player (`touch_give_order`)."""

def publish(memory: Buffer, generation: int, unrolled_frame: int, offset: int) -> None:
    """Show a frame that is written at an offset (`touch_publish`)."""

def unrolled_frame(media_s: float, rate_hz: float) -> int:
    """The frame at a media time, counted on in a loop (`touch_unrolled_frame`)."""

def receiver_layout() -> list[tuple[str, int]]:
    """Version of the receiver's memory, sizes of its structs and offsets of their members, bytes."""

def openhaptics_callback() -> tuple[int, int, int]:
    """Addresses of `touch_openhaptics_callback` and `touch_receiver_tick`; the size of a `touch_driver`."""

# -- settings of a receiver (c/touch_settings.h): `options` is a `layout.RENDER_OPTIONS`, `device` a
# `layout.DEVICE`; `cells` is the `touch_cells` of a field, of so many bricks

def choose_settings(
    memory: Buffer, options: Buffer, device: Buffer, friction: float, damping_n_s_per_m: float
) -> None:
    """Write settings, and the state before the first tick (`touch_choose_settings`).

    Friction and damping are those of the medium. Walls, and the stable damper and coupling, are not written.
    """

def choose_stability(
    options: Buffer, device: Buffer, damping_n_s_per_m: float, stiffest_n_per_m: float
) -> tuple[float, float, float, float]:
    """The damper in contact, N s/m, and the coupling, N/m, in the units of the field (`touch_stability_of`).

    Also returns the stiffness that is then rendered, and that of the device alone, N/m of the device.
    """

def stiffest_slope(cells: Buffer, bricks: int) -> float:
    """The largest slope of a force against its own direction, N/m (`touch_stiffest_n_per_m`)."""

def find_wall(
    bricks: Buffer,
    forces: Buffer,
    spacing_m: tuple[float, float, float],
    origin_m: tuple[float, float, float],
    cells: Buffer,
    cell_bricks: int,
) -> tuple[float, float, float]:
    """Stiffness, N/m, level, N, and a large force, N, of the wall in a field; zeros if there is none
    (`touch_find_wall`).

    Bricks int32 [n, 3] are ascending, forces float32 [n, 8, 8, 8, 3].
    """

def specified_wall(spec: Buffer) -> float:
    """The stiffness of walls in the specification of an encoder, UTF-8 JSON, N/m; 0 if it states no valid
    one (`touch_specified_wall` of c/touch_provenance.h)."""

# -- fields in bricks

def sample_field(index: Buffer, shape: Shape, keys: Buffer, forces: Buffer, out: Buffer) -> None:
    """Interpolate at positions float64 [m, 3], in samples: newtons, float32 [m, 3], to `out`.

    `keys` int64 [n] are those of the bricks, ascending, of `forces` float32 [n, 8, 8, 8, 3].
    """

def move_to_level(
    points_m: Buffer,
    shape: Shape,
    spacing_m: Vector,
    origin_m: Vector,
    keys: Buffer,
    forces: Buffer,
    level_n: float,
    max_move_m: float,
    rounds: int,
    is_met: Buffer,
) -> None:
    """Move points, float64 [m, 3], along the force to where it is `level_n`, by `max_move_m` at most a round.

    `is_met`, bool [m], is set for those within 2 % of it. `keys` and `forces` as in `sample_field`.
    """

def brick_keys(spans: Buffer, brick_shape: Shape, out: Buffer) -> None:
    """Write the keys of the bricks of each box to `out`, int64 [m], as far as it reaches.

    `spans` int64 [n, 3, 2] holds the start and stop of each box along each axis, in bricks.
    """

def raster_slots(bricks: Buffer, mask: Buffer, out: Buffer) -> None:
    """Write the indices of the set samples of `mask`, uint8 [n, 512], in raster order, to `out`, int64 [L].

    `bricks` are int32 [n, 3], ascending.
    """

# -- filters of fields in bricks

def limit_bricks(
    start: int,
    stop: int,
    forces: Buffer,
    force_max_n: float,
    floor_n: float,
    out: Buffer,
    has_force: Buffer,
) -> None:
    """Clip a range of bricks of forces, float32 [n, 512, 3], to a length, and drop forces below `floor_n`.

    `has_force`, bool [n], is set for bricks that have one left.
    """

def resample_bricks(
    start: int,
    stop: int,
    bricks: Buffer,
    source: tuple[Shape, Buffer, Buffer],
    weights: Sequence[tuple[Buffer, Buffer]],
    out: Buffer,
    has_force: Buffer,
) -> None:
    """Write a range of bricks, int32 [n, 3], of a field through a low-pass: float32 [n, 8, 8, 8, 3].

    `source` is shape, keys int64 [m], ascending, and forces float32 [m, 8, 8, 8, 3]; `weights` are first
    samples int64 [t] and weights float32 [t, taps] of each axis. `out` is initially zero; `has_force`, bool
    [n], is set for bricks that have one.
    """

# -- coder paper

def decode_huffman(
    data: Buffer,
    limits: Buffer,
    ranks: Buffer,
    order: Buffer,
    level_count: int,
    sent: Buffer,
    levels: Buffer,
) -> tuple[int, int]:
    """Read symbols until every sample of `sent`, bool [n], is decoded.

    Sent samples become True and their levels go to `levels`, uint16; runs leave `sent` unchanged. Zeros are
    read after the end of `data`. `limits`, `ranks` and `order` are `HuffmanCode.tables`. Returns the number
    of bits read and the number of levels; both are -1 for bits that are no code, more levels than `levels`
    can hold, or a run beyond the last sample.
    """

def adpcm(values: Buffer, residuals: Buffer, is_decoding: bool) -> None:
    """ADPCM of one component, int64 [n], in sixteenths of the finest step.

    Reads `values` and writes `residuals`, or the reverse if `is_decoding`; in both cases `values` becomes the
    decoded signal. Two weights adapt to the sign of the prediction error (as in G.726). The step increases
    after a residual of magnitude 2 or more and decreases after a residual of 0.
    """

# -- shapes

def ellipsoid_roots(scaled: Buffer, ratio: Vector, out: Buffer) -> None:
    """Solve sum (r_i z_i / (u + r_i - 1))^2 = 1 for u >= 0, float64 [n]; 0 if the sum is always below 1.

    `scaled` float64 [n, 3] are z_i = |p_i| / e_i; `ratio` is r_i = (e_i / e_min)^2.
    """

# -- the simulated hand: `times_s` float64 [n], ascending; `state` float64 [10]: time, position, velocity and
# force

def follow(times_s: Buffer, positions_m: Buffer, state: Buffer, dt_s: float) -> None:
    """Move a hand along a trajectory float64 [n, 3], whatever the force."""

def spring(
    times_s: Buffer,
    positions_m: Buffer,
    state: Buffer,
    mass_kg: float,
    stiffness_n_per_m: float,
    damping_n_s_per_m: float,
    dt_s: float,
) -> None:
    """Move a mass that a spring pulls and the force pushes: m a = k (target - x) - b v + F."""

def interpolate_orientation(times_s: Buffer, quaternions: Buffer, out: Buffer, time_s: float) -> None:
    """Write the orientation at a time to `out`, float64 [4]: along the shorter arc, of length 1."""

# -- queries of a field (c/touch_query.h): `memory`, `before` and `after` as above; `blend` is how far an
# instant lies between the two frames, 0 to 1

def force_at(
    memory: Buffer, before: int, after: int, blend: float, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """The force at a point, metres, in newtons; zero where the point is not finite. Holds the GIL."""

def vibration_at(
    memory: Buffer, before: int, after: int, blend: float, x: float, y: float, z: float
) -> tuple[float, float]:
    """The amplitude, newtons, and frequency, hertz, of the vibration at a point. Holds the GIL."""

def strongest_body(
    memory: Buffer, before: int, after: int, blend: float, x: float, y: float, z: float
) -> int:
    """The index of the body that pushes most at a point; -1 if there is none. Holds the GIL."""

def tool_force(
    memory: Buffer, before: int, after: int, blend: float, x: float, y: float, z: float
) -> tuple[float, float, float, float, float, float]:
    """Force, N, and torque, N m, on the receiver's tool with the device's point at a point. Holds the GIL."""

def forces_at(
    start: int,
    stop: int,
    memory: Buffer,
    before: int,
    after: int,
    points: Buffer,
    blends: Buffer,
    out: Buffer,
) -> None:
    """Write forces, float32 [n, 3], at the points of a range of float64 [n, 3]; `blends` are float64 [n] or
    [1]."""

def gradients_at(
    start: int,
    stop: int,
    memory: Buffer,
    before: int,
    after: int,
    points: Buffer,
    blends: Buffer,
    out: Buffer,
) -> None:
    """As `forces_at`, dF_i/dx_j, N/m, float64 [n, 3, 3]; zero where a point is not finite."""

def vibrations_at(
    start: int,
    stop: int,
    memory: Buffer,
    before: int,
    after: int,
    points: Buffer,
    blends: Buffer,
    out: Buffer,
) -> None:
    """As `forces_at`, amplitude, N, and frequency, Hz, float32 [n, 2]."""

def cell_forces(
    start: int,
    stop: int,
    memory: Buffer,
    cells: int,
    weight: float,
    is_first: bool,
    points: Buffer,
    out: Buffer,
) -> None:
    """Write `weight` times the forces of one field, float32 [n, 3], at the points of a range of float64 or
    float32 [n, 3]; unless `is_first`, add it. `cells` is the offset of the field."""

# -- cells (c/touch_cells.h)

def find_cells(
    bricks: Buffer, forces: Buffer, paired_bricks: Buffer | None, paired_forces: Buffer | None
) -> tuple[bytes, Shape, Shape, int]:
    """The bricks of cells that a field needs, or either of two fields.

    Returns the bricks, int32 [n, 3], ascending and counted from the corner of their box; that corner, as a
    brick of the field; the number of bricks of the box along x, y and z; and the bytes that the cells take.
    Bricks int32 [m, 3] are ascending, forces float32 [m, 8, 8, 8, 3].
    """

def start_cells(
    memory: Buffer,
    corner: Shape,
    box: Shape,
    cell_bricks: Buffer,
    spacing_m: tuple[float, float, float],
    origin_m: tuple[float, float, float],
) -> tuple[tuple[float, float, float], int, int, int, int]:
    """Write the header and the hash table of cells.

    Returns the position of the box, metres, 64 minus the bits of an index of the table, and the offsets of
    table, supports and samples.
    """

def fill_cells(
    start: int, stop: int, memory: Buffer, corner: Shape, cell_bricks: Buffer, bricks: Buffer, forces: Buffer
) -> None:
    """Write the samples and supports of a range of the bricks of cells."""

# -- a scene of objects at their poses (c/touch_placed.h)

Objects = tuple[Buffer, Buffer, Buffer, Buffer, Buffer, float, float]
"""Boxes int64 [n, 5], placements float64 [n, 33], tables int64 [m, 2], cells float32 [b, 9, 9, 9, 3] and
supports uint64 [b, 8] (`CellPool`); the force of an object that counts as none, and the limit of the sum,
newtons."""
Lattice = tuple[tuple[float, float, float], tuple[float, float, float], Shape]
"""Position of the first sample, spacing, metres, and shape."""

def place_objects(poses: Buffer, lattices: Buffer, motions: Buffer, out: Buffer) -> None:
    """Write the placements, float64 [n, 33], of objects.

    `poses` float64 [n, 7] are a unit quaternion, w first, and a position; `lattices` [n, 6] spacing and
    corner; `motions` [n, 6] velocity and angular velocity times surface damping.
    """

def placed_at_points(start: int, stop: int, points: Buffer, objects: Objects, out: Buffer) -> None:
    """Write the forces of objects, float32 [n, 3], at the points of a range of float64 [n, 3]."""

def find_reached(
    lattice: Lattice,
    objects: Objects,
    starts: Buffer,
    bricks: Buffer,
    stamps: Buffer,
    max_pairs: int,
    pairs: Buffer,
) -> int:
    """Find the bricks of a lattice that each object may reach, and write pairs of brick and object, int64 [m,
    2], objects ascending.

    Returns the number of pairs; -1 if there are more than `max_pairs`; -2 if there are more than `pairs` has.
    `bricks` int32 [b, 3] are those of the cells, `starts` int64 [n + 1] where those of an object start, and
    `stamps` a zero, int32, for each brick of the lattice.
    """

def fill_lattice(
    start: int,
    stop: int,
    bricks: Buffer,
    starts: Buffer,
    object_indices: Buffer,
    lattice: Lattice,
    objects: Objects,
    forces: Buffer,
    has_force: Buffer,
) -> None:
    """Write the forces of objects on a range of bricks of a lattice, int32 [n, 3], and whether each has one.

    Brick s gets the objects ``object_indices[starts[s]:starts[s + 1]]``. `forces`, float32 [n, 8, 8, 8, 3],
    is initially zero.
    """

def blend_weight(rate_hz: float, index: int, length: int, is_last: int) -> float:
    """The weight of frame `index` of a segment against the last frame of the segment before; 1: it is not
    blended (c/touch_segment_blend.h). `length` is that of the segment, `is_last` whether none follows."""

def blend_bricks(
    start: int,
    stop: int,
    slots: Buffer,
    before: Buffer,
    after: Buffer,
    weight: float,
    k: float,
    f0_n: float,
    out: Buffer,
    has_force: Buffer,
) -> None:
    """Write a range of blended bricks, float32 [n, 8, 8, 8, 3], and whether one has a force
    (c/touch_segment_blend.h).

    `slots` int64 [2, n] are indices in `before` and `after`, -1 for a brick that is missing.
    """

# -- the error bound of moving bodies

Rule = tuple[float, float, float, float]
"""k, F_0, the force of a body that counts as none, and the limit of the sum, newtons."""

def bound_cells(start: int, stop: int, source: Buffer, decoded: Buffer, rule: Rule, bounds: Buffer) -> None:
    """Write upper bounds of |error| / mask within each cell of a range of bricks, float32 [n, 512].

    `source` and `decoded` are cells, float32 [n, 9, 9, 9, 3]. The bound is infinite if F_0 is 0, the cell is
    not exact and the force may vanish within it. It allows for forces that count as none in one of the two
    fields only, and for the rounding of both to float32.
    """

def compare_frames(
    start: int,
    stop: int,
    bodies: tuple[Buffer, Buffer, Buffer, Buffer, Buffer, Buffer, Buffer, Buffer, Buffer, Buffer, Buffer],
    moves: tuple[Buffer, Buffer, Buffer, Buffer, Buffer],
    lattice: Lattice,
    rule: Rule,
    ratios: Buffer,
    voxels: Buffer,
) -> int:
    """Find the largest |error| / mask in a range of frames over the voxels of each body.

    `bodies`: lattices, boxes, starts, bricks, tables and supports as in `CellPool`, cells of the source and
    the decoded fields, their `bound_cells` and the largest of each brick, and marks, uint8 [n, 512], set to 1
    for cells that contribute to a voxel outside the bound ([0, 512] to mark nothing). `moves`: the columns of
    `error_bound.BlockMoves`; whether a body has not moved since the frame before, bool [frames, bodies]; and
    how many equal frames a frame stands for, int64 [frames]. Raises `ratios`, float64 [bodies], to larger
    ones, with frame and voxel in `voxels`, int64 [bodies, 4]. Returns the number of voxels in all frames
    whose error exceeds the mask.
    """
