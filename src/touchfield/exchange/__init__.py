"""Reads and writes haptic effects in the formats of other tools.

These are HJIF and HMPG (MPEG haptics), AHAP (Apple), .haptic (Meta), .tact (bHaptics) and WAV. A file is read
as an `ImportedEffect`: the drives of an array over time (`ArrayEffect`), and notes on what was not used.

    effect = tf.exchange.read_tact("pattern.tact").effect  # effect.drives: float32 [frames, rows, columns]
"""

from typing import TYPE_CHECKING

from touchfield._lazy import lazy_attributes

if TYPE_CHECKING:
    from touchfield.exchange.ahap import read_ahap
    from touchfield.exchange.effect_files import write_ahap, write_haptic, write_tact, write_wav_array
    from touchfield.exchange.haptic_read import read_haptic
    from touchfield.exchange.hjif_import import read_hjif_array
    from touchfield.exchange.hjif_write import write_hjif_array
    from touchfield.exchange.symbolic import ArrayEffect, ImportedEffect
    from touchfield.exchange.tact_read import read_tact

__all__ = [
    "ArrayEffect",
    "ImportedEffect",
    "read_ahap",
    "read_haptic",
    "read_hjif_array",
    "read_tact",
    "write_ahap",
    "write_haptic",
    "write_hjif_array",
    "write_tact",
    "write_wav_array",
]

_MODULES = {
    "ahap": ("read_ahap",),
    "effect_files": ("write_ahap", "write_haptic", "write_tact", "write_wav_array"),
    "haptic_read": ("read_haptic",),
    "hjif_import": ("read_hjif_array",),
    "hjif_write": ("write_hjif_array",),
    "symbolic": ("ArrayEffect", "ImportedEffect"),
    "tact_read": ("read_tact",),
}
__getattr__ = lazy_attributes(__name__, _MODULES)
