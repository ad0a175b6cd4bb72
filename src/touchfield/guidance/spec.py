"""Options of the guidance: distances, times and the place of the camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from touchfield.errors import require_between, require_kinds
from touchfield.options import option

SIDES: Final = ("left", "right")


@dataclass(frozen=True)
class GuideSpec:
    """Options of the guidance; raises `InvalidArgument` if a value is out of range.

    Distances are horizontal, from the camera. Without `camera_height_m` the ground is searched at any height
    of a camera that a person wears.
    """

    warn_m: float = option(2.0, "Surfaces nearer than this are shown, metres.")
    contact_s: float = option(4.0, "Time to contact below which the drive rises above the weakest, seconds.")
    step_m: float = option(0.08, "Least height of a step and depth of a hole that are shown, metres.")
    head_m: float = option(2.0, "Height up to which surfaces are in the way, metres.")
    camera_height_m: float | None = option(
        None, "Height of the camera above the ground; default: as it is found, from 0.4 to 2.3 m."
    )
    pitch_deg: float = option(0.0, "How far the camera looks down when the wearer stands, degrees.")
    timeout_s: float = option(0.2, "Without a new frame for this long the warning pattern is shown, seconds.")
    memory_s: float = option(10.0, "How long what left the picture is remembered, if there are poses.")
    first_column: str = option("left", "Side of the wearer at column 0 of the front panel: left or right.")

    def __post_init__(self) -> None:
        require_kinds(self, first_column=SIDES)
        require_between(0.5, 3.5, warn_m=self.warn_m)  # the box of the memory reaches 3.8 m
        require_between(0.5, 30.0, contact_s=self.contact_s)
        require_between(0.04, 0.5, step_m=self.step_m)
        require_between(0.5, 3.0, head_m=self.head_m)
        require_between(-30.0, 80.0, pitch_deg=self.pitch_deg)
        require_between(0.05, 2.0, timeout_s=self.timeout_s)
        require_between(0.0, 60.0, memory_s=self.memory_s)
        if self.camera_height_m is not None:
            require_between(0.4, 2.3, camera_height_m=self.camera_height_m)
