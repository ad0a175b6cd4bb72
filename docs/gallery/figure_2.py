"""Figure 2 of the paper: a haptic signal, its quantised version, the error, and the perceptual mask."""

import sys
from pathlib import Path

OUT = Path(sys.argv[1] if len(sys.argv) > 1 else ".")

# %%
# # A quantiser that stays within the mask
#
# Figure 2 of the paper shows a force signal $x(t)$, its quantised version $Q(x)$, the error $|Q(x) - x|$ and
# the mask $\Delta(x) = k\,x$ with $k = 0.25$: "the adaptive quantization step has to be carefully selected so
# that the quantization error never exceeds the perceptual mask". The paper calls its figure qualitative. Here
# it is made of a real signal, and the condition is checked.
#
# The signal is what a hand feels that strokes over a mountain: the elevation model of the Jacksboro fault in
# Tennessee as a force field in the workspace of a Phantom Omni, and a straight stroke of 9 cm across it in
# one second, sampled at 1 kHz.
import numpy as np

import touchfield as tf
from touchfield.perception.weber import WeberLadder, jnd_gain, quantise_fixed_step, within_mask_from_n
from touchfield.viewer.plots import draw_masked_signal

prepared = tf.prepare(
    "sample:terrain", tf.EncodeSpec(mapping="fill", source=tf.sources.SourceOptions(exaggeration=5.0))
)
field = prepared.medium[0]
t = np.linspace(0, 1, 1000)
path_m = np.stack([-0.045 + 0.09 * t, np.full_like(t, -0.02), np.full_like(t, -0.007)], axis=1)
x = np.linalg.norm(field.sample_n(path_m), axis=1)
print(f"{x.min():.2f} to {x.max():.2f} N over one second")

# %%
# ## Three readings of equation 6
#
# Equation 6 is $Q(x) = \mathrm{sgn}(x)\,\Delta\,\lfloor |x|/\Delta + 1/2 \rfloor$ "with $\Delta$ a function
# of $x$".
#
# - **As printed**, $\Delta = k|x|$: then $|x|/\Delta = 1/k$ whatever $x$ is, and $Q$ multiplies by a
#   constant. For $k = 0.25$ the constant is 1: nothing is quantised.
# - **One fixed step**: the error is up to $\Delta/2$ everywhere, so the mask is kept only where
#   $x \ge \Delta/(2k)$, and is broken by every weak force.
# - **The Weber ladder**, our default: steps that grow with the force by the ratio $(1+k)/(1-k)$. The relative
#   error is never more than $k$, and no quantiser with fewer levels can say so.
k = 0.25
step_n = 0.5
ladder = WeberLadder.spanning(k, 0.03, 3.3)
levels = ladder.levels_n[np.searchsorted(ladder.thresholds_n, x, side="right")]
readings = {
    f"as printed: a gain of {jnd_gain(k):g}": jnd_gain(k) * x,
    f"fixed step of {step_n} N": quantise_fixed_step(x, step_n),
    f"Weber ladder, {ladder.steps} levels": levels,
}
for name, q in readings.items():
    beyond = np.abs(q - x) > k * x * (1 + 1e-9)
    print(f"{name:30s} {len(np.unique(q)):4d} values, beyond the mask {beyond.mean():6.1%} of the time")
print(f"the fixed step keeps the mask from {within_mask_from_n(step_n, k):g} N on")

# %%
# ## The figure
#
# Above: the signal and what is left of it. Below: the error, with the mask as a grey area; orange is what a
# hand could feel. The ladder's error touches the border of the mask and never crosses it, with no more values
# than the fixed step needs here. That is what the paper's figure 2 asks for, and what its equation 6 does not
# give.
draw_masked_signal(OUT / "figure_2.png", t, x, readings, k)
