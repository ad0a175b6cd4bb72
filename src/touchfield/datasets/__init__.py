"""Cards of public haptic data sets: what each holds, its origin, licence and size, and how it is read.

A card is a TOML file in ``datasets/cards``. Nothing is downloaded, and no data are included.
"""

from typing import TYPE_CHECKING

from touchfield._lazy import lazy_attributes

if TYPE_CHECKING:
    from touchfield.datasets.card import DataCard, data_card, data_cards

__all__ = ["DataCard", "data_card", "data_cards"]

__getattr__ = lazy_attributes(__name__, {"card": ("DataCard", "data_card", "data_cards")})
