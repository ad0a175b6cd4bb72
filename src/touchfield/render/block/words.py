"""Places of all words of the block (`block.memory`), eight bytes each, and of a field and a frame within it.

==========  =====  =======================================================================================
CONTROL     i8     sizes and places of the rest, orders of the player (clock, seek, stop), signs of life
PARAMETERS  f8     what was asked of the renderer: `spec.RenderSpec`, the mapping, limits
STATE       f8     what one tick leaves for the next: last force, filters, energy, heat
WRENCH      f8     of a tool and a hand that turns: how it is turned, torque and its limits
COUNTS      i8     ticks, late ticks, underruns, and the histograms
==========  =====  =======================================================================================

Behind `FREE` lie the directory of frames, the log, the tool, the materials, and the arena in which frames are
written. Triples take three words each, x first. Every word has one writer. Plain numbers without compiled code, so
that who writes or reads them needs no compiler; the kernels take them as constants.
"""

from __future__ import annotations

from typing import Final

WORD: Final = 8

CONTROL: Final = 0
PARAMETERS: Final = 128
STATE: Final = 256
WRENCH: Final = 384
COUNTS: Final = 512
FREE: Final = 8192
"""The first word that no fixed place takes."""

# -- CONTROL: i8, but f8 where a name ends in _S or _HZ or is a speed -------------------------------------------
# set once, before the servo begins

DIRECTORY: Final = CONTROL + 1  # place of `DIRECTORY_WORDS` words for each of `SLOTS` frames
SLOTS: Final = CONTROL + 2
LOG: Final = CONTROL + 3  # place of the log ring: `ROW_WORDS` words for each of `LOG_ROWS` rows
LOG_ROWS: Final = CONTROL + 4
ARENA: Final = CONTROL + 5
FRAME_COUNT: Final = CONTROL + 7
FRAME_RATE_HZ: Final = CONTROL + 8
TICK_NS: Final = CONTROL + 10
IS_LOOP: Final = CONTROL + 11
RAMP_LIMIT_NS: Final = CONTROL + 12  # the longest that a force may need to go to zero
IS_SIMULATED: Final = CONTROL + 13  # time is the number of the tick over the rate, whatever the wall says
IS_PACED: Final = CONTROL + 14

# orders and signs of the player; the orders under a sequence number that is odd while they are written

SEQUENCE: Final = CONTROL + 24
GENERATION: Final = CONTROL + 25  # rises with each seek
START_S: Final = CONTROL + 26  # media time at which this generation begins
SPEED: Final = CONTROL + 27
MODE: Final = CONTROL + 28
STOP: Final = CONTROL + 29
HEARTBEAT_NS: Final = CONTROL + 32  # when the player was last seen alive; 0: nobody asks
FEED_FAILED: Final = CONTROL + 33
STOP_HERE: Final = CONTROL + 34  # the servo's own order to stop, as after a signal

# the servo, for its next tick and for the player

NEEDS: Final = CONTROL + 48  # generation and first unrolled frame that it may still read (`FRAME_BITS`)
FEED: Final = CONTROL + 49  # READY, WAITING, RUNNING, STALLED or ENDED
RESTING: Final = CONTROL + 50  # 1 if the latest force was zero
RELEASED: Final = CONTROL + 51  # 1 once a stop has brought the force to zero: nothing but zero follows
DEADLINE_NS: Final = CONTROL + 52
LOG_WRITTEN: Final = CONTROL + 53
MEDIA_S: Final = CONTROL + 54
SEQUENCE_SEEN: Final = CONTROL + 64
GENERATION_NOW: Final = CONTROL + 65
SPEED_NOW: Final = CONTROL + 66
MODE_NOW: Final = CONTROL + 67
STOP_NOW: Final = CONTROL + 68
ANCHOR_MEDIA_S: Final = CONTROL + 69
ANCHOR_CLOCK_S: Final = CONTROL + 70
CLOCK_S: Final = CONTROL + 71
USED: Final = CONTROL + 72  # generation and frame that was used last, for the latency

