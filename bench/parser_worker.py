"""Reads damaged files in a process of its own, and judges what happened.

A case is right if the reader returns, or raises an error of touchfield whose message is one line that names
the file. It is a fault if

* another exception occurs, or a warning that is not addressed to the user,
* it takes more processor time or memory than the bytes of the input allow, or does not end,
* a file outside the folder of the case is opened, changed or removed, or a socket or process is opened,
* the output exists although the reader failed.
"""

from __future__ import annotations

import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from mutation import OUTSIDE
from parser_formats import Format, formats
from touchfield.errors import InvalidArgument, TouchfieldError

MEBI: Final = 1 << 20
BYTES_PER_BYTE: Final = 1 << 10
SPACE_BYTES: Final = 2 << 30
"""Address space that a case may take beyond that of the process."""
SECONDS_PER_BYTE: Final = 5e-5
PATIENCE_SECONDS: Final = 20.0
"""Processor seconds after which a case is interrupted."""
ALLOWED_FOLDERS: Final = tuple(
    os.path.realpath(path)
    for path in (sys.prefix, sys.base_prefix, Path(__file__).resolve().parents[1], "/proc", "/sys", "/dev")
)
"""Folders whose files may be read: the interpreter, its libraries, touchfield, the system."""


@dataclass(frozen=True)
class Outcome:
    """What happened to a case.

    kind : "read", "refused" or "FAULT".
    text : the message, or what is wrong.
    site : file and line where the error was raised.
    """

    kind: str
    text: str = ""
    site: str = ""
    seconds: float = 0.0
    peak_bytes: int = 0
    input_bytes: int = 0

    def is_over_limits(self, chosen: Format) -> bool:
        """Return True if it took more processor time or memory than its format and its bytes allow."""
        return (
            self.seconds > chosen.free_s + SECONDS_PER_BYTE * self.input_bytes
            or self.peak_bytes > chosen.free_mib * MEBI + BYTES_PER_BYTE * self.input_bytes
        )


class TooLong(BaseException):
    """Raised by the timer."""


# -- watching the files that are opened --------------------------------------------------------------------


