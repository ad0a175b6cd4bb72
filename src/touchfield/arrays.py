"""Names of arrays by the type of their elements; annotations give the shape in words. Lengths of vectors."""

from dataclasses import fields
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

Bools = NDArray[np.bool_]
Int32s = NDArray[np.int32]
Int64s = NDArray[np.int64]
Float32s = NDArray[np.float32]
Float64s = NDArray[np.float64]


def lengths_of(vectors: NDArray[Any]) -> NDArray[Any]:
    """Lengths [...] of vectors [..., 3]: `numpy.linalg.norm`, two to six times as fast along so short an
    axis.
    """
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    return np.asarray(np.sqrt(x * x + y * y + z * z))


class Travels:
    """Base of a dataclass made anew of its fields where it is copied or pickled: a read-only mapping cannot
    be.
    """

    def __reduce__(self) -> tuple[Any, ...]:
        mine: Any = self
        values = [getattr(self, f.name) for f in fields(mine)]
        return type(self), tuple(dict(v) if isinstance(v, MappingProxyType) else v for v in values)


class EqualByValue:
    """Base of a dataclass with arrays (and ``eq=False``): equal to one of its class whose fields are all
    equal.
    """

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        mine: Any = self
        return all(np.array_equal(getattr(self, f.name), getattr(other, f.name)) for f in fields(mine))

    __hash__ = None  # type: ignore[assignment]
