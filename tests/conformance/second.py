"""The reference decoder as a module, and the files that both decoders are compared on."""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path
from typing import Any

CONFORMANCE = Path(__file__).resolve().parents[2] / "conformance"
sys.path.append(str(CONFORMANCE))  # the reference decoder imports its parts from here

decoder: Any = importlib.import_module("decoder")
decode_objects: Any = importlib.import_module("decode_objects")
make_golden: Any = importlib.import_module("make_golden")
reading: Any = importlib.import_module("reading")

GOLDEN = sorted((CONFORMANCE / "v1").glob("*.touch"))
FAULTY: dict[str, str] = json.loads((CONFORMANCE / "faulty" / "errors.json").read_text())
