"""The words of `touchfield play`: its options as the job takes them, and what it shows."""

from __future__ import annotations

from dataclasses import fields
from typing import Any, Final

from touchfield.cli.options import Row
from touchfield.errors import InvalidArgument
from touchfield.job.tool import tool_of
from touchfield.render.spec import RenderSpec

__all__ = ["RENDER", "render_spec"]

RENDER: Final[tuple[Row, ...]] = (
    ("rate-hz", float, 1000.0, "Ticks of the servo a second."),
    ("friction", float | None, None, "mu; default: the stream's."),
    ("damping-n-s-per-m", float | None, None, "b everywhere; default: the stream's, and in contact what is stable."),
    ("coupling-n-per-m", float | None, None, "Stiffness of a virtual coupling; 0: none; default: what is stable."),
    ("passivity", bool, False, "Take out the energy that the loop makes (time-domain passivity control)."),
    ("scale", float, 1.0, "Metres of the field for one metre of the device."),
    ("clutch-mm", str | None, None, "Point of the field at the device's origin, X,Y,Z in millimetres."),
    ("force-scale", float, 1.0, "Newtons of the device for one of the field."),
    ("gravity-n", str | None, None, "A steady force for the weight of the handle, X,Y,Z in newtons."),
    ("peak-n", float | None, None, "Limit of |F|; default: the device's, which it cannot pass."),
    ("continuous-n", float | None, None, "Limit of |F| in the long run; default: the device's."),
    ("slew-n-per-s", float | None, None, "Limit of |dF/dt|; default: to the peak in 5 ms."),
    (
        "render",
        str,
        "auto",
        "proxy (thin walls hold), field (the stored force) or auto (the proxy where there are walls).",
    ),
    ("wall-n-per-m", float | None, None, "Stiffness of the proxy's spring; default: the field's own."),
    ("no-blend", bool, False, "Play every frame as it was decoded, with the steps where a segment starts."),
    (
        "tool",
        str,
        "point",
        "What the hand holds: point, sphere:RADIUS_M, or MESH.obj in metres; ,points=N behind it.",
    ),
    ("peak-nm", float | None, None, "Limit of the torque, N m; default: the device's, which it cannot pass."),
    ("continuous-nm", float | None, None, "Limit of the torque in the long run; default: the device's."),
    ("slew-nm-per-s", float | None, None, "Limit of its change; default: to the peak in 5 ms."),
    (
        "up",
        str,
        "auto",
        "What is up for the hand: x, y, z, -x, -y, -z; auto: as the stream says; lattice: y or -y, as it was laid.",
    ),
)


def render_spec(asked: dict[str, Any]) -> RenderSpec:
    """What was asked on the command line, as the renderer takes it."""
    given = {f.name: asked[f.name] for f in fields(RenderSpec) if asked.get(f.name) is not None}
    given["tool"] = tool_of(asked["tool"])
    if asked["clutch_mm"] is not None:
        given["clutch_m"] = tuple(v / 1000 for v in _triple("--clutch-mm", asked["clutch_mm"]))
    if asked["gravity_n"] is not None:
        given["gravity_n"] = _triple("--gravity-n", asked["gravity_n"])
    return RenderSpec(**given, blend=not asked["no_blend"])


def _triple(option: str, text: str) -> tuple[float, float, float]:
    try:
        x, y, z = (float(word) for word in text.split(","))
    except ValueError:
        raise InvalidArgument(option, repr(text), "three numbers, X,Y,Z") from None
    return x, y, z
