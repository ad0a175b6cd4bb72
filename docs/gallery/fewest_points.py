"""A medium from a few points (paper section 6.2): a moving ball rebuilt from 12 of its samples, beside points
at random.
"""

import sys
from pathlib import Path

OUT = Path(sys.argv[1] if len(sys.argv) > 1 else ".")

# %%
# # A medium from a few points
#
# Section 6.2 of the paper asks for the fewest points from which a medium can be rendered. This page does not
# answer that: it compares chosen points with points at random, for one medium. A ball of 15 mm goes round.
# Its frames are written with a few modes, and points are sought whose forces tell what each mode has: where
# they are the farthest from one another (Q-DEIM), and where the modes miss least. That no other choice of as
# many points is better is not shown; the modes of the medium are a bound for all of them.
# `touchfield points 12 ball.touch rebuilt.touch` does the same with a file.
import matplotlib.pyplot as plt
import numpy as np

from touchfield.medium import Grid
from touchfield.reduction import ModePoints, mode_points, pod

grid = Grid.over_box((-0.04,) * 3, (0.04,) * 3, (20, 20, 20))
at = grid.to_m(np.moveaxis(np.indices(grid.shape), 0, -1)).reshape(-1, 3)
frames = []
for angle in np.linspace(0, 2 * np.pi, 64, endpoint=False):
    apart = at - 0.012 * np.array([np.cos(angle), np.sin(angle), 0.5 * np.sin(2 * angle)])
    far = np.linalg.norm(apart, axis=1, keepdims=True)
    frames.append(np.maximum(0.015 - far, 0) * 200 * apart / np.maximum(far, 1e-9))
forces = np.array(frames)
felt = forces.any(axis=(0, 2))
places, rows = 1e3 * at[felt], forces[:, felt].reshape(64, -1)
print(f"{len(rows)} frames of {len(places)} samples that ever hold a force")

# %%
# ## How many
#
# The modes are made of the even frames, and the error is that of the odd ones. What the modes cannot write of
# them is the floor: no choice of points gets below it.
learnt, seen = rows[::2], rows[1::2]


def decibels(error):
    return 10 * np.log10((error**2).sum() / (seen**2).sum())


counts, floor, ours, drawn = (4, 6, 8, 12, 16, 20), [], [], []
for count in counts:
    modes = pod(learnt, count)
    missed = (
        ((learnt - modes.rebuild(modes.coefficients(learnt))) ** 2).mean(axis=0).reshape(-1, 3).sum(axis=1)
    )
    every = [mode_points(modes, count, missed)]
    every += [
        ModePoints(modes, np.random.default_rng(s).choice(len(places), count, replace=False))
        for s in range(15)
    ]
    back = [modes.rebuild(points.coefficients(seen[:, points.rows])) for points in every]
    floor.append(decibels(seen - modes.rebuild(modes.coefficients(seen))))
    ours.append(decibels(seen - back[0]))
    drawn.append(sorted(decibels(seen - one) for one in back[1:]))
    if count == 12:
        shown, rebuilt = every[0].points, back[0][0].reshape(-1, 3)
    print(f"{count:2} points: floor {floor[-1]:.1f} dB, ours {ours[-1]:.1f}, at random {drawn[-1][7]:.1f}")

# %%
# ## The figure
#
# Left: |F| of a frame that was held out, seen from above, and the 12 points, which stand still while the ball
# goes round. Middle: the frame rebuilt from them. Right: the error by the number of points; of points at
# random the median of 15 draws, and the best and the worst.
figure, (left, middle, right) = plt.subplots(1, 3, figsize=(14, 4.4), layout="constrained")
own = seen[0].reshape(-1, 3)
top = np.linalg.norm(own, axis=1).max()
for panel, values, name in (
    (left, own, "a frame, and the points"),
    (middle, rebuilt, "rebuilt from 12 points"),
):
    size = np.linalg.norm(values, axis=1)
    order = np.argsort(size)
    dots = panel.scatter(
        *places[order, :2].T, c=size[order], s=60, marker="s", vmin=0, vmax=top, cmap="cividis"
    )
    panel.scatter(*places[shown, :2].T, s=70, facecolors="none", edgecolors="#d55e00", lw=1.6)
    panel.set_title(name)
    panel.set_xlabel("x / mm")
    panel.set_ylabel("y / mm")
    panel.set_aspect("equal")
figure.colorbar(dots, ax=middle, shrink=0.8).set_label("|F| / N")
draws = np.array(drawn)
right.fill_between(counts, draws[:, 0], draws[:, -1], color="#d55e00", alpha=0.15, lw=0)
right.plot(counts, draws[:, 7], "o-", color="#d55e00", ms=4, label="at random")
right.plot(counts, ours, "o-", color="#0072b2", ms=4, label="chosen")
right.plot(counts, floor, "--", color="0.4", label="floor of the modes")
right.set_ylim(min(floor) - 2, 12)
right.set_xlabel("points, and modes")
right.set_ylabel("NMSE / dB")
right.legend(fontsize=8)
right.spines[["top", "right"]].set_visible(False)
figure.savefig(OUT / "fewest_points.png", dpi=100)
plt.close(figure)
