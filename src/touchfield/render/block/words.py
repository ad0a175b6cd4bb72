"""Defines where each number lies in the block, the memory that player and servo share: a *word* is eight
bytes, and each constant here is the index of one.

==========  =====  =======================================================================================
CONTROL     i8     sizes and places of the rest, orders of the player (clock, seek, stop), signs of life
PARAMETERS  f8     what was asked of the renderer: `spec.RenderSpec`, the mapping, limits
STATE       f8     what one tick leaves for the next: last force, filters, energy, heat
WRENCH      f8     of a tool and a hand that turns: how it is turned, torque and its limits
COUNTS      i8     ticks, late ticks, underruns, and the histograms
==========  =====  =======================================================================================

Behind `FREE` lie the directory of frames, the log, the tool, the materials, and the arena in which frames are
written. Every word has one writer. Plain numbers, which need no compiler; the kernels take them as constants.
"""

from __future__ import annotations

from itertools import accumulate
from typing import Final


def _rows(begin: int, *sizes: int) -> tuple[int, ...]:
    """First words of rows of these sizes, one behind the other from `begin` on."""
    return tuple(accumulate(sizes[:-1], initial=begin))


WORD: Final = 8
CONTROL, PARAMETERS, STATE, WRENCH, COUNTS = 0, 128, 256, 384, 512
FREE: Final = 8192  # the first word that no fixed place takes

# -- CONTROL: i8, but f8 where a name ends in _S or _HZ or is a speed
# Set once: places of the directory (`SLOTS` entries) and of the log (`LOG_ROWS` rows); RAMP_LIMIT_NS is the
# longest that a force may need to go to zero; where IS_SIMULATED, time is the number of the tick over the
# rate.

DIRECTORY, SLOTS, LOG, LOG_ROWS, ARENA, FRAME_COUNT, FRAME_RATE_HZ = range(1, 8)
TICK_NS, IS_LOOP, RAMP_LIMIT_NS, IS_SIMULATED, IS_PACED = range(10, 15)

# Of the player, the first six under a sequence number that is odd while they are written: a generation, which
# rises with each seek, and the media time where it begins; HEARTBEAT_NS: when it was last seen alive, 0:
# nobody asks; STOP_HERE is the servo's own order to stop, as after a signal.

SEQUENCE, GENERATION, START_S, SPEED, MODE, STOP = range(24, 30)
HEARTBEAT_NS, FEED_FAILED, STOP_HERE = range(32, 35)

# Of the servo: generation and first unrolled frame that it may still read; state of the feed; 1 if the latest
# force was zero; 1 once a stop has brought it to zero, and nothing but zero follows. USED is what NEEDS was
# at the last use.

NEEDS, FEED, RESTING, RELEASED, DEADLINE_NS, LOG_WRITTEN, MEDIA_S = range(48, 55)
SEQUENCE_SEEN, GENERATION_NOW, SPEED_NOW, MODE_NOW, STOP_NOW = range(64, 69)
ANCHOR_MEDIA_S, ANCHOR_CLOCK_S, CLOCK_S, USED = range(69, 73)

DIRECTORY_WORDS: Final = 2  # of one entry: generation and unrolled frame, place of the frame
ROW_WORDS: Final = 30  # of one row of the log (`block.COLUMNS`)
FRAME_BITS: Final = (
    40  # a generation stands above so many bits of an unrolled frame, which counts on in a loop
)

IDLE, PLAYING, PAUSED = range(3)
"""Modes: no force yet; the media clock runs; it stands, and the field is felt as it is."""

READY, WAITING, RUNNING, STALLED, ENDED = range(5)
"""States of the feed: about to run; waits for its first frames; runs; a frame did not come in time; it is
over.
"""

SILENCE_NS: Final = (
    1_000_000_000  # a player not seen for so long is taken for dead, and the force goes to zero
)

# -- PARAMETERS: mu; b, N s/m; K, N/m, 0: none; BRAKE, of the damper in contact, N s/m; AXES, row by row,
# turns a vector of the device into one of the field; CONTINUOUS, 0: none; CUTOFF of the velocity, rad/s;
# DELAY, ticks from putting out to acting on the hand, perhaps a fraction; WALL, N/m of the proxy's walls, 0:
# the field as it is, their level in newtons and the spacing of the samples, metres; MATERIAL, i8: the first
# word of the materials, and how many there are

(
    RATE_HZ, FRICTION, DAMPING, SLIP_SPEED, COUPLING, BRAKE, PASSIVITY, SCALE, CLUTCH, FORCE_SCALE, GRAVITY, AXES,
    PEAK, CONTINUOUS, SLEW, THERMAL_S, RAMP_S, CUTOFF, DELAY, WALL, WALL_LEVEL, WALL_SPACING, MATERIAL,
    MATERIAL_COUNT,
) = _rows(PARAMETERS, 1, 1, 1, 1, 1, 1, 1, 1, 3, 1, 3, 9, 1, 1, 1, 1, 1, 1, 1, 1, 1, 3, 1, 1)  # fmt: skip
PARAMETER_WORDS, MOST_DELAY = 38, 4.0

# -- STATE: left by `kernels.tick`. Places in metres, of the device in its own axes; FORCE is what was handed
# out and WANTED the force before gain and limits, both in the device's axes, field and friction in the
# field's; HEAT is of |F|^2, LIMIT of |F| at present; ENERGY is what the hand put in and did not get back;
# PAST_FORCES the force and the five before it, the latest first, without gravity. The proxy: its place, the
# part of the frame that carries it and its place there, PROXY_REACH of its steps; of the coupling its latest
# step, what pulled it, what stiffness is added as it went too far, where the hand was. BRAKE_NOW and SOFTNESS
# (1 / K) are on their way to BRAKE and COUPLING; SLID: metres since friction last gave way

