"""Plays a medium on a device: decodes frames ahead and computes the force on the hand a thousand times a
second (the receiver of the paper, section 3.2 and end of figure 4).

    file -> segments -> decoder -> frames -> `feeder` -> shared memory | -> tick -> limits -> device
                        (the player's process)                         |    (the servo's process)

The loop runs at 1 kHz or more. `block` is the memory that both processes share, `sampler` computes the force
at a point, the tick (``c/touch_render.h``) applies effects and limits, `servo` runs the loop, and `player` is
the object that a program uses; `ticked_player` is for programs with a loop of their own. docs/decisions/0010
gives the reasons for two processes.
"""

from touchfield._lazy import lazy_attributes

__getattr__ = lazy_attributes(__name__)
