"""Files in the layouts of public sets of textures and contacts, made from formulas."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.io import savemat

import scene_makers as scenes

Float64s = NDArray[np.float64]

AR = (1.0, -1.2, 0.72)
MA = (1.0, 0.5)
GAIN = 3.0
CORNERS = ((0.0, 0.0), (200.0, 0.0), (0.0, 4.0), (200.0, 4.0), (100.0, 2.0))
"""Speeds, mm/s, and forces, newtons, of models whose variance rises with both."""


def variance(speed_mm_s: float, force_n: float) -> float:
    return 1e-6 * speed_mm_s * force_n


def write_models(path: Path, *, has_ma: bool = True, **changed: str) -> Path:
    """Write texture models of the Penn Haptic Texture Toolkit; `changed` are texts of elements."""
    values = {
        "material": "Made Oak", "AccelUnits": "m/s^2", "SpeedUnits": "mm/s", "ForceUnits": "N",
        "SampleRate": "1000", "mu": "0.25", "numMod": str(len(CORNERS)), **changed,
    }  # fmt: skip
    lines = [f"<{name}>{text}</{name}>" for name, text in values.items() if name != "model"]
    for speed, force in CORNERS:
        ar = "".join(f"<value>{value}</value>" for value in AR)
        ma = "".join(f"<value>{value}</value>" for value in MA)
        extra = f"<MAcoeff>{ma}</MAcoeff><gain>{GAIN}</gain>" if has_ma else ""
        lines.append(
            f"<model><ARcoeff>{ar}</ARcoeff>{extra}<var>{variance(speed, force)}</var>"
            f"<speedMod>{speed}</speedMod><forceMod>{force}</forceMod></model>"
        )
    text = '<?xml version="1.0" encoding="utf-8"?>\n<modelSet texture="0">\n' + "\n".join(lines)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text + "\n</modelSet>\n")
    return path


def write_table(path: Path, head: str, rows: Float64s) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = [",".join(f"{value:.9g}" for value in row) for row in rows]
    path.write_text(head + "\n" + "\n".join(lines) + "\n")
    return path


def write_slide(
    folder: Path, texture: int = 3, direction: int = 0, speed: int = 40, force: int = 1000, repeat: int = 0
) -> str:
    """Write force/, position/ and accel/ of one slide of the Cluster dataset; return the file name.

    The finger slides 36 mm through the middle of the surface; it presses with the force of the name, and
    shakes with 0.02 g times its speed over 20 mm/s, at 1 g along -z.
    """
    rng = np.random.default_rng([texture, direction, speed, force, repeat])
    name = f"{texture}_{direction}_{speed}_{force}_{repeat}.csv"
    seconds = 36 / speed
    times = 1e-3 + np.arange(0, seconds, 1 / 6000)
    times += rng.uniform(0, 4e-5, len(times))
    along = np.arange(0, seconds, 0.01)
    turned = np.deg2rad(direction)
    path_mm = 50 + (speed * along - 18)[:, None] * [np.sin(turned), np.cos(turned)]
    write_table(folder / "position" / name, "time,X,Y", np.c_[along, path_mm])
    write_table(folder / "force" / name, "time,force", np.c_[times, np.full(len(times), 1e-3 * force)])
    shaken_g = 0.02 * speed / 20 * rng.normal(size=(len(times), 3)) + [0, 0, -1]
    write_table(folder / "accel" / name, "time,X,Y,Z", np.c_[times, shaken_g])
    return name


def write_mat(path: Path, recordings: list[dict[str, Any]], name: str = "symbol_data") -> Path:
    """Write recordings as a MATLAB array of structures, compressed."""
    fields = list(recordings[0])
    rows = np.empty((1, len(recordings)), [(field, object) for field in fields])
    for n, recording in enumerate(recordings):
        for field in fields:
            rows[0, n][field] = recording[field]
    savemat(path, {name: rows, "remark": "made"}, do_compression=True)
    return path


def write_slides(folder: Path) -> Path:
    """Write two slides of one texture of the Cluster dataset in its folders."""
    for direction in (0, 90):
        write_slide(folder / "sensor_data", direction=direction)
    return folder


def slid() -> tuple[Float64s, Float64s]:
    """Return positions, metres, and forces, newtons, of `write_slides`."""
    along = np.linspace(-0.017, 0.017, 30)
    points = np.zeros((60, 3))
    points[:30, 1] = points[30:, 0] = along
    points[:, :2] += 0.05
    return points, np.tile([0.0, 0.0, 1.0], (60, 1))


def write_spring_mat(folder: Path) -> Path:
    """Write the contacts of `scene_makers.probed` as a MATLAB file."""
    positions_m, forces_n = scenes.probed()
    folder.mkdir(parents=True, exist_ok=True)
    return write_mat(folder / "symbol_data.mat", [{"pos": positions_m.T, "F": forces_n.T}])
