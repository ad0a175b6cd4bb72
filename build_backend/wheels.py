"""Builds the wheels of all platforms and checks each: python build_backend/wheels.py FOLDER

As many are built at a time as there are cores. The stable ABI is checked by abi3audit, and the glibc version
of Linux wheels by auditwheel. A wheel appears in the folder once its checks have passed; those that are there
are not built again.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable
from concurrent.futures import FIRST_EXCEPTION, Future, ThreadPoolExecutor, wait
from functools import partial
from importlib.util import find_spec
from pathlib import Path

from compiler import ROOT
from targets import WHEEL_PLATFORMS

TOOLS = ("abi3audit", "auditwheel", "hatchling", "ziglang")
"""Modules that build and check the wheels."""

Task = Callable[[], object]


def missing_tools(modules: Iterable[str], target: str) -> list[str]:
    """Return a line if modules are not installed in this Python; ``make target`` installs them."""
    missing = [module for module in modules if find_spec(module) is None]
    if not missing:
        return []
    return [
        f"{sys.executable}: found no {', '.join(missing)}; expected tools of the release. "
        f"Run `make {target}`, which installs them"
    ]


def run(command: Iterable[str | Path], cwd: str | Path = ROOT, **variables: str) -> str:
    """Run a command; print it, and its output once it has ended: other commands run at the same time.

    Returns the output.

    `variables` are added to the environment. Raises `subprocess.CalledProcessError` if the command fails.
    """
    parts = [str(part) for part in command]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"} | variables
    shown = _shown(parts)
    print(f"+ {shown}", flush=True)
    done = subprocess.run(
        parts,
        cwd=cwd,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    if done.stdout:
        print(f"= {shown}\n{done.stdout}", end="", flush=True)
    if done.returncode:
        raise subprocess.CalledProcessError(done.returncode, parts)
    return done.stdout


def run_all(tasks: Iterable[Task]) -> None:
    """Run tasks, as many at a time as there are cores; the first error ends the run."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        try:
            futures: list[Future[object]] = [pool.submit(task) for task in tasks]
            done, _ = wait(futures, return_when=FIRST_EXCEPTION)
        finally:  # also if the user interrupts
            pool.shutdown(wait=False, cancel_futures=True)
    for future in done:
        future.result()


def build_wheel(folder: Path, target: str, tag: str) -> None:
    """Build and check the wheel of one platform, unless `folder` has it."""
    if any(folder.glob(f"*-cp311-abi3-{tag}.whl")):
        print(f"{target}: the wheel is there", flush=True)
        return
    with tempfile.TemporaryDirectory(dir=folder, prefix=".wheel-") as unchecked:
        command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
        run([*command, "--wheel-dir", unchecked, ROOT], TOUCHFIELD_TARGET=target)
        (wheel,) = Path(unchecked).glob(f"*-cp311-abi3-{tag}.whl")
        run([sys.executable, "-m", "abi3audit", "--strict", "--summary", wheel])
        if "linux-gnu" in target:  # a musl wheel can only be resolved on a system with musl
            report = run([sys.executable, "-m", "auditwheel", "show", "--json", wheel])
            if fault := glibc_fault(wheel.name, json.loads(report[report.index("{") :])["overall_tag"]):
                sys.exit(fault)
        wheel.rename(folder / wheel.name)


def glibc_fault(wheel: str, needed: str) -> str | None:
    """Return a line if a wheel needs a newer glibc, or another machine, than its name states; else `None`.

    `needed` is auditwheel's tag of the oldest system on which it runs, such as ``manylinux_2_17_x86_64``.
    """
    pattern = r"manylinux_(\d+)_(\d+)_(\w+)"
    stated, found = re.search(pattern, wheel.replace(".", " ")), re.fullmatch(pattern, needed)
    is_machine = stated and found and found[3] == stated[3]
    if is_machine and (int(found[1]), int(found[2])) <= (int(stated[1]), int(stated[2])):
        return None
    return f"{wheel}: auditwheel found that it needs {needed}; expected what its name states"


def wheel_tasks(folder: Path) -> list[Task]:
    """Return a task for the wheel of each platform."""
    return [partial(build_wheel, folder, target, tag) for target, tag in WHEEL_PLATFORMS.items()]


def main(folder: Path) -> None:
    """Build and check the wheels into `folder`; stop at the first failure."""
    if faults := missing_tools(TOOLS, "wheels"):
        sys.exit("\n".join(faults))
    folder.mkdir(parents=True, exist_ok=True)
    run_all(wheel_tasks(folder))


def main_of_command(command: Task) -> None:
    """Run a command of the Makefile; end the program with one line if a tool fails or the user interrupts."""
    try:
        command()
    except subprocess.CalledProcessError as error:
        sys.exit(
            f"failed with status {error.returncode}: {_shown(error.cmd)}\n"
            "Its output is above, behind the same command with = before it. The folder is incomplete"
        )
    except KeyboardInterrupt:
        sys.exit("interrupted; the folder is incomplete, and the same command goes on from there")


def _shown(command: Iterable[str]) -> str:
    """Return a command as it is printed: without programs of several lines."""
    return " ".join(part for part in command if "\n" not in part)


if __name__ == "__main__":
    main_of_command(lambda: main(Path(sys.argv[1]).resolve()))
