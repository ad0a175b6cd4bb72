"""Formats counts, entropies and percentages for the tables of section 5.1."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from touchfield.measure.quantity import Quantity

__all__ = ["bits", "count", "counted", "percent"]


def count(value: float) -> str:
    """A number of samples: all digits of a small one, four of a large one."""
    if value < 1e6:
        return f"{value:.0f}"
    mantissa, _, exponent = f"{value:.3e}".partition("e")
    return f"{mantissa.rstrip('0').rstrip('.')}·10^{int(exponent)}"


def counted(quantity: Quantity) -> str:
    """An estimated number of samples with half its interval, as a share."""
    i = quantity.interval
    if i is None or not quantity.value:
        return count(quantity.value)
    return f"{count(quantity.value)} ± {percent((i.high - i.low) / 2 / quantity.value)}"


def bits(quantity: Quantity) -> str:
    """Bits a sample, and half the interval."""
    i = quantity.interval
    spread = "" if i is None else f" ± {(i.high - i.low) / 2:.2g}"
    return f"{quantity.value:.3g}{spread}" if quantity.value < 1 else f"{quantity.value:.2f}{spread}"


def percent(share: float) -> str:
    """A share to two digits, or three near the whole."""
    return f"{100 * share:.3g} %" if share > 0.98 else f"{100 * share:.2g} %"