DIRECTORY_WORDS: Final = 4
"""Of one entry: generation and unrolled frame, place of the frame, when it was published, nothing."""

ROW_WORDS: Final = 30  # of one row of the log (`record.COLUMNS`)
FRAME_BITS: Final = 40
"""A generation stands above so many bits of an unrolled frame (which counts on where a medium is looped)."""

IDLE: Final = 0
PLAYING: Final = 1
PAUSED: Final = 2
"""Modes: no force yet; the media clock runs; it stands, and the field is felt as it is."""

READY: Final = 0
WAITING: Final = 1
RUNNING: Final = 2
STALLED: Final = 3
ENDED: Final = 4
"""States of the feed: about to run; waits for its first frames; runs; a frame did not come in time; it is over."""

SILENCE_NS: Final = 1_000_000_000
"""A player that was not seen for so long is taken for dead, and the force goes to zero."""

# -- PARAMETERS: written by `spec.write_parameters` -------------------------------------------------------------

RATE_HZ: Final = PARAMETERS
FRICTION: Final = PARAMETERS + 1  # mu
DAMPING: Final = PARAMETERS + 2  # b, N s/m
SLIP_SPEED: Final = PARAMETERS + 3
COUPLING: Final = PARAMETERS + 4  # K, N/m; 0: none
BRAKE: Final = PARAMETERS + 5  # of the damper in contact, N s/m
PASSIVITY: Final = PARAMETERS + 6  # 1: controlled, 0: observed only
SCALE: Final = PARAMETERS + 7
CLUTCH: Final = PARAMETERS + 8
FORCE_SCALE: Final = PARAMETERS + 11
GRAVITY: Final = PARAMETERS + 12
AXES: Final = PARAMETERS + 15  # nine words, row by row: what turns a vector of the device into one of the field
PEAK: Final = PARAMETERS + 24
CONTINUOUS: Final = PARAMETERS + 25  # 0: none
SLEW: Final = PARAMETERS + 26
THERMAL_S: Final = PARAMETERS + 27
RAMP_S: Final = PARAMETERS + 28
CUTOFF: Final = PARAMETERS + 29  # of the velocity, rad/s
DELAY: Final = PARAMETERS + 30  # ticks from putting out to acting on the hand; 0 to `MOST_DELAY`, perhaps a fraction
WALL: Final = PARAMETERS + 31  # stiffness of the walls that the proxy meets, N/m; 0: the field as it is
WALL_LEVEL: Final = PARAMETERS + 32  # force at which a surface lies, newtons
WALL_SPACING: Final = PARAMETERS + 33  # of the field's samples along x, y, z, metres
MATERIAL: Final = PARAMETERS + 36  # i8: the first word of the materials (`render.material`)
MATERIAL_COUNT: Final = PARAMETERS + 37  # i8: how many; 0: the field has none
PARAMETER_WORDS: Final = 38

MOST_DELAY: Final = 4.0

# -- STATE: left by `kernels.tick` ------------------------------------------------------------------------------

