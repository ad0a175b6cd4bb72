"""Hook that hatchling calls when it builds a wheel: compiles `touchfield._native` and names the wheel after
its platform."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

sys.path.insert(0, str(Path(__file__).parent))

from compiler import ROOT, NoCompiler, compile_module
from targets import WHEEL_PLATFORMS

_PACKAGE = ROOT / "src" / "touchfield"


class NativeModule(BuildHookInterface):
    """Compiles into the package; the build fails if there is no compiler, or it refuses the source.

    ``TOUCHFIELD_TARGET`` names a target of `targets.WHEEL_PLATFORMS` to compile for, by default this machine.
    The module of an editable install lies in the source tree; that of a wheel does not touch the tree.
    """

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        target = os.environ.get("TOUCHFIELD_TARGET") or None
        is_editable = version == "editable"
        if is_editable:
            for old in [*_PACKAGE.glob("_native*.so"), *_PACKAGE.glob("_native*.pyd")]:
                old.unlink()
        folder = _PACKAGE if is_editable else self._temporary_folder()
        try:
            path = compile_module(folder, target)
        except (NoCompiler, OSError, subprocess.CalledProcessError) as error:
            raise SystemExit(
                f"touchfield: the compiled module touchfield._native cannot be built: {error}. Install a C "
                "compiler, or `pip install ziglang`, and install touchfield again; or install a wheel."
            ) from error
        build_data["pure_python"] = False
        if is_editable:
            build_data["artifacts"].append(path.relative_to(ROOT).as_posix())
        else:
            build_data["force_include"][str(path)] = f"touchfield/{path.name}"
        build_data["tag"] = f"cp311-abi3-{WHEEL_PLATFORMS[target] if target else _this_platform()}"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        if self._temporary is not None:
            shutil.rmtree(self._temporary)

    _temporary: Path | None = None

    def _temporary_folder(self) -> Path:
        self._temporary = Path(tempfile.mkdtemp())
        return self._temporary


def _this_platform() -> str:
    """Platform tag of a wheel that is built for this machine alone."""
    if sys.platform == "darwin":
        major, minor = [*platform.mac_ver()[0].split("."), "0"][:2]
        return f"macosx_{major}_{minor if major == '10' else 0}_{platform.machine()}"
    return sysconfig.get_platform().replace("-", "_").replace(".", "_")
