"""Force shading off line: a coarse mesh that feels smooth (paper section 3.2)."""

import sys
from pathlib import Path

OUT = Path(sys.argv[1] if len(sys.argv) > 1 else ".")

# %%
# # Force shading: a coarse mesh that feels smooth
#
# A ball of 80 triangles feels like a cut stone: the force jumps wherever the hand passes from one facet to
# the next. Haptic renderers hide that while the hand moves, by interpolating normals. In a passive haptic
# medium the field is computed ahead, so that the same is a filter: "Gaussian kernels, or even anisotropic
# diffusion for smoothing can result in an information theoretic way to perform off-line force shading"
# (section 3.2).
#
# Direction and amplitude are smoothed apart, and only over the samples that hold a force. A plain Gaussian of
# the vectors would mix in the empty space outside and make the wall soft; it is shown for comparison.
import matplotlib.pyplot as plt
import numpy as np
import trimesh

import touchfield as tf
from touchfield.sources.mesh.mesh_scene import MeshScene

ball = trimesh.creation.icosphere(subdivisions=1, radius=0.03)
scene = MeshScene(np.asarray(ball.vertices), np.asarray(ball.faces))
spec = tf.EncodeSpec(nw=7, mapping="1", thickness_m=0.005)
faceted = tf.prepare(scene, spec).medium[0]
print(f"{len(ball.faces)} triangles, edges of {1e3 * ball.edges_unique_length.mean():.0f} mm")

# %%
# ## Three filters
chain = {
    "as modelled": None,
    "plain Gaussian, 2.5 mm": tf.filters.filter_of("gaussian", "2.5mm"),
    "force shading, 6 mm": tf.filters.filter_of("shading", "6mm"),
    "anisotropic diffusion": tf.filters.filter_of("perona-malik", "steps=60,kappa=0.6"),
}
fields = {name: faceted if step is None else step(faceted) for name, step in chain.items()}


# %%
# The field of a true ball points away from its centre. How far the direction is off, in degrees, says how
# much of the facets is left; what is left of the amplitude says whether the wall is as stiff as before.
def direction_error_deg(field: tf.ForceField) -> np.ndarray:
    """The angle between each force and the ball's radius there."""
    force = field.vectors_n().astype(float)
    radius = field.grid.to_m(field.positions())
    across = np.linalg.norm(np.cross(radius, force), axis=1)
    return np.degrees(np.arctan2(across, (radius * force).sum(axis=1)))


def mean_force_n(field: tf.ForceField) -> float:
    """Mean |F| where the model has a force."""
    at = field.sample_n(faceted.grid.to_m(faceted.positions()))
    return float(np.linalg.norm(at, axis=1).mean())


print(f"{'':26s} {'direction off (rms)':>20s} {'mean force':>11s} {'samples with a force':>21s}")
for name, field in fields.items():
    rms = np.sqrt((direction_error_deg(field) ** 2).mean())
    print(f"{name:26s} {rms:16.2f} deg {mean_force_n(field):9.3f} N {field.support_count:21,d}")

# %%
# ## The figure
#
# Above: a cut through the middle of the ball, seen from the side; the colour says how far the direction is
# off. Below: what a fingertip feels that goes once around the ball, 2 mm deep: the sideways part of the
# force, which is zero on a true ball and pushes the finger over each facet of the model.
figure = plt.figure(figsize=(13, 6.4), layout="constrained")
upper, lower = figure.subfigures(2, 1, height_ratios=(1.25, 1))
panels = upper.subplots(1, 4, sharey=True)
for panel, (name, field) in zip(panels, fields.items(), strict=True):
    middle = faceted.grid.shape[2] // 2
    held = field.positions()
    off = np.full(faceted.grid.shape[:2], np.nan)
    cut = held[:, 2] == middle
    off[tuple(held[cut, :2].T)] = direction_error_deg(field)[cut]
    low, high = 1e3 * np.stack(faceted.grid.box_m)
    box = (low[0], high[0], low[1], high[1])
    image = panel.imshow(off.T, origin="lower", extent=box, vmin=0, vmax=20, cmap="cividis_r")
    panel.set_xlim(-36, 36)
    panel.set_ylim(-36, 36)
    panel.set_title(name, fontsize=10)
    panel.set_xlabel("x / mm")
panels[0].set_ylabel("y / mm")
upper.colorbar(image, ax=panels, shrink=0.85).set_label("direction off / degrees")

angle = np.linspace(0, 2 * np.pi, 1500)
inner = ball.vertices[ball.faces].mean(axis=1)  # the facets lie inside the ball
reach = np.linalg.norm(inner, axis=1).min() - 0.002
around = reach * np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
sideways = np.stack([-np.sin(angle), np.cos(angle), np.zeros_like(angle)], axis=1)
panel = lower.subplots()
colours = ("0.6", "#e69f00", "#0072b2", "#009e73")
for (name, field), colour in zip(fields.items(), colours, strict=True):
    felt = (field.sample_n(around) * sideways).sum(axis=1)
    panel.plot(
        np.degrees(angle), felt, color=colour, lw=1.6, label=f"{name}: {np.abs(felt).max():.2f} N at most"
    )
panel.set_xlabel("way around the ball / degrees")
panel.set_ylabel("sideways force / N")
panel.set_xlim(0, 360)
panel.set_ylim(-0.6, 0.8)
panel.legend(fontsize=8, loc="upper right", ncols=4)
panel.spines[["top", "right"]].set_visible(False)
figure.savefig(OUT / "force_shading.png", dpi=100)
plt.close(figure)
