"""The sources behind the figures of each command, which ``--cite`` prints.

A source is one line of text: authors, title, where it appeared, year. The modules that compute the figures
name the same sources, with what is taken from each.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from touchfield._version import __version__

SOURCES: Final[Mapping[str, str]] = MappingProxyType(
    {
        "touchfield": f"touchfield {__version__}; CITATION.cff of its repository is for a bibliography",
        "paper": "K. Moustakas and A. S. Lalos, An information-theoretic treatment of passive haptic media",
        "miller": "G. A. Miller, Note on the bias of information estimates, in Information Theory in "
        "Psychology, 1955 (estimator miller-madow)",
        "chao": "A. Chao, Y. T. Wang and L. Jost, Entropy and the species accumulation curve, Methods in "
        "Ecology and Evolution 4, 2013 (estimator chao-wang-jost)",
        "whittle": "P. Whittle, On stationary processes in the plane, Biometrika 41, 1954 (intervals)",
        "mueller": "U. K. Mueller, A theory of robust long-run variance estimation, Journal of Econometrics "
        "141, 2007 (intervals)",
        "meila": "M. Meila, Comparing clusterings: an information based distance, Journal of Multivariate "
        "Analysis 98, 2007 (variation of information)",
        "endres": "D. M. Endres and J. E. Schindelin, A new metric for probability distributions, IEEE "
        "Transactions on Information Theory 49, 2003 (Jensen-Shannon distance)",
        "theiler": "J. Theiler et al., Testing for nonlinearity in time series: the method of surrogate "
        "data, Physica D 58, 1992 (test against chance)",
        "manohar": "K. Manohar et al., 2018, after Z. Drmac and S. Gugercin, 2016 (points that determine "
        "modes)",
        "israr": "A. Israr, S. Choi and H. Z. Tan, Detection threshold and mechanical impedance of the hand "
        "in a pen-hold posture, IROS, 2006 (threshold of vibration)",
        "pang": "X. D. Pang, H. Z. Tan and N. I. Durlach, Manual discrimination of force using active finger "
        "motion, Perception and Psychophysics 49, 1991 (--profile: k of grip stylus and finger)",
        "doerrer": "C. Doerrer and R. Werthschuetzky, Simulating push-buttons using a haptic display, "
        "EuroHaptics, 2002 (--profile: k of grip stylus and finger)",
        "feyzabadi": "S. Feyzabadi et al., Human force discrimination during active arm motion for force "
        "feedback design, IEEE Transactions on Haptics 6, 2013 (--profile: F_0 of grip stylus and ball, k of "
        "grip ball)",
        "king": "H. H. King, R. Donlin and B. Hannaford, Perceptual thresholds for single vs. multi-finger "
        "haptic interaction, IEEE Haptics Symposium, 2010 (--profile: F_0 of grip finger)",
        "barbagli": "F. Barbagli et al., Haptic discrimination of force direction and the influence of "
        "visual information, ACM Transactions on Applied Perception 3, 2006 (--mode mask-direction)",
        "landin": "N. Landin, J. M. Romano, W. McMahan and K. J. Kuchenbecker, Dimensional reduction of "
        "high-frequency accelerations for haptic rendering, EuroHaptics, 2010 (three axes to one)",
        "culbertson": "H. Culbertson, J. J. Lopez Delgado and K. J. Kuchenbecker, One hundred data-driven "
        "haptic texture models and open-source methods for rendering on 3D objects, IEEE Haptics Symposium, "
        "2014 (models, .xml)",
        "shoham": "Y. Shoham and A. Gersho, Efficient bit allocation for an arbitrary set of quantizers, "
        "IEEE Transactions on Acoustics, Speech, and Signal Processing 36, 1988 (lambda)",
    }
)
"""The text of each source, by a short name."""

_INTERVALS: Final = ("whittle", "mueller")
_CITED: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        "encode": ("pang", "doerrer", "feyzabadi", "king", "barbagli"),
        "measure": ("miller", "chao", *_INTERVALS, "meila"),
        "reduce": ("manohar",),
        "points": ("manohar",),
        "similar": ("meila", "endres", *_INTERVALS),
        "correlate": ("miller", "theiler", *_INTERVALS),
        "compare": ("israr",),
        "plan": ("shoham",),
        "texture": ("landin", "culbertson", "israr"),
    }
)


def cited_commands() -> tuple[str, ...]:
    """Return the commands whose figures have sources."""
    return tuple(_CITED)


def sources_of(command: str) -> tuple[str, ...]:
    """Return the sources of a command's figures, the software and the paper first; () if it has none."""
    names = _CITED.get(command)
    return () if names is None else tuple(SOURCES[name] for name in ("touchfield", "paper", *names))