(
    IS_STARTED, SINCE_S, DEVICE_POSITION, POSITION, VELOCITY, FIELD_FORCE, FRICTION_FORCE, WANTED, FORCE, GAIN, HEAT,
    LIMIT, ENERGY, PHASE, IS_COUPLED, PROXY, PROXY_STEP, PROXY_PULL, PROXY_STIFFNESS, PROXY_HAND, BRAKE_NOW, SOFTNESS,
    PAST_FORCES, IS_HELD, PROXY_PART, PROXY_LOCAL, FRICTION_NOW, SLID, PROXY_REACH, _STATE_END,
) = _rows(STATE, 1, 1, *(3,) * 7, 1, 1, 1, 1, 1, 1, 3, 3, 3, 1, 3, 1, 1, 18, 1, 1, 3, 1, 1, 1, 0)  # fmt: skip
STATE_WORDS = _STATE_END - STATE

# -- WRENCH: set once, i8: the first word of the tool's numbers (`render.tool`) and how many points, 0: the
# hand is a point; what a point that faces its force adds of it, and the farthest, metres; HANDEDNESS of AXES,
# 1 or -1; limits, 0: none. Told by the device: unit quaternion w, x, y, z, its axes from the grip's; i8, bit
# n is button n; metres. Left by `kernels.tick`: TURN turns a vector of the tool into one of the field;
# torques as the forces above

TOOL, TOOL_POINTS, TOOL_SHARE, TOOL_REACH, HANDEDNESS, TORQUE_PEAK, TORQUE_CONTINUOUS, TORQUE_SLEW = range(
    384, 392
)
ORIENTATION, BUTTONS, GRIPPER_M = _rows(WRENCH + 12, 4, 1, 1)
TURN, FIELD_TORQUE, WANTED_TORQUE, TORQUE, TORQUE_HEAT, TORQUE_LIMIT = _rows(WRENCH + 24, 9, 3, 3, 3, 1, 1)
WRENCH_WORDS: Final = 44

# -- COUNTS: LATE by more than half a period, MISSED periods without a tick; PLAYED_TICKS: in which the medium
# was to be played. Histograms of times in bins of 1 us, the last of which holds all above

TICKS, LATE, MISSED, UNDERRUNS, STALLED_TICKS, WAITS, WAITING_TICKS, FIRST_NS, LAST_NS = range(512, 521)
WORST_PERIOD_NS, WORST_LATENESS_NS, FRAMES_USED, PLAYED_TICKS = range(521, 525)
TIME_BINS: Final = 3000
PERIODS, LATENESSES = _rows(COUNTS + 64, TIME_BINS + 1, TIME_BINS + 1)

# -- a field: a header and, behind it, what `medium.cells` made of it; its places count from its first word.
# i8: bricks of cells along x, y, z, zero for a field without force; 64 - bits of the hash table; where table
# (int64 [2^bits, 2], brick and slot), bits of the cells that hold a force (uint64 [n, 8]) and samples
# (float32 [n, 9, 9, 9, 3]) begin. f8: 1 / spacing; corner of the box in its own frame; square of the way from
# the origin within which all forces lie, or -1

FIELD_BOX, FIELD_SHIFT, FIELD_TABLE, FIELD_HELD, FIELD_CELLS = _rows(0, 3, 1, 1, 1, 1)
FIELD_INVERSE, FIELD_CORNER, FIELD_REACH = _rows(8, 3, 3, 1)
FIELD_WORDS: Final = 16

# -- materials: frequencies, rad/s, and phases of the sines; then a row for each: mu (not a number: that of
# the field), mu just before it gives way, metres of a slip; part of the frame, -1: any; least x, y, z and
# greatest; i8: how many speeds and the word of the first, forces likewise; the word of the first level,
# newtons rms [speeds, forces, bands]

MATERIAL_SINES: Final = 64
MATERIAL_ROWS = 2 * MATERIAL_SINES
MATERIAL_CREST: Final = 4.0  # so many times its rms a sum of sines hardly ever reaches
MATERIAL_FRICTION, MATERIAL_STATIC, MATERIAL_SLIP, MATERIAL_OBJECT, MATERIAL_BOX = range(5)
MATERIAL_SPEEDS, MATERIAL_FORCES, MATERIAL_LEVELS, MATERIAL_WORDS = range(10, 18, 2)

# -- a frame: i8: how many parts, place of the field of vibration or 0; f8: limit of the sum, newtons, and the
# square of what counts as no force; i8: from here to the lattice of its deformation, or 0. Then a row for
# each part: place of its field; 1 if it is unturned; quaternion, position, what its own motion adds to the
# force (six), matrix of its rotation

FRAME_PARTS, FRAME_VIBRATION, FRAME_LIMIT, FRAME_FLOOR, FRAME_WARP, FRAME_WORDS = range(6)
PART_FIELD, PART_IS_IDENTITY, PART_QUATERNION, PART_POSITION, PART_MOTION, PART_MATRIX, PART_WORDS = _rows(
    0, 1, 1, 4, 3, 6, 9, 0
)

# -- a deformation: how many control points along x, y and z; word of the displacements by which it yields, 0:
# it does not; where its cells begin, 1 / spacing; metres for a newton, time constant, the most that a point
# yields; displacements

WARP_YIELD, WARP_CORNER, WARP_INVERSE, WARP_COMPLIANCE, WARP_RELAX, WARP_MOST = _rows(3, 1, 3, 3, 1, 1, 1)
WARP_WORDS: Final = 13

AT_A_FRAME: Final = (
    1e-9  # frames: an instant so near to one is that frame, whatever the rounding of its seconds says
)
