"""Reads and writes haptic effects in the formats of other tools.

These are HJIF and HMPG (MPEG haptics), AHAP (Apple), .haptic (Meta), .tact (bHaptics) and WAV.
"""

from touchfield._lazy import lazy_attributes

__getattr__ = lazy_attributes(__name__)
