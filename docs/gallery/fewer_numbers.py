"""Fewer numbers (paper section 6.1): the modes of a medium, and what of a solid no hand can reach."""

import sys
from pathlib import Path

OUT = Path(sys.argv[1] if len(sys.argv) > 1 else ".")

# %%
# # Fewer numbers
#
# Section 6.1 of the paper fears the dimensionality of a medium that is sent whole, names "space partitioning
# and culling", and leaves "a fundamental theoretical treatment of dimensionality reduction" to others. Two
# parts of an answer: what varies together is told by few modes, and what no hand can reach need not be told
# at all.
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

import touchfield as tf
from touchfield.reduction import Hand, freedom, held_out, reach_of, reduce_to_modes
from touchfield.tasks.reduction import without_unreachable

# %%
# ## A solid that breathes, and one that walks
#
# A ball of 45 mm, solid, in a box of 144 mm: one changes its radius by 3 mm, the other goes 24 mm to the
# right.
count, step_m = 48, 0.003
grid = tf.Grid((count,) * 3, (step_m,) * 3, (-0.0705,) * 3)
x = np.stack(np.meshgrid(*[grid.axis_m(a) for a in range(3)], indexing="ij"), axis=-1)


def ball(center_m, radius_m):
    """A wall of 1500 N/m up to 8 N."""
    away = x - np.array(center_m)
    far = np.linalg.norm(away, axis=-1)[..., None]
    size = np.minimum(1500 * np.maximum(radius_m - far, 0), 8)
    return tf.ForceField.from_dense(grid, (size * away / np.maximum(far, 1e-9)).astype(np.float32))


turns = 2 * np.pi * np.arange(40) / 40
breathes = [ball((0, 0, 0), 0.045 + 0.003 * np.sin(t)) for t in turns]
walks = [ball((0.024 * n / 39 - 0.012, 0, 0), 0.045) for n in range(40)]
media = {
    name: tf.HapticMedium.from_frames(frames, 30.0)
    for name, frames in (("breathes", breathes), ("walks", walks))
}

# %%
# ## Modes
#
# Whole frames are the snapshots. What is left after so many modes is the tail of their singular values, known
# beforehand. The odd frames are told with the modes of the even ones. Of a body that walks each frame is new:
# it has more degrees of freedom, though it has only one.
found = {name: reduce_to_modes(medium, "global") for name, medium in media.items()}
for name, medium in media.items():
    told, free = held_out(medium, "global"), freedom(found[name], 0.05)
    print(
        f"{name}: {free.effective:.2f} degrees of freedom of {free.bits:.1f} bits; frames held out need"
        f" {told.modes} modes for {told.nmse_db:.0f} dB, with them {100 * told.share:.0f} % of the numbers"
    )

# %%
# ## What no hand reaches
#
# For a hand that pushes with 1 N at most, weighs 0.1 kg with its device and is never faster than 0.2 m/s, a
# layer of the field is sought that stops it wherever it comes from (`touchfield.reduction.reach` has the
# proof). What lies behind it is left out, and no force that such a hand can meet changes by a bit.
hand = Hand(push_n=1.0, mass_kg=0.1, speed_m_s=0.2)
solid = tf.HapticMedium.from_frames([ball((0, 0, 0), 0.068)], 30.0)
reach = reach_of(solid, hand)
shell = without_unreachable(solid, reach.samples)
print(f"{hand.text}: {shell[0].support_count / solid[0].support_count:.0%} of a ball of 68 mm is left")

# %%
# ## The figure
#
# Left: what is left of the energy after so many modes. Right: the middle section of the ball; grey is never
# felt.
figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.4), layout="constrained")
for n, (name, own) in enumerate(found.items()):
    squares = own.modes.values**2
    tail = np.append(np.cumsum(squares[::-1])[::-1], 0) / squares.sum()
    left.plot(10 * np.log10(np.maximum(tail, 1e-9)), "o-", ms=3, color=f"C{n}", label=name)
left.axhline(-30, color="0.7", lw=1)
left.set_ylim(-60, 2)
left.set_xlabel("modes kept")
left.set_ylabel("error / dB of the energy")
left.legend()
left.spines[["top", "right"]].set_visible(False)
size = np.linalg.norm(solid[0].to_dense(), axis=-1)[:, :, 24]
edge_mm = 1e3 * np.array([grid.box_m[0][0], grid.box_m[1][0]] * 2)
image = right.imshow(np.where(size > 0, size, np.nan).T, origin="lower", extent=edge_mm, cmap="viridis")
gone = np.where((size > 0) & ~reach.samples[:, :, 24], 1.0, np.nan)
right.imshow(gone.T, origin="lower", extent=edge_mm, cmap="Greys", vmin=0, vmax=2)
right.set_xlabel("x / mm")
right.set_ylabel("y / mm")
figure.colorbar(image, ax=right, label="force / N", shrink=0.85)
figure.savefig(OUT / "fewer_numbers.png", dpi=100)
plt.close(figure)
