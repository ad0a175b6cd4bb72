"""A body that bends at the receiver (paper section 6.3): control points, and a field without curl."""

import sys
from pathlib import Path

OUT = Path(sys.argv[1] if len(sys.argv) > 1 else ".")

# %%
# # A body that bends at the receiver
#
# Section 6.3 of the paper asks for deformation "without closing the loop". Here a receiver holds the field of
# a body at rest and a lattice of 8 x 8 x 8 control points, which say of every place where in that field it is
# looked up: psi(x) = x + u(x). The force is turned by the slopes of that map, F' = (I + grad u)^T F(psi(x)),
# and is free of curl where F was. The body is a capsule, 80 mm long and 20 mm thick; the points on its skin,
# straight and bent, are all that the control points are fitted to.
import matplotlib.pyplot as plt
import numpy as np

import touchfield as tf
from touchfield.medium.deformation import Deformation, fitted

half_m, radius_m, stiffness = 0.03, 0.01, 400.0
grid = tf.Grid((161, 65, 121), (0.0005,) * 3, (-0.04, -0.016, -0.016))


def axis_m(s, bend):
    """Places on the axis, at s from the middle, when the capsule is bent to 1 / bend metres."""
    return np.stack([np.sin(bend * s) / bend, 0 * s, (1 - np.cos(bend * s)) / bend], axis=-1)


def force_n(at, bend):
    """400 N/m, away from the axis: the field of the bent capsule, made anew."""
    s = np.clip(np.arctan2(at[..., 0], 1 / bend - at[..., 2]) / bend, -half_m, half_m)
    away = at - axis_m(s, bend)
    far = np.maximum(np.linalg.norm(away, axis=-1, keepdims=True), 1e-9)
    return np.maximum(stiffness * (radius_m - far), 0) * away / far


def skin_m(bend, depth_m=0.0):
    """Places on the skin, or so far below it."""
    s, turn = np.meshgrid(np.linspace(-half_m, half_m, 41), np.linspace(0, 2 * np.pi, 25)[:-1], indexing="ij")
    along = bend * s
    out = np.stack([-np.sin(along) * np.cos(turn), np.sin(turn), np.cos(along) * np.cos(turn)], axis=-1)
    return (axis_m(s, bend) + (radius_m - depth_m) * out).reshape(-1, 3)


bends = np.linspace(1e-3, 22, 9)
at = np.stack(np.meshgrid(*(grid.axis_m(a) for a in range(3)), indexing="ij"), axis=-1)
rest = tf.HapticMedium.from_array(force_n(at, bends[0])[None], grid, 30.0)
points = [np.concatenate([skin_m(bend, depth) for depth in (0.0, 0.004, 0.008)]) for bend in bends]
lattice = Deformation.at_rest((-0.042, -0.018, -0.018), (0.042, 0.018, 0.046), controls=8)
tracks, rms_m = fitted(points[0], points, lattice, 30.0)
print(f"{tracks}: to {1e6 * rms_m:.0f} um, least determinant {tracks.min_determinant()[0]:.2f}")

# %%
# ## Beside the field made anew
#
# At each step of the bend the field of the bent capsule is made anew, which is what the sender would have to
# send, and compared with the one that the receiver bends. Most of what is off lies on the axis, where the
# force turns around from one sample to the next and no lattice of samples tells where.
player = tf.FieldSampler(rest, deformation=tracks)
for n in (2, 4, 6, 8):
    bent, anew, still = player.force_n(n / 30, at), force_n(at, bends[n]), force_n(at, bends[0])
    off, before = (10 * np.log10((part**2).sum() / (anew**2).sum()) for part in (bent - anew, still - anew))
    angle = np.degrees(2 * half_m * bends[n])
    print(f"bent by {angle:2.0f} degrees: {off:.1f} dB; left straight {before:.1f}")

# %%
# ## The figure
#
# Left: the straight field that is stored. Middle: bent by the receiver, with the control points of the slice
# where they now look. Right: what is off, on the same scale of newtons. Arrows are the forces of the slice.
slices = [part[:, 32] for part in (force_n(at, bends[0]), bent, bent - anew)]
figure, panels = plt.subplots(1, 3, figsize=(14, 3.0), layout="constrained", sharey=True)
extent = 1e3 * np.array([grid.axis_m(0)[0], grid.axis_m(0)[-1], grid.axis_m(2)[0], grid.axis_m(2)[-1]])
titles = "stored", "bent at the receiver", "beside the field made anew"
for panel, part, title in zip(panels, slices, titles, strict=True):
    shown = panel.imshow(
        np.linalg.norm(part, axis=-1).T, origin="lower", extent=extent, cmap="cividis", vmin=0, vmax=4
    )
    few = part[4::8, 4::8]
    i, j = np.nonzero(np.linalg.norm(few, axis=-1) > 0.4)
    where = 1e3 * grid.axis_m(0)[4::8][i], 1e3 * grid.axis_m(2)[4::8][j]
    panel.quiver(*where, few[i, j, 0], few[i, j, 2], color="w", scale=70, width=0.003)
    panel.set_title(title)
    panel.set_xlabel("x / mm")
rows = np.flatnonzero(np.linalg.norm(slices, axis=-1).any(axis=(0, 1)))
edges_mm = 1e3 * grid.axis_m(2)[rows[[0, -1]]] + (-2, 2)
panels[0].set_ylabel("z / mm")
x, z = (1e3 * (np.asarray(lattice.corner_m)[a] + (np.arange(8) - 1) * lattice.spacing_m[a]) for a in (0, 2))
u = 1e3 * tracks.displacement_m[-1].mean(axis=1)
gx, gz = np.meshgrid(x, z, indexing="ij")
for panel, dx, dz in ((panels[0], u[..., 0], u[..., 2]), (panels[1], 0, 0)):
    for lines in ((gx + dx, gz + dz), ((gx + dx).T, (gz + dz).T)):
        panel.plot(*lines, color="w", lw=0.6, alpha=0.7)
    panel.set_xlim(extent[:2]), panel.set_ylim(edges_mm)
figure.colorbar(shown, ax=panels, label="force / N")
figure.savefig(OUT / "deformation.png", dpi=100)
plt.close(figure)
