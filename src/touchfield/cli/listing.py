"""The list of device profiles."""

from __future__ import annotations

import json
import sys

from touchfield.devices import devices

__all__ = ["list_devices"]


def list_devices(as_json: bool, verbose: bool) -> None:
    """Print the profiles: what a device can show, and where each figure comes from."""
    raise NotImplementedError