IS_STARTED: Final = STATE  # 1 once a position was seen
SINCE_S: Final = STATE + 1  # time since the latest position that could be used
DEVICE_POSITION: Final = STATE + 2  # that position, metres, the device's axes
POSITION: Final = STATE + 5  # the same in the field, metres
VELOCITY: Final = STATE + 8  # in the field, m/s
FIELD_FORCE: Final = STATE + 11  # what field or coupling gives to the hand, newtons, the field's axes
FRICTION_FORCE: Final = STATE + 14  # newtons, the field's axes, without damping
WANTED: Final = STATE + 17  # the force before gain and limits, newtons, the device's axes
FORCE: Final = STATE + 20  # the force handed out, newtons, the device's axes
GAIN: Final = STATE + 23  # 0 without frames, 1 with them, between on the way
HEAT: Final = STATE + 24  # of |F|^2, N^2
LIMIT: Final = STATE + 25  # of |F| at present, newtons
ENERGY: Final = STATE + 26  # what the hand put in and did not get back, joules, without the force of gravity
PHASE: Final = STATE + 27  # of the vibration, radians
IS_COUPLED: Final = STATE + 28  # 1 while the proxy has a place
PROXY: Final = STATE + 29  # its place in the field, metres
PROXY_STEP: Final = STATE + 32  # how far it went in the latest tick, metres
PROXY_PULL: Final = STATE + 35  # what pulled it there, newtons
PROXY_STIFFNESS: Final = STATE + 38  # what is added because the proxy went too far, N/m
PROXY_HAND: Final = STATE + 39  # where the hand was then, metres
BRAKE_NOW: Final = STATE + 42  # the damper in contact on its way to `BRAKE`, N s/m
SOFTNESS: Final = STATE + 43  # one by the coupling's stiffness on its way to `COUPLING`, m/N; 0: none
PAST_FORCES: Final = STATE + 44  # the force and the five before it, the latest first, without gravity, device's axes
IS_HELD: Final = STATE + 62  # 1 while the proxy is at a surface and not at the hand
PROXY_PART: Final = STATE + 63  # the part of the frame that carries it; -1: none
PROXY_LOCAL: Final = STATE + 64  # its place in the axes of that part, metres
FRICTION_NOW: Final = STATE + 67  # mu where the hand is; `FRICTION` but for materials
SLID: Final = STATE + 68  # metres that the hand slid since friction last gave way
STATE_WORDS: Final = 69

# -- WRENCH -----------------------------------------------------------------------------------------------------
# set once

TOOL: Final = WRENCH  # i8: the first word of the tool's numbers (`render.tool`)
TOOL_POINTS: Final = WRENCH + 1  # i8: how many; 0: the hand is a point
TOOL_SHARE: Final = WRENCH + 2  # what a point of the tool that faces its force adds of it
TOOL_REACH: Final = WRENCH + 3  # the farthest of its points from the device's, metres
HANDEDNESS: Final = WRENCH + 4  # 1 or -1, of `AXES`; a torque changes its sign where an axis is mirrored
TORQUE_PEAK: Final = WRENCH + 5  # newton metres; 0: the device shows none
TORQUE_CONTINUOUS: Final = WRENCH + 6  # 0: none
TORQUE_SLEW: Final = WRENCH + 7

# told by the device before each tick

ORIENTATION: Final = WRENCH + 12  # unit quaternion w, x, y, z: device's axes from the grip's
BUTTONS: Final = WRENCH + 16  # i8: bit n is button n
GRIPPER_M: Final = WRENCH + 17  # how far it is open

# left by `kernels.tick`

TURN: Final = WRENCH + 24  # nine words, row by row: what turns a vector of the tool into one of the field
FIELD_TORQUE: Final = WRENCH + 33  # of the field about the device's point, newton metres, the field's axes
WANTED_TORQUE: Final = WRENCH + 36  # the torque before gain and limits, newton metres, the device's axes
TORQUE: Final = WRENCH + 39  # the torque handed out, newton metres, the device's axes
TORQUE_HEAT: Final = WRENCH + 42
TORQUE_LIMIT: Final = WRENCH + 43
WRENCH_WORDS: Final = 44

# -- COUNTS: what the servo counts; times in bins of 1 us, the last of which holds all above --------------------

TICKS: Final = COUNTS
LATE: Final = COUNTS + 1  # ticks that began more than half a period late
MISSED: Final = COUNTS + 2  # periods in which no tick began
UNDERRUNS: Final = COUNTS + 3
STALLED_TICKS: Final = COUNTS + 4
WAITS: Final = COUNTS + 5
WAITING_TICKS: Final = COUNTS + 6
FIRST_NS: Final = COUNTS + 8
LAST_NS: Final = COUNTS + 9
WORST_PERIOD_NS: Final = COUNTS + 10
WORST_LATENESS_NS: Final = COUNTS + 11
LEAST_LATENCY_NS: Final = COUNTS + 12
FRAMES_USED: Final = COUNTS + 13
PLAYED_TICKS: Final = COUNTS + 14  # in which the medium was to be played

