"""The entry of the coder `touch`."""

from __future__ import annotations

from typing import Any

from touchfield.codec.registry import Coder, CoderOption
from touchfield.codec.touch.spec import TouchSpec
from touchfield.errors import InvalidArgument

__all__ = ["CODER"]


def _spec(asked: dict[str, Any]) -> TouchSpec:
    """Spec of what is asked, with the mode that other options imply, and none that does nothing in it."""
    chosen = dict(asked)
    if chosen.pop("lossless_quantised", False):
        for key in ("mode", "k", "f0_n", "support"):
            if key in chosen:
                found = "it together with --lossless-quantised, which keeps every force as it is"
                raise InvalidArgument(_option(key), found, "one of both")
        chosen["mode"] = "lossless"
    if chosen.pop("target_nmse_db", None) is not None:
        chosen = {"mode": "nmse", **chosen}
    mode = chosen.get("mode", TouchSpec.mode)
    for key, only in (("direction_jnd_deg", "mask-direction"), ("step_n", "nmse")):
        if key in chosen and mode != only:
            raise InvalidArgument(
                _option(key), f"it in mode {mode}", f"it in mode {only} only", f"Add --mode {only}."
            )
    return TouchSpec(**chosen)


def _option(key: str) -> str:
    return "--" + key.replace("_", "-")


def _summary(spec: TouchSpec) -> dict[str, Any]:
    return {"mode": spec.mode, "effort": spec.effort, **({"step_n": spec.step_n} if spec.mode == "nmse" else {})}


CODER = Coder(
    name="touch",
    encoder="touchfield.codec.touch.encoder:TouchEncoder",
    decoder="touchfield.codec.touch.decoder:TouchDecoder",
    spec=TouchSpec,
    makers={"touch": _spec},
    options=(
        CoderOption("k", float, "Weber fraction of the promise. [default: 0.1]"),
        CoderOption("segment_frames", int, "frames a segment. [default: half a second, 8 to 64]"),
        CoderOption("f0_n", float, "F_0 of the promise, newtons. [default: 0.05]"),
        CoderOption("mode", str, "mask (|error| <= max(F_0, k |F|); default), mask-direction, or nmse."),
        CoderOption("direction_jnd_deg", float, "mask-direction: greatest angle, degrees. [default: 18.4]"),
        CoderOption("step_n", float, "mode nmse: step of the lattice, newtons. [default: 0.05]"),
        CoderOption("support", str, "movable (where |F| is at most F_0), or exact. [default: movable]"),
        CoderOption("effort", str, "fast, default or max: bytes against time. [default: default]"),
        CoderOption("lossless_quantised", bool, "keep a field that is quantised already exactly."),
        CoderOption("interframe", str, "auto, off or on. [default: auto]"),
    ),
    hints=("target_nmse_db",),
    summary=_summary,
    has_promise=True,
)
