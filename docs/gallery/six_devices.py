"""Equations 1 to 3 of the paper: what six devices render of one real scene, and what they lose."""

import sys
from pathlib import Path

OUT = Path(sys.argv[1] if len(sys.argv) > 1 else ".")

# %%
# # How much of a scene does a device let through?
#
# The paper's section 3.1 looks at a haptic device as a channel. A scene is an information source with an
# entropy $H(W)$. The mapping $M$ to a device scales it into the workspace, low-passes and resamples it to
# what the device can place, clips it to the force that the device can exert, and rounds it to the device's
# levels. What is left is the workspace capacity $C = H(M(W))$; the *workspace mapping ratio* is
# $\mathrm{WMR} = C / H(W)$ and the *haptic information loss* is $\mathrm{HIL} = (H(W) - C) / H(W)$.
#
# The scene is a motorcycle, seen by a stereo camera, as a field of forces up to 20 N in the workspace of a
# strong desktop device (delta.3, 400 x 400 x 260 mm, 128 samples along each axis). That field is $W$. The six
# devices are three points that a hand moves and three arrays that lie on the skin.
import matplotlib.pyplot as plt
import numpy as np

import touchfield as tf

DEVICES = ("delta.3", "novint-falcon", "phantom-omni", "tshirt-32x32", "dotpad", "tactsuit-x40")
spec = tf.tasks.MeasureSpec(
    quantiser="weber:0.1",
    devices=DEVICES,
    limits=False,
    encode=tf.EncodeSpec(device="delta.3", nw=7, mapping="fill", stiffness_n_per_m=2000.0),
)
found = tf.tasks.measure_medium("sample:motorcycle", spec)
print(found.per_frame)
print(f"{found.supported_voxels:,} of {found.voxels:,} voxels hold a force; Q has {found.alphabet:,} symbols")

# %%
# ## The table
#
# Everything is in bits *per frame*: bits per sample would say nothing, because each device has other samples.
# The range behind each ratio allows for the dependence of neighbouring voxels. A ratio that is 1 whatever the
# scene has none. "Could be told" is the literal reading of equation 1, $\log_2$ of the number of states of
# the device.
print(f"{'device':15s} {'could be told':>14s} {'C':>10s} {'WMR':>9s}  {'95 % ranges, both':>20s} {'HIL':>8s}")
for name, c in found.capacities.items():
    i = c.wmr.interval
    ends = "none" if i is None else f"{i.low:.2e} - {i.high:.2e}"
    print(
        f"{name:15s} {c.codomain_bits:14,.0f} {c.capacity.value:10,.0f} {c.wmr.value:9.2e}  "
        f"{ends:>20s} {c.hil.value:8.5f}"
    )

# %%
# ## The figure
#
# A ratio of one to ten thousand needs a scale of powers, and that is the point: on a scale from 0 to 1 an
# array of actuators renders nothing of the scene. A point device loses by its force limit and its workspace
# alone here: its lattice is finer than the 128 samples of $W$, and equation 1's min() sees to it that more
# samples of the same field do not count as more information. An array keeps one number for each actuator, and
# loses depth and direction.
kept = np.array([c.wmr.value for c in found.capacities.values()])
ranges = {y: c.wmr.interval for y, c in enumerate(found.capacities.values()) if c.wmr.interval is not None}
lost = np.array([c.hil.value for c in found.capacities.values()])
place = np.arange(len(DEVICES))
figure, (left, right) = plt.subplots(1, 2, figsize=(12, 4), sharey=True, layout="constrained")
left.hlines(place, 1e-6, 1, color="0.9")
for y, i in ranges.items():
    left.hlines(y, i.low, i.high, color="#0072b2", lw=6, alpha=0.3)
left.plot(kept, place, "o", color="#0072b2", ms=8)
for y, value in zip(place, kept, strict=True):
    left.annotate(f"{value:.2g}", (value, y), (0, 9), textcoords="offset points", ha="center", fontsize=9)
left.set_xscale("log")
left.set_xlim(1e-6, 2)
left.set_yticks(place, DEVICES)
left.set_ylim(len(DEVICES) - 0.4, -0.7)
left.set_xlabel("WMR, share of the scene's information that is rendered")
right.barh(place, lost, color="0.75", height=0.6)
for y, value in zip(place, lost, strict=True):
    right.text(0.02, y, f"{value:.4f}", va="center", fontsize=9)
right.set_xlim(0, 1)
right.set_xlabel("HIL, share that is lost")
for panel in (left, right):
    panel.spines[["top", "right"]].set_visible(False)
figure.savefig(OUT / "six_devices.png", dpi=100)
plt.close(figure)
