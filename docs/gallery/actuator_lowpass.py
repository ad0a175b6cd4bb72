"""The low-pass of a tactile T-shirt (paper section 3.2): the printed cut-off, the correct one, and aliasing
seen.
"""

import sys
from pathlib import Path

OUT = Path(sys.argv[1] if len(sys.argv) > 1 else ".")

# %%
# # The low-pass of a tactile T-shirt
#
# Section 3.2 of the paper puts an array of vibrators into a T-shirt, a distance $d$ apart, and says that "the
# maximum frequency that can be rendered is $f = 2\,\frac{1}{d}$". Samples a distance $d$ apart carry waves up
# to $1/(2d)$: the printed cut-off is four times too high. What lies between the two passes the filter, and
# the vibrators show it as something that is not there.
#
# Here is the proof, with vibrators 35 mm apart and a pattern of ridges 44 mm apart, which is a wave of
# $0.8/d$.
import matplotlib.pyplot as plt
import numpy as np

import touchfield as tf
from touchfield.filters import actuator_taps, cutoff_per_m, fir_filter, frequency_response

pitch_m, spacing_m = 0.035, 0.035 / 32
x_m = np.arange(0, 32 * 65) * spacing_m  # 52 ridges: a whole number, for the wrapped border
ridges = 0.5 + 0.5 * np.cos(2 * np.pi * 0.8 / pitch_m * x_m)
taps = {cutoff: actuator_taps(spacing_m, pitch_m, cutoff) for cutoff in ("literal", "nyquist")}
filtered = {cutoff: fir_filter(ridges, h, boundary="wrap") for cutoff, h in taps.items()}
for cutoff, h in taps.items():
    shown = filtered[cutoff][::32]
    spectrum = np.abs(np.fft.rfft(shown - shown.mean())) / len(shown)
    strongest = np.fft.rfftfreq(len(shown))[spectrum.argmax()]
    print(
        f"{cutoff:8s} cut-off {cutoff_per_m(pitch_m, cutoff) * pitch_m:g}/d, {len(h):4d} taps: the vibrators "
        "show",
        end=" ",
    )
    print(
        f"a wave of {strongest:.2f}/d"
        if spectrum.max() > 1e-3
        else f"no wave, {shown.mean():.2f} N throughout"
    )

# %%
# ## On a real scene
#
# The motorcycle on a T-shirt of 32 x 32 vibrators: each shows the strongest force in its column of the scene,
# after the low-pass. Both pictures have the same scale.
shirts = {}
for cutoff in ("literal", "nyquist"):
    spec = tf.EncodeSpec(device="tshirt-32x32", cutoff=cutoff)
    shirts[cutoff] = tf.prepare("sample:motorcycle", spec).medium[0].to_dense()[:, :, 0, 2]
apart = np.abs(shirts["literal"] - shirts["nyquist"])
print(f"{(apart > 0.1 * shirts['nyquist'].clip(0.5)).mean():.0%} of the vibrators differ by more than 10 %")

# %%
# ## The figure
#
# Above left: the two filters; everything in the grey part cannot be shown by the array, and whatever passes
# there comes back folded. Above right: the ridges, and what each filter leaves of them at the vibrators: the
# printed cut-off makes false ridges four times as far apart, the correct one says that there is nothing to
# feel. Below: the scene.
figure = plt.figure(figsize=(13, 8), layout="constrained")
upper, lower = figure.subfigures(2, 1, height_ratios=(1, 1.1))
left, right = upper.subplots(1, 2, width_ratios=(1, 1.3))
frequency = np.linspace(0, 3, 600)  # cycles per pitch
names = {"literal": "as printed, 2/d", "nyquist": "correct, 1/(2d)"}
colours = {"literal": "#d55e00", "nyquist": "#0072b2"}
for cutoff, h in taps.items():
    gain_db = 20 * np.log10(np.abs(frequency_response(h, 2 * np.pi * frequency / 32)))
    left.plot(frequency, gain_db, color=colours[cutoff], label=names[cutoff])
left.axvspan(0.5, 3, color="0.9", zorder=0)
left.text(1.35, -35, "the array cannot show this", ha="center", fontsize=9)
left.plot(0.8, 0, "kv", ms=7)
left.annotate("the ridges", (0.8, 0), (8, -16), textcoords="offset points", fontsize=9)
left.set_ylim(-70, 8)
left.set_xlim(0, 3)
left.set_xlabel("frequency / cycles per pitch d")
left.set_ylabel("gain / dB")
left.legend(loc=(0.42, 0.28), fontsize=9)
part = slice(0, 32 * 12 + 1)
right.plot(1e3 * x_m[part], ridges[part], color="0.7", label="ridges of 0.8/d")
for cutoff in taps:
    at = slice(0, 32 * 12 + 1, 32)
    right.plot(
        1e3 * x_m[at],
        filtered[cutoff][at],
        "o-",
        color=colours[cutoff],
        label=f"at the vibrators, {names[cutoff]}",
    )
right.set_xlabel("place on the skin / mm")
right.set_ylabel("force / N")
right.set_ylim(-0.05, 1.45)
right.legend(loc="upper center", fontsize=8, ncols=3)
top = max(shirt.max() for shirt in shirts.values())
panels = lower.subplots(1, 3)
for panel, (cutoff, shirt) in zip(panels, shirts.items(), strict=False):
    image = panel.imshow(shirt.T, origin="upper", cmap="cividis", vmin=0, vmax=top)
    panel.set_title(f"motorcycle, {names[cutoff]}", fontsize=10)
lower.colorbar(image, ax=panels[:2], shrink=0.8).set_label("force / N")
image = panels[2].imshow(apart.T, origin="upper", cmap="magma", vmin=0)
panels[2].set_title("difference", fontsize=10)
lower.colorbar(image, ax=panels[2], shrink=0.8).set_label("force / N")
for panel in panels:
    panel.set_xlabel("vibrator, left to right")
panels[0].set_ylabel("vibrator, top to bottom")
for panel in (left, right):
    panel.spines[["top", "right"]].set_visible(False)
figure.savefig(OUT / "actuator_lowpass.png", dpi=100)
plt.close(figure)
