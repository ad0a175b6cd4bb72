"""Compiled code of the renderer: it computes the force on the hand at each tick. Imported only when first
needed, because it imports numba."""