TIME_BINS: Final = 3000
PERIODS: Final = COUNTS + 64
LATENESSES: Final = PERIODS + TIME_BINS + 1
LATENCIES: Final = LATENESSES + TIME_BINS + 1
LATENCY_BINS: Final = 256
LATENCY_STEPS: Final = 8
"""Bins to a doubling of the latency, which reaches from microseconds to the seconds of a long look ahead."""

# -- a field: a header and, behind it, what `medium.cells` made of it. Its places count from its first word ------

FIELD_BOX: Final = 0  # 3 i8: bricks of cells along x, y, z; zero for a field without force
FIELD_SHIFT: Final = 3  # i8: 64 - bits of the hash table
FIELD_TABLE: Final = 4  # i8: where the table begins, int64 [2^bits, 2]: brick and slot
FIELD_HELD: Final = 5  # i8: where the bits of the cells that hold a force begin, uint64 [n, 8]
FIELD_CELLS: Final = 6  # i8: where the samples begin, float32 [n, 9, 9, 9, 3]
FIELD_INVERSE: Final = 8  # 3 f8: one by the spacing, 1/m
FIELD_CORNER: Final = 11  # 3 f8: corner of the box in the field's own frame, metres
FIELD_REACH: Final = 14  # f8: square of the distance from the origin within which all forces lie, m^2; -1: no force
FIELD_WORDS: Final = 16

# -- a material: one row of the table; frequencies and phases of the sines stand before the rows -----------------

MATERIAL_SINES: Final = 64  # first so many frequencies, rad/s, then as many phases, radians
MATERIAL_ROWS: Final = 2 * MATERIAL_SINES
MATERIAL_CREST: Final = 4.0  # so many times its rms a sum of sines hardly ever reaches

MATERIAL_FRICTION: Final = 0  # mu; not a number: that of the field
MATERIAL_STATIC: Final = 1  # mu just before it gives way
MATERIAL_SLIP: Final = 2  # metres that the hand slides until it does
MATERIAL_OBJECT: Final = 3  # i8: part of the frame; -1: any
MATERIAL_BOX: Final = 4  # six f8: least x, y, z and greatest, metres
MATERIAL_SPEEDS: Final = 10  # i8: how many, and behind it the word of the first
MATERIAL_FORCES: Final = 12  # i8: likewise
MATERIAL_LEVELS: Final = 14  # i8: word of the first level, newtons rms [speeds, forces, bands]
MATERIAL_WORDS: Final = 16

# -- a frame: a header and a row for each part; its places are words of the block --------------------------------

FRAME_PARTS: Final = 0  # i8: how many
FRAME_VIBRATION: Final = 1  # i8: place of the field of vibration, or 0
FRAME_LIMIT: Final = 2  # f8: of the sum, newtons
FRAME_FLOOR: Final = 3  # f8: the square of what counts as no force
FRAME_WARP: Final = 4  # i8: from here to the lattice of its deformation (`medium.deformation`), or 0
FRAME_WORDS: Final = 5

PART_FIELD: Final = 0  # i8: place of its field
PART_IS_IDENTITY: Final = 1  # i8: 1 if it is unturned
PART_QUATERNION: Final = 2
PART_POSITION: Final = 6
PART_MOTION: Final = 9  # six f8: what its own motion adds to the force
PART_MATRIX: Final = 15  # nine f8: the matrix of its rotation
PART_WORDS: Final = 24

# -- a deformation: a header, begun by how many control points along x, y and z; displacements behind it ---------

WARP_YIELD: Final = 3  # i8: word of the displacements by which it yields; 0: it does not
WARP_CORNER: Final = 4  # three f8: where its cells begin, metres
WARP_INVERSE: Final = 7  # three f8: 1 / spacing
WARP_COMPLIANCE: Final = 10  # f8: metres for a newton
WARP_RELAX: Final = 11  # f8: time constant, seconds
WARP_MOST: Final = 12  # f8: most that a control point yields along an axis, metres
WARP_WORDS: Final = 13

AT_A_FRAME: Final = 1e-9
"""Frames: an instant so near to a frame is that frame, whatever the rounding of its seconds says."""
