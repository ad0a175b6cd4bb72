"""A hand that a plate of 2 mm holds, beside one that goes through: the proxy and the stored field in one picture."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.job import EncodeSpec, encode
from touchfield.job.play import PlaySpec, play
from touchfield.medium.atomic import atomic_path
from touchfield.render.spec import RenderSpec
from touchfield.viewer.page import titled_figure, write_png

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["press_a_plate"]

HALF_M: Final = (0.03, 0.02, 0.001)
ABOVE_M, BELOW_M = 0.006, -0.0024
PRESS_S, HOLD_S = 0.6, 0.6
_WAYS: Final = (("proxy", "held by the proxy", "tab:blue"), ("field", "the field as it is stored", "tab:red"))


def press_a_plate(stem: Path) -> dict[str, Any]:
    """Code a plate of 60 x 40 x 2 mm, press a simulated hand on it twice, and draw both.

    Parameters
    ----------
    stem : Path
        Of STEM.touch, STEM.csv (where the hand wants to be) and STEM.png.

    Returns
    -------
    dict
        ``proxy`` and ``field``: where the hand comes to rest, millimetres above the middle of the plate, and the
        force that holds it there, newtons.
    """
    from touchfield.sources.analytic_scene import AnalyticScene
    from touchfield.sources.shapes import Box

    stream, path = stem.with_suffix(".touch"), stem.with_suffix(".csv")
    encode(AnalyticScene((Box((0.0, 0.0, 0.0), HALF_M),)), stream, EncodeSpec(mapping="1"))
    with atomic_path(path) as temporary, temporary.open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(("t_s", "x_m", "y_m", "z_m"))
        rows.writerows([(0, 0, 0, ABOVE_M), (PRESS_S, 0, 0, BELOW_M), (PRESS_S + HOLD_S, 0, 0, BELOW_M)])
    logs = {}
    for way, _, _ in _WAYS:
        spec = PlaySpec(
            device="sim:spring", trajectory=path, offline=True, is_logged=True, render=RenderSpec(render=way)
        )
        log = play(stream, spec).rows
        assert log is not None  # of a point device there always is one
        logs[way] = log[log["time_s"] <= PRESS_S + HOLD_S - 0.05]
    _draw(stem.with_suffix(".png"), logs)
    return {
        way: {"hand_mm": 1e3 * float(log["position_m"][-1, 2]), "force_n": float(log["force_n"][-1, 2])}
        for way, log in logs.items()
    }


def _draw(path: Path, logs: dict[str, NDArray[Any]]) -> None:
    title = "A hand pressed into a plate of 2 mm: the proxy holds it, the stored field alone lets it through"
    figure = titled_figure("the picture of the plate", title, 9.0, 4.2)
    height, force = figure.subplots(1, 2)
    thickness_mm = 2e3 * HALF_M[2]
    height.axhspan(-thickness_mm / 2, thickness_mm / 2, color="0.8", label=f"a plate of {thickness_mm:g} mm")
    times = np.array([0.0, PRESS_S, PRESS_S + HOLD_S])
    height.plot(times, 1e3 * np.array([ABOVE_M, BELOW_M, BELOW_M]), "k:", label="where the hand wants to be")
    for way, words, colour in _WAYS:
        log = logs[way]
        height.plot(log["time_s"], 1e3 * log["position_m"][:, 2], color=colour, label=words)
        force.plot(log["time_s"], log["force_n"][:, 2], color=colour, label=words)
    height.set(xlabel="seconds", ylabel="hand, mm above the middle of the plate")
    force.set(xlabel="seconds", ylabel="force on the hand, upwards, N")
    height.legend(fontsize="small")
    write_png(figure, path)
