"""Places of the words in `memory.CONTROL`: sizes, orders of the player, signs of the servo.

Every word has one writer. *set*: written once before the servo begins; *player*: orders and signs of the user's
process; *servo*: what `kernels.cycle` keeps for its next tick, some of which the player reads. A name that ends in
``_S`` or ``_HZ`` or is a speed is a float64, every other an int64.
"""

from __future__ import annotations

from typing import Final

from touchfield.render.memory import CONTROL

# set ---------------------------------------------------------------------------------------------------------
DIRECTORY: Final = CONTROL + 1
"""Place of the directory of frames: `DIRECTORY_WORDS` words for each of `SLOTS` frames."""
SLOTS: Final = CONTROL + 2
LOG: Final = CONTROL + 3
"""Place of the log ring: `log.ROW_WORDS` words for each of `LOG_ROWS` rows."""
LOG_ROWS: Final = CONTROL + 4
ARENA: Final = CONTROL + 5
ARENA_WORDS: Final = CONTROL + 6
FRAME_COUNT: Final = CONTROL + 7
FRAME_RATE_HZ: Final = CONTROL + 8
RATE_HZ: Final = CONTROL + 9
TICK_NS: Final = CONTROL + 10
IS_LOOP: Final = CONTROL + 11
RAMP_LIMIT_NS: Final = CONTROL + 12
"""The longest that a force may need to go to zero."""
IS_SIMULATED: Final = CONTROL + 13
"""Time is the number of the tick over the rate, whatever the wall says."""
IS_PACED: Final = CONTROL + 14

# player: orders, under a sequence number that is odd while they are written ----------------------------------
SEQUENCE: Final = CONTROL + 24
GENERATION: Final = CONTROL + 25
"""Rises with each seek."""
START_S: Final = CONTROL + 26
"""Media time at which this generation begins."""
SPEED: Final = CONTROL + 27
MODE: Final = CONTROL + 28
STOP: Final = CONTROL + 29
HEARTBEAT_NS: Final = CONTROL + 32
"""When the player was last seen alive; 0: nobody asks."""
FEED_FAILED: Final = CONTROL + 33
STOP_HERE: Final = CONTROL + 34
"""The servo's own order to stop, as after a signal."""

# servo -------------------------------------------------------------------------------------------------------
NEEDS: Final = CONTROL + 48
"""Generation and first unrolled frame that it may still read (`FRAME_BITS`)."""
FEED: Final = CONTROL + 49
"""READY, WAITING, RUNNING, STALLED or ENDED."""
RESTING: Final = CONTROL + 50
"""Whether the latest force was zero."""
RELEASED: Final = CONTROL + 51
"""Whether a stop has brought the force to zero: nothing but zero follows."""
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
USED: Final = CONTROL + 72
"""Generation and frame that was used last, for the latency."""

DIRECTORY_WORDS: Final = 4
"""Of one entry: generation and unrolled frame, place of the frame, when it was published, nothing."""

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
