"""Guidance from a depth camera: the nearest surfaces around a wearer by direction, steps and holes in the
ground ahead, and the patterns of an array of actuators that show them.

It is no mobility aid and replaces no cane: a depth camera does not see glass, mirrors, dark or wet surfaces,
anything outside its picture, or anything nearer than its shortest range.

The chain is depth picture -> `view` (points) -> `ground` (plane, and the wearer's frame) -> `directions`
(nearest surface), `steps` (ground ahead), `memory` and `movers` (what left the picture), `lost` (the same
without poses) -> `contact` (time to contact) -> `guide` (the situation of a frame) -> `pattern` (drives of
the actuators).
"""

from typing import TYPE_CHECKING

from touchfield._lazy import lazy_attributes

if TYPE_CHECKING:
    from touchfield.guidance.guide import Guide, Situation
    from touchfield.guidance.pattern import Patterns
    from touchfield.guidance.spec import GuideSpec

__all__ = ["Guide", "GuideSpec", "Patterns", "Situation"]

_MODULES = {"guide": ("Guide", "Situation"), "pattern": ("Patterns",), "spec": ("GuideSpec",)}
__getattr__ = lazy_attributes(__name__, _MODULES)
