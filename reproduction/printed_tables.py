"""Checks the figures that the paper prints in tables 1 and 2 against each other, by an identity that
entropies must fulfil.

A field of which a share p holds a force, and whose empty space is one symbol, has H_voxel = h2(p) + p
H_object: the empty samples tell where the object is, and the others what it is. The printed entropies are not
on this curve.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

from reproduction.experiment import markdown_table
from touchfield.measure.estimators import binary_entropy_bits

__all__ = ["PRINTED_1", "PRINTED_2", "PrintedScene", "density_needed", "identity", "identity_table"]


@dataclass(frozen=True)
class PrintedScene:
    """One scene's two columns of a printed table.

    Attributes
    ----------
    nominal : (float, float)
        Samples, voxel and object, "Size (1st frame)".
    on_device : (float or None, float)
        "Device filter (1st frame)"; None for what the text copy of the paper lost.
    entropy : (float or None, float)
        Bits a sample, "Entropy (1st frame)".
    """

    nominal: tuple[float, float]
    on_device: tuple[float | None, float]
    entropy: tuple[float | None, float]


PRINTED_1: Final = {
    "scene1": PrintedScene((1e12, 2.2e7), (8e9, 1.8e5), (1.2, 2.3)),
    "scene2": PrintedScene((1e12, 6.5e10), (8e9, 5.5e8), (3.7, 5.2)),
}
PRINTED_2: Final = {
    "scene1": PrintedScene((1e12, 2.2e7), (None, 64), (None, 4.6)),
    "scene2": PrintedScene((1e12, 6.5e10), (1024, 672), (1.9, 3.1)),
}


def identity(p: float, object_bits: float) -> float:
    """H_voxel = h2(p) + p H_object."""
    return binary_entropy_bits(p) + p * object_bits


def density_needed(voxel_bits: float, object_bits: float) -> float | None:
    """The least p of the identity for a pair of entropies; None where no p gives as much.

    h2(p) + p H rises until p = 2^H/(1 + 2^H), where it is log2(1 + 2^H).
    """
    top = 1 / (1 + math.exp2(-object_bits))
    if voxel_bits > identity(top, object_bits):
        return None
    low, high = 0.0, top
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if identity(middle, object_bits) < voxel_bits else (low, middle)
    return high


def identity_table(
    printed: dict[str, PrintedScene], numbers: dict[str, str]
) -> tuple[str, list[dict[str, Any]]]:
    """The identity for the printed figures, in Markdown and as data.

    Parameters
    ----------
    printed : dict
    numbers : dict
        What each scene is called. p is that of the sizes after the device filter.
    """
    rows, data = [], []
    for key, name in numbers.items():
        one = printed[key]
        sizes = one.on_device
        voxel_bits, object_bits = one.entropy
        if voxel_bits is None or sizes[0] is None:
            continue
        p = sizes[1] / sizes[0]
        follows, needed = identity(p, object_bits), density_needed(voxel_bits, object_bits)
        rows.append(
            [
                name,
                f"{p:.2g}",
                f"{object_bits}",
                f"{voxel_bits}",
                f"{follows:.3g}",
                "none" if needed is None else f"{needed:.2f}",
            ]
        )
        data.append(
            {
                "scene": key,
                "p": p,
                "object_bits": object_bits,
                "voxel_bits": voxel_bits,
                "follows": follows,
                "p_needed": needed,
            }
        )
    head = [
        "printed",
        "p of the sizes",
        "H_object",
        "H_voxel",
        "h2(p) + p H_object",
        "p that would be needed",
    ]
    return markdown_table(head, rows), data