class Watch:
    """Records accesses outside the folder of a case."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.is_active, self.found = os.path.realpath(folder), False, list[str]()
        sys.addaudithook(self._hook)

    def _hook(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self.is_active:
            return
        if event == "open":
            path, mode, flags = arguments
            if isinstance(path, str | bytes) and not self._may_open(os.fsdecode(path), mode, flags):
                self.found.append(f"opened {os.fsdecode(path)!r}")
        elif event in ("os.remove", "os.rename", "os.mkdir", "os.rmdir", "os.symlink", "shutil.rmtree"):
            path = arguments[0]
            if isinstance(path, str | bytes) and not self._may_open(os.fsdecode(path), None, os.O_RDWR):
                self.found.append(f"{event} of {os.fsdecode(path)!r}")
        elif event == "subprocess.Popen" and arguments[0] == "uname":  # `platform`, when h5py is imported
            return
        elif event in ("socket.connect", "socket.getaddrinfo", "subprocess.Popen", "os.system", "os.exec"):
            self.found.append(f"{event} {str(arguments)[:100]}")

    def _is_inside(self, path: str) -> bool:
        return _lies_in(path, self.folder)

    def _may_open(self, path: str, mode: str | None, flags: int) -> bool:
        if self._is_inside(path):
            return True
        if os.path.realpath(path) == os.devnull or "__pycache__" in path:  # the cache of compiled loops
            return True
        is_written = bool(flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)) if isinstance(flags, int) else False
        return not is_written and any(_lies_in(path, folder) for folder in ALLOWED_FOLDERS)


def _lies_in(path: str, folder: str) -> bool:
    try:
        real = os.path.realpath(path)
    except ValueError:  # NUL
        return True
    return real == folder or real.startswith(folder + os.sep)


# -- a case ------------------------------------------------------------------------------------------------


class Bench:
    """The folders of one process: an input is written once, and its damaged file restored after each case."""

    def __init__(self, root: Path) -> None:
        self.root, self.inputs = root, dict[tuple[str, int], tuple[Path, dict[Path, bytes]]]()
        self.folder = root / "case"
        self.folder.mkdir()
        self.secret = (self.folder / OUTSIDE).resolve()
        self.secret.parent.mkdir()
        self.secret.write_text("0 0 0\n1 0 0\n0 1 0\n")
        self.temporary = self.folder / "tmp"
        self.temporary.mkdir()
        tempfile.tempdir = os.environ["TMPDIR"] = str(self.temporary)
        self.watch = Watch(self.folder)
        os.chdir(self.temporary)

    def input_of(self, chosen: Format, index: int) -> tuple[Path, dict[Path, bytes]]:
        """Return the path to read of an input, and its files."""
        key = (chosen.name, index)
        if key not in self.inputs:
            folder = self.folder / f"{len(self.inputs)}"
            folder.mkdir()
            path = chosen.seeds[index].write(folder / "input")
            files = {name: name.read_bytes() for name in sorted(folder.rglob("*")) if name.is_file()}
            self.inputs[key] = path, files
        return self.inputs[key]

    def damage(self, chosen: Format, seed: int, number: int) -> tuple[int, Path, bytes | None]:
        """Return the index of an input, the file to damage, and its new bytes; None to remove it."""
        rng = random.Random(f"{chosen.name} {seed} {number}")
        index = rng.randrange(len(chosen.seeds))
        _, files = self.input_of(chosen, index)
        name = rng.choice([name for name in files if chosen.is_damaged(name)] or list(files))
        is_removed = len(files) > 1 and rng.random() < 0.02
        return index, name, None if is_removed else chosen.mutator(name)(files[name], rng)

    def run(self, chosen: Format, seed: int, number: int) -> Outcome:
        """Run a case, and restore its files."""
        index, name, content = self.damage(chosen, seed, number)
        path, files = self.input_of(chosen, index)
        size = sum(map(len, files.values())) - len(files[name]) + len(content or b"")
        rewrite(name, content)
        try:
            outcome = self._judged(chosen, chosen.seeds[index].options, path, size)
            if outcome.is_over_limits(
                chosen
            ):  # the first of its kind may have compiled loops, or imported a library
                outcome = self._judged(chosen, chosen.seeds[index].options, path, size)
            return outcome
        finally:
            self._restore(name, files[name])

    def save(self, chosen: Format, seed: int, number: int, target: Path) -> None:
        """Write the input of a case to a folder."""
        index, name, content = self.damage(chosen, seed, number)
        _, files = self.input_of(chosen, index)
        rewrite(name, content)
        shutil.rmtree(target, ignore_errors=True)
        shutil.copytree(self.folder / name.relative_to(self.folder).parts[0], target)
        self._restore(name, files[name])

    def _restore(self, name: Path, content: bytes) -> None:
        rewrite(name, content)
        for path in self.temporary.iterdir():
            shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()

    def _judged(self, chosen: Format, options: dict[str, Any], path: Path, size: int) -> Outcome:
        out = self.temporary / "out.touch"
        os.utime(self.secret, ns=(0, 10**18))
        self.watch.found.clear()
        with warnings.catch_warnings(record=True) as issued, limited():
            warnings.simplefilter("always")
            reset_peak()
            before, start_s = resident_bytes(), time.process_time()
            try:
                self.watch.is_active = True
                chosen.read(path, out, options)
                outcome = Outcome("read")
            except TouchfieldError as error:
                outcome = judged_error(error, path)
            except (Exception, TooLong) as error:
                outcome = Outcome("FAULT", f"{type(error).__name__}: {error}"[:300], site_of(error))
            finally:
                self.watch.is_active = False
            seconds, peak = time.process_time() - start_s, max(peak_bytes() - before, 0)
        outcome = replace(outcome, seconds=seconds, peak_bytes=peak, input_bytes=size)
        wrong = "" if outcome.kind == "FAULT" else self._wrong(chosen, outcome, out, issued)
        text = f"{wrong}; {outcome.kind} {outcome.text}"[:400]
        return replace(outcome, kind="FAULT", text=text) if wrong else outcome

    def _wrong(
        self, chosen: Format, outcome: Outcome, out: Path, issued: list[warnings.WarningMessage]
    ) -> str:
        """Return what is wrong beside the outcome, or ""."""
        if self.watch.found:
            return self.watch.found[0]
        if self.secret.stat().st_atime_ns:
            return "a library read a file outside the folder"
        if outcome.is_over_limits(chosen):
            took = f"{outcome.seconds:.1f} s and {outcome.peak_bytes / MEBI:.0f} MiB"
            return f"{took} for {outcome.input_bytes} bytes"
        if outcome.kind == "refused" and out.exists():
            return "a file is left"
        for warning in issued:
            if not issubclass(warning.category, QUIET_WARNINGS):
                place = f"{Path(warning.filename).name}:{warning.lineno}"
                return f"{warning.category.__name__}: {warning.message} ({place})"
        return ""


def rewrite(path: Path, content: bytes | None) -> None:
    """Replace a file, or remove it.

    It is removed first: some file systems write a truncated file to the disk at once.
    """
    path.unlink(missing_ok=True)
    if content is not None:
        path.write_bytes(content)


QUIET_WARNINGS: Final = (DeprecationWarning, PendingDeprecationWarning, ResourceWarning, UserWarning)
"""Warnings that are not noise: of libraries to programmers, which are not shown, and to the user."""


def judged_error(error: TouchfieldError, path: Path) -> Outcome:
    """Return the outcome of an error of touchfield."""
    message = str(error)
    names = {part.name for part in (path, *path.parents[:2])} | {p.name for p in path.rglob("*")}
    names |= {p.name for p in path.parent.iterdir()} | {"The source: "}  # there is one, which the user named
    if "\n" in message or not message.isprintable():
        return Outcome("FAULT", f"not one printable line: {message!r}"[:300], site_of(error))
    is_named = any(name in message for name in names)
    if not isinstance(error, InvalidArgument) and not is_named:
        return Outcome("FAULT", f"names no file: {message}"[:300], site_of(error))
    return Outcome("refused", message[:200], site_of(error))


def site_of(error: BaseException) -> str:
    """Return where an error was raised, and the deepest line of touchfield before it."""
    frames = traceback.extract_tb(error.__traceback__)
    ours = [frame for frame in frames if "touchfield" in frame.filename]
    if not frames:
        return ""
    last, own = frames[-1], (ours or frames)[-1]
    site = f"{Path(own.filename).name}:{own.lineno}"
    return site if last is own else f"{site} > {Path(last.filename).name}:{last.lineno}"


# -- limits ------------------------------------------------------------------------------------------------


@contextmanager
def limited() -> Iterator[None]:
    """Interrupt the block after `PATIENCE_SECONDS`."""
    signal.signal(signal.SIGPROF, _interrupt)
    signal.setitimer(signal.ITIMER_PROF, PATIENCE_SECONDS, 1.0)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)


def _interrupt(*_: Any) -> None:
    raise TooLong(f"interrupted after {PATIENCE_SECONDS:g} s")


def reset_peak() -> None:
    """Set the peak of the resident memory to the present one (Linux)."""
    with open("/proc/self/clear_refs", "w") as file:
        file.write("5")


def peak_bytes() -> int:
    """Return the peak of the resident memory since `reset_peak`."""
    with open("/proc/self/status") as file:
        for line in file:
            if line.startswith("VmHWM"):
                return int(line.split()[1]) << 10
    return 0


def resident_bytes() -> int:
    """Return the resident memory."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * resource.getpagesize()


