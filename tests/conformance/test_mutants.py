"""Three decoders report the same for mutants whose CRC-32s hold: the kind of error, or the values."""

from __future__ import annotations

import shutil
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from mutants import compare
from second import CONFORMANCE
from test_c import COMPILER, built

from touchfield.codec.touch.spec import TouchSpec
from touchfield.medium import ForceField, Grid

SEED = 45
MUTANTS = 1500
GRID = Grid((9, 8, 7), (0.01,) * 3, (0.0,) * 3)

pytestmark = pytest.mark.skipif(COMPILER is None, reason="there is no C compiler here")
