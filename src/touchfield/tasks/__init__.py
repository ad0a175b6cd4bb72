"""The functions behind the commands that combine several steps, such as `edit`, `plan`, `live` and `play`.
Programs call them too."""

from typing import TYPE_CHECKING

from touchfield._lazy import lazy_attributes

if TYPE_CHECKING:
    from touchfield.tasks.measure import Measurement, MeasureSpec, measure_medium
    from touchfield.tasks.plan import Budget, PlanGrid, parse_budget
    from touchfield.tasks.play import PlaySpec

__all__ = ["Budget", "MeasureSpec", "Measurement", "PlanGrid", "PlaySpec", "measure_medium", "parse_budget"]

_MODULES = {
    "measure": ("MeasureSpec", "Measurement", "measure_medium"),
    "plan": ("Budget", "PlanGrid", "parse_budget"),
    "play": ("PlaySpec",),
}
__getattr__ = lazy_attributes(__name__, _MODULES)
