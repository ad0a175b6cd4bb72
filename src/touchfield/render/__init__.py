"""Rendering: the receiver's half of the paper (section 3.2, figure 4's last box), a thousand times a second
or more.

    file -> segments -> decoder -> frames -> `feeder` -> shared memory | -> `cycle` -> limits -> device
                        (the player's process)                         |    (the servo's process)

`memory` is what both processes see, `sampler` the force at a point, `kernels.tick` effects and limits,
`servo` the loop, `player` the one that a program holds on to. docs/decisions/0010 tells why it is cut so.
"""

from touchfield._lazy import lazy_attributes

__getattr__ = lazy_attributes(__name__)
