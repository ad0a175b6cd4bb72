"""Environment of a Python process that a test starts."""

from __future__ import annotations

import os
import sys
from pathlib import Path


def environment_with(folder: Path) -> dict[str, str]:
    """This process's environment, in which a child imports from `folder` first, then as this process does."""
    return os.environ | {"PYTHONPATH": os.pathsep.join([str(folder), *filter(None, sys.path)])}
