"""The picture of `bench_fusion`: a frame alone beside the fused world, first contact and a slice of forces."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from touchfield.measure import contact_along_axis
from touchfield.medium import ForceField


def draw(path: Path, title: str, fields: dict[str, ForceField]) -> None:
    """Write a PNG, a column for each field of one grid; rows: depth of the first contact along z, |F| of a slice."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    grid = next(iter(fields.values())).grid
    sizes = {name: np.linalg.norm(field.to_dense(), axis=-1) for name, field in fields.items()}
    middle = int(np.argmax(np.prod([(size > 0).sum(axis=(0, 2), dtype=float) for size in sizes.values()], axis=0)))
    low, high = (1e3 * np.asarray(x) for x in grid.box_m)
    figure, axes = pyplot.subplots(2, len(fields), figsize=(11, 7.4), layout="constrained", squeeze=False)
    figure.suptitle(title)
    for (name, field), (contact, cut) in zip(fields.items(), axes.T, strict=True):
        depth_mm = 1e3 * (contact_along_axis(field).distances_m + grid.axis_m(2)[0])
        box = (low[0], high[0], high[1], low[1])
        depths = contact.imshow(depth_mm.T, extent=box, cmap="cividis_r", vmin=low[2], vmax=high[2])
        contact.set(title=f"{name}: first contact along z", xlabel="x / mm", ylabel="y / mm", facecolor="0.86")
        shown = np.where(sizes[name][:, middle] > 0, sizes[name][:, middle], np.nan)
        box = (low[0], high[0], low[2], high[2])
        forces = cut.imshow(shown.T, origin="lower", extent=box, cmap="cividis", vmin=0, vmax=3.3)
        at_mm = 1e3 * grid.axis_m(1)[middle]
        cut.set(title=f"{name}: |F| at y = {at_mm:.1f} mm", xlabel="x / mm", ylabel="z / mm", facecolor="0.86")
    figure.colorbar(depths, ax=axes[0], label="z of first contact / mm")
    figure.colorbar(forces, ax=axes[1], label="|F| / N")
    figure.savefig(path, dpi=110)
    pyplot.close(figure)
