"""Environment of a Python process that a test starts."""

from __future__ import annotations

import os
import sys
from pathlib import Path


def environment_with(folder: Path) -> dict[str, str]:
    """Environment for a child process that imports from `folder` first, then like this process."""
    return os.environ | {"PYTHONPATH": os.pathsep.join([str(folder), *filter(None, sys.path)])}
