"""Haptic effects in files of other tools: HJIF and HMPG (MPEG haptics), AHAP, .haptic and .tact (bHaptics),
WAV.
"""

from touchfield._lazy import lazy_attributes

__getattr__ = lazy_attributes(__name__)
