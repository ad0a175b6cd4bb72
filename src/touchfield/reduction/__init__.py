"""A medium in fewer numbers (paper section 6.1): what varies together, and what no hand can reach.

modes        snapshots as a few modes, their error known beforehand
"""

from touchfield.reduction.modes import Modes, klt, pod

__all__ = ["Modes", "klt", "pod"]
