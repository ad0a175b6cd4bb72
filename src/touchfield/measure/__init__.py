"""Measures: fidelity (paper eq. 10 and the mask), rate (eq. 9) and entropies (section 3.1)."""
