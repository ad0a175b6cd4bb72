"""Builds the wheels of all platforms and checks each: python build_backend/wheels.py FOLDER

The stable ABI is checked by abi3audit, and the glibc version of Linux wheels by auditwheel.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from compiler import ROOT
from targets import WHEEL_PLATFORMS


def main(folder: Path) -> None:
    """Build and check the wheels into `folder`; stop at the first failure."""
    folder.mkdir(parents=True, exist_ok=True)
    for target, tag in WHEEL_PLATFORMS.items():
        print(f"== {target}", flush=True)
        command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
        environment = os.environ | {"TOUCHFIELD_TARGET": target}
        subprocess.run([*command, "--wheel-dir", str(folder), str(ROOT)], env=environment, check=True)
        (wheel,) = folder.glob(f"*-cp311-abi3-{tag}.whl")
        subprocess.run([sys.executable, "-m", "abi3audit", "--strict", "--summary", str(wheel)], check=True)
        if "linux-gnu" in target:  # a musl wheel can only be resolved on a system with musl
            subprocess.run([sys.executable, "-m", "auditwheel", "show", str(wheel)], check=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
