"""An example for every engine: a plate of 2 mm, and a hand that presses on it.

    python integrations/plate.py FOLDER     # writes plate.touch and press.txt

`press.txt` has a line `x y z`, metres, for each tick of 1 ms. The hand comes from above and rests on the
underside of the plate, where the stored force alone is zero; with a proxy the force points up.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import touchfield as tf
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Box


def make_plate(path: Path) -> Path:
    """Write a plate of 60 x 40 x 2 mm."""
    tf.encode(AnalyticScene((Box((0, 0, 0), (0.03, 0.02, 0.001)),)), path, tf.EncodeSpec(nw=7, mapping="1"))
    return path


def press_plate(count: int = 1000) -> NDArray[np.float64]:
    """A hand that goes from 5 mm above that plate to 2 mm below its surface and rests, float64 [count, 3]."""
    height_m = np.interp(np.arange(count), [0, 300, count], [0.006, -0.001, -0.001])
    return np.stack([np.full(count, 0.004), np.full(count, 0.003), height_m], axis=1)


def main() -> None:
    """Write both files into the folder that the command line names."""
    if len(sys.argv) != 2:
        raise SystemExit("python integrations/plate.py FOLDER")
    folder = Path(sys.argv[1])
    make_plate(folder / "plate.touch")
    lines = (f"{x!r} {y!r} {z!r}\n" for x, y, z in press_plate().tolist())
    (folder / "press.txt").write_text("".join(lines))


if __name__ == "__main__":
    main()
