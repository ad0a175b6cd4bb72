"""Perception: what a human can tell apart (paper section 4.2), every figure with its source."""

from touchfield.perception.human import Figure, figure, human

__all__ = ["Figure", "figure", "human"]
