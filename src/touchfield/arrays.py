"""Type aliases for NumPy arrays, fast lengths of vectors, and base classes for dataclasses that have arrays
as fields. The whole package uses them."""

from dataclasses import fields
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

Bools = NDArray[np.bool_]
UInt8s = NDArray[np.uint8]
Int32s = NDArray[np.int32]
Int64s = NDArray[np.int64]
Float32s = NDArray[np.float32]
Float64s = NDArray[np.float64]


def lengths_of(vectors: NDArray[Any]) -> NDArray[Any]:
    """Return the lengths [...] of vectors [..., 3]; two to six times as fast as `numpy.linalg.norm`."""
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    return np.asarray(np.sqrt(x * x + y * y + z * z))


class Picklable:
    """Base of a dataclass that is copied and pickled by its fields, as a `MappingProxyType` cannot be."""

    def __reduce__(self) -> tuple[Any, ...]:
        instance: Any = self
        values = [getattr(self, f.name) for f in fields(instance)]
        return type(self), tuple(dict(v) if isinstance(v, MappingProxyType) else v for v in values)


class EqualByValue:
    """Base of a dataclass with arrays (``eq=False``): equal if the class and all fields are equal."""

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        instance: Any = self
        return all(np.array_equal(getattr(self, f.name), getattr(other, f.name)) for f in fields(instance))

    __hash__ = None  # type: ignore[assignment]
