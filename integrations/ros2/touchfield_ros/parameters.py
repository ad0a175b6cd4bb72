"""Parameters of a node, of the types of their defaults."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node

from touchfield.errors import InvalidArgument

EXPECTED = {str: "a text", bool: "true or false", float: "a finite number"}
MINIMUMS = {"rate_hz": 1.0, "silence_s": 0.0}
"""Of numbers that nothing else checks."""


def read_parameters(node: Node, defaults: Mapping[str, Any]) -> dict[str, Any]:
    """Declare parameters and return their values.

    A number without a point, as in `force_max_n:=3`, is taken as a float.

    Raises InvalidArgument if a value has another type than the default, or is out of range.
    """
    values = {}
    for name, default in defaults.items():
        node.declare_parameter(name, default, ParameterDescriptor(dynamic_typing=True))
        value = node.get_parameter(name).value
        if isinstance(default, float) and type(value) is int:
            value = float(value)
        if type(value) is not type(default) or (isinstance(value, float) and not math.isfinite(value)):
            raise InvalidArgument(f"the parameter {name}", repr(value), EXPECTED[type(default)])
        if name in MINIMUMS and value < MINIMUMS[name]:
            raise InvalidArgument(f"the parameter {name}", repr(value), f"at least {MINIMUMS[name]:g}")
        values[name] = value
    return values
