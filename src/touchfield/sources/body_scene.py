"""Bodies in motion as a scene: each a scene in its own frame, with a pose track (paper section 5.1, Scene 1)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.medium import ForceField
from touchfield.sources.scene import UP_Z_AXES, Body, Scene

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.medium import Grid
    from touchfield.sources.profile import ForceProfile

__all__ = ["BodyScene"]


class BodyScene(Scene):
    """Bodies in motion; where they overlap their forces are added (the device filter clips the sum to F_max).

    Parameters
    ----------
    bodies : sequence of Body
        One or more; their tracks have one length.
    rate_hz : float
    axes : str
    notes : tuple of str
    """

    def __init__(
        self, bodies: Sequence[Body], rate_hz: float, axes: str = UP_Z_AXES, notes: tuple[str, ...] = ()
    ) -> None:
        if not bodies:
            raise InvalidArgument("bodies", "none", "at least one")
        self._bodies = tuple(bodies)
        self.frame_count, self.rate_hz = len(bodies[0].track), float(rate_hz)
        self.axes, self.notes = axes, notes

    def bodies(self) -> tuple[Body, ...]:
        """See `Scene.bodies`."""
        return self._bodies

    def bounds_m(self) -> NDArray[np.float64]:
        """The box that holds the box of every body in every frame, metres, float64 [2, 3]."""
        raise NotImplementedError

    def field(self, frame: int, grid: Grid, profile: ForceProfile) -> ForceField:
        """The sum of the fields of all bodies at the points of `grid`, each in its place."""
        raise NotImplementedError