def limit_space() -> None:
    """Limit the address space of this process to what it has and `SPACE_BYTES`."""
    with open("/proc/self/statm") as file:
        used = int(file.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + SPACE_BYTES, resource.RLIM_INFINITY))


# -- the process -------------------------------------------------------------------------------------------


def serve(connection: Any) -> None:
    """Run the cases that come through a pipe, each (format, seed, number), and send their outcomes.

    A format alone is warmed up; "ready" or what is wrong with it is sent. A case with a folder is saved.
    """
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    by_name = {entry.name: entry for entry in formats()}
    with tempfile.TemporaryDirectory(prefix="parsers-") as root:
        bench = Bench(Path(root).resolve())
        while (received := connection.recv()) is not None:
            name, *case = received
            if not case:
                connection.send(warm_up(bench, by_name[name]))
            else:
                connection.send((bench.run if len(case) == 2 else bench.save)(by_name[name], *case))
        os.chdir("/")


def warm_up(bench: Bench, chosen: Format) -> str:
    """Read each valid input once, so that libraries are imported and loops compiled.

    Returns "ready", or why a valid input cannot be read.
    """
    resource.setrlimit(resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    try:
        for index, source in enumerate(chosen.seeds):
            path, _ = bench.input_of(chosen, index)
            chosen.read(path, bench.temporary / "out.touch", source.options)
            (bench.temporary / "out.touch").unlink(missing_ok=True)
    except Exception as error:
        return f"{chosen.name}, input {index}: {type(error).__name__}: {error} ({site_of(error)})"
    limit_space()
    return "ready"
