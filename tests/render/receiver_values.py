"""Reads values of a receiver by their path, for tests and benchmarks."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from touchfield.render.block import Memory


def value_of(memory: Memory, path: str) -> Any:
    """A copy of a value, such as "state.force.output"."""
    value = memory.receiver
    for name in path.split("."):
        value = value[name]
    return value.copy()


def values_of(struct: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """The path of each number or array in a struct, and a copy of it."""
    for name in struct.dtype.names:
        if struct[name].dtype.names and struct[name].ndim == 0:
            yield from values_of(struct[name], f"{path}{name}.")
        else:
            yield path + name, struct[name].copy()


def differing(first: Memory, second: Memory) -> set[str]:
    """The paths of the values in which two receivers differ."""
    others = dict(values_of(second.receiver))
    return {path for path, value in values_of(first.receiver) if not np.array_equal(value, others[path])}
