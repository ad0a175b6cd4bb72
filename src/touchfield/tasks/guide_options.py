"""Options of command `guide`. They are apart from the task, which needs the compiled kernels of sources: the
help lists them without."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from touchfield.errors import require_between, require_kinds, require_up_to
from touchfield.guidance.spec import GuideSpec
from touchfield.options import duration_s, option
from touchfield.render.readiness import MAX_WAIT_S

_MAX_SECONDS: Final = 24 * 3600.0


@dataclass(frozen=True)
class GuideRun:
    """Options of a run; raises `InvalidArgument` if a number is out of range.

    `device` is a driver of an array, or the name of a profile, which takes the driver of that profile. With
    `offline`, each frame of a recorded sequence is evaluated without a clock, and no device is opened.
    """

    device: str = option("tactsuit-x40", "tactsuit-x40, bhaptics[:HOST:PORT], osc:HOST:PORT.")
    profile: str | None = option(None, "Profile with the actuators; default: the device's own.")
    wait: str = option("30s", "How long to wait until the device is ready, such as 30s or 2min.")
    seconds: float | None = option(None, "How long; default: to the end of the source.")
    offline: bool = option(False, "Folders: each frame as fast as the machine runs, without a device.")
    guide: GuideSpec = field(default_factory=GuideSpec)

    def __post_init__(self) -> None:
        require_kinds(self)
        require_between(0, MAX_WAIT_S, wait=duration_s(self.wait, "wait"))
        if self.seconds is not None:
            require_up_to(_MAX_SECONDS, seconds=self.seconds)
