"""Vibration with force (paper section 6.4): a texture from a recording to the hand, and what of it must be
sent.
"""

import sys
from pathlib import Path

OUT = Path(sys.argv[1] if len(sys.argv) > 1 else ".")

# %%
# # Vibration with force
#
# Section 6.4 of the paper would "process the vibrotactile feedback in the spectral domain and then modulate
# the force feedback appropriately in the time domain", and leaves it there. Here is one way. A tool that
# slides over ridges 1 mm apart shakes; its acceleration, three axes at three speeds, is made up here and
# might as well come from `touchfield texture drag.wav -o oak.json --speed-m-s 0.05 --force-n 0.6`. It becomes
# one axis (DFT321), a force that shakes a hand likewise, and a table: newtons in thirds of an octave, by
# speed and force.
import matplotlib.pyplot as plt
import numpy as np

import touchfield as tf
from touchfield.devices.drivers.registry import point_device
from touchfield.medium.trace import Trace
from touchfield.perception.human import vibration_threshold
from touchfield.perception.vibrotactile import BANDS_HZ, Crossover, band_rms, dft321, reduce_vibration
from touchfield.render.offline import run_offline
from touchfield.render.spec import RenderSpec
from touchfield.sources.recordings.recording import Recording
from touchfield.tasks.texture import texture_of

rng, rate_hz, speeds_m_s = np.random.default_rng(1), 5000.0, (0.04, 0.08, 0.16)
recordings = []
for speed in speeds_m_s:
    ridge = 2 * np.pi * np.cumsum(speed / 0.001 * (1 + 0.05 * rng.normal(size=20_000))) / rate_hz
    hit = speed / 0.1 * (np.sin(ridge) + 0.4 * np.sin(2 * ridge))
    axes = np.outer(hit, [0.3, 0.2, 0.9]) + 0.5 * speed / 0.1 * rng.normal(size=(20_000, 3))
    recordings.append(Recording(rate_hz, axes))
oak = texture_of(recordings, speeds_m_s, (0.6, 0.6, 0.6), "oak", friction=0.3)
for speed, levels_n in zip(speeds_m_s, oak.levels_n[:, 0], strict=True):
    loudest = int(levels_n.argmax())
    print(
        f"{1e3 * speed:3.0f} mm/s: {1e3 * levels_n[loudest]:.1f} mN in the third at {BANDS_HZ[loudest]:.0f} "
        "Hz"
    )

# %%
# ## As it is felt
#
# A simulated hand slides over a wall that is made of this oak, at each of the speeds. The field says how hard
# the wall pushes, the table how it shakes; what the device puts out has passed every limit. So its thirds are
# those of the table, but at the highest speed, where the force would change faster than the slew limit
# allows: there all of them are weaker by the same factor, and the player tells it.
grid = tf.Grid((65, 17, 17), (0.005,) * 3, (-0.16, -0.04, -0.06))
force = np.zeros((1, *grid.shape, 3))
force[..., 2] = np.maximum(-400 * (grid.origin_m[2] + 0.005 * np.arange(17)), 0)
wall = tf.HapticMedium.from_array(force, grid, 30.0)
device, spec = (
    tf.device("phantom-omni"),
    RenderSpec(render="field", rate_hz=2500.0, materials=(oak,)),
)
felt = {}
for speed in speeds_m_s:
    seconds = 0.28 / speed
    slide = Trace(np.array([0, seconds]), np.array([[-0.14, 0, -0.0015], [0.14, 0, -0.0015]]))
    run = run_offline(wall, device, point_device("sim", slide).opener, spec, seconds=seconds)
    felt[speed] = run.log["force_n"][400:-100].astype(float)
    signal, table_n = felt[speed][:, 2], oak.levels_n[speeds_m_s.index(speed), 0]
    off_db = 20 * np.log10(band_rms(signal - signal.mean(), 2500.0) / table_n)
    print(f"{1e3 * speed:3.0f} mm/s: {np.median(off_db):+.1f} dB, every third to {np.ptp(off_db) / 2:.1f} dB")
print(next(note for note in run.notes if "slew" in note))

# %%
# ## As it is sent
#
# The force of the fastest slide, three axes, is split at 30 Hz into what is felt as a force, which a field
# codes, and a vibration. Of that goes what is above the threshold of a hand that holds a stylus (most of its
# points are from one secondary source): thirds below it are dropped, the others quantised so that what is
# lost stays 3 dB below it.
low, high = Crossover(2500.0).split(felt[0.16])
one = dft321(high)
sent = reduce_vibration(one, 2500.0)
lost = one - sent.decoded()
print(f"low and high add up to {np.abs(low + high - felt[0.16]).max():.0g} N")
print(f"{16 * 2.5:.0f} kbit/s of 16-bit samples become {sent.bits_per_s / 1e3:.1f}")

# %%
# ## The figure
#
# Left: the force of the slide and its two parts, which add up to it. Middle: the vibration by thirds of an
# octave, and what is lost of it, below the threshold. Right: the table (lines) and the hand (points); ridges
# 1 mm apart shake at 40, 80 and 160 Hz.
figure, (left, middle, right) = plt.subplots(1, 3, figsize=(14, 4.4), layout="constrained")
part = slice(600, 1100)
t = np.arange(len(one))[part] / 2.5
left.plot(t, felt[0.16][part, 2], color="0.75", lw=2.5, label="force")
left.plot(t, low[part, 2], color="#0072b2", label="low: what a field codes")
left.plot(t, high[part, 2], color="#d55e00", label="high: a vibration")
left.set_xlabel("time / ms")
left.set_ylabel("force across the wall / N")
left.legend(fontsize=8, loc="center right")
threshold_mn = vibration_threshold().force_rms_mn(BANDS_HZ)
middle.fill_between(BANDS_HZ, threshold_mn, 0.02, color="0.9", lw=0, label="below the threshold")
middle.loglog(BANDS_HZ, 1e3 * band_rms(one, 2500.0), "o-", color="#d55e00", ms=4, label="vibration")
middle.loglog(BANDS_HZ, 1e3 * band_rms(lost, 2500.0), "o-", color="#0072b2", ms=4, label="lost")
middle.set_ylim(0.02, 100)
middle.set_xlabel("frequency / Hz")
middle.set_ylabel("force / mN rms")
middle.legend(fontsize=8)
for n, speed in enumerate(speeds_m_s):
    signal = felt[speed][:, 2]
    right.loglog(BANDS_HZ, 1e3 * oak.levels_n[n, 0], color=f"C{n}", lw=1.2, label=f"{1e3 * speed:.0f} mm/s")
    right.loglog(BANDS_HZ, 1e3 * band_rms(signal - signal.mean(), 2500.0), "o", color=f"C{n}", ms=4)
right.set_xlabel("frequency / Hz")
right.set_ylabel("force / mN rms")
right.legend(fontsize=8)
for panel in (left, middle, right):
    panel.spines[["top", "right"]].set_visible(False)
figure.savefig(OUT / "vibration_with_force.png", dpi=100)
plt.close(figure)
