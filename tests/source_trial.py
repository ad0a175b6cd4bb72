"""Bring an input in as a user would: run the command and, once, the fix that its message names.

The outcome is text that begins with "read" (right at the first try), "noted" (read, with a note that names a
fix), "refused" (in one line that names a fix), or `WRONG`. A fix is an option, a command of another program,
or the file without its damage, and counts only if what comes in then is right. Programs that are not
installed are named as not run.
"""

from __future__ import annotations

import io
import re
import shlex
import shutil
import subprocess
import sys
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import scene_makers as scenes
from source_corpus import Input
from touchfield.cli.main import _exit_code

WRONG = "WRONG"
CONVERSIONS = "Convert it|Expand it|For their own times|Make a surface of it|Decode it"


@dataclass(frozen=True)
class Outcome:
    """What happened: text, error over the allowed one (None without a file), comment, and first message."""

    text: str
    error: float | None
    comment: str
    message: str

    @property
    def is_right(self) -> bool:
        return not self.text.startswith(WRONG)


def run(command: str, source: Path, out: Path, options: tuple[str, ...]) -> tuple[int, str]:
    """Run a command of touchfield in the folder of the source; return its exit code and what it reports."""
    out.unlink(missing_ok=True)
    report = io.StringIO()
    with chdir(source.parent), redirect_stderr(report), redirect_stdout(report):
        code = _exit_code([command, source.name, str(out), *options])
    return code, report.getvalue()


def try_input(entry: Input, folder: Path, nw: int) -> Outcome:
    """Write an input, run the command and, once, the fix that its message names."""
    source, out = entry.write(folder / "input"), folder / "out.touch"
    options = (*entry.options, *(() if _is_array(entry) else ("--nw", str(nw))))
    code, report = run(entry.command, source, out, options)
    if code and not (report.startswith("touchfield: ") and report.count("\n") == 1):
        return Outcome(f"{WRONG}: more than one line", None, "", report)
    if not code:
        error, comment = entry.truth(out)
        if error <= 1:
            return Outcome("read", error, comment, report)
        first = f"noted ({comment})"
    else:
        first = "refused"
    fix, mended = follow(entry, source, report)
    if not fix:
        return Outcome(f"{WRONG}: {first}, and no fix is named", None, "", report)
    if mended is None:
        return Outcome(f"{first}; fix not run here: {fix}", None, "", report)
    code, again = run(entry.command, mended[0], out, (*options, *mended[1]))
    if code:
        return Outcome(f"{WRONG}: {first}; the fix {fix} was refused", None, "", report + again)
    error, comment = entry.truth(out)
    text = f"{first}; fix: {fix}" if error <= 1 else f"{WRONG}: {first}; the fix {fix} gives {comment}"
    return Outcome(text, error, comment, report)


def _is_array(entry: Input) -> bool:
    return entry.command == "import" or "--device" in entry.options


def follow(entry: Input, source: Path, report: str) -> tuple[str, tuple[Path, tuple[str, ...]] | None]:
    """Do what a message says: return the fix, and the source and options to run.

    The fix is empty if the message names none; source and options are None if it cannot be run here.
    """
    if match := re.search(rf"(?:{CONVERSIONS}): (.*), then encode (\S+)", report):
        return converted(match[1], match[2].rstrip("."), source)
    if match := re.search(r"Convert it: (gunzip .*)\.?$", report.strip()):
        return converted(match[1].rstrip("."), source.stem, source)
    if match := re.search(r"--pose-form [\w,]+|--unit-m [\d.e-]+|--depth-scale [\d.e-]+ \(", report):
        words = match[0].rstrip(" (").split()
        return " ".join(words), (source, tuple(words))
    if match := re.search(r"pip install \W*(touchfield\[\w+\])", report):
        return f"{match[1]} (not installed here)", None
    asked = [option for option in entry.answers if option in report]
    if entry.mended is not None and re.search(
        r"[Cc]opy|Check the file|Export it again|[Gg]ive the pictures|Unpack|Convert it to|Name a", report
    ):
        scenes.remove(source if source.is_dir() else source.parent)
        whole = entry.mended(source.parent / "mended" if source.is_dir() else source.parent)
        known = tuple(word for option in asked for word in (option, entry.answers[option]))
        return "the whole file", (whole, known)
    if asked:
        words = [word for option in asked for word in (option, entry.answers[option])]
        return " ".join(asked), (source, tuple(words))
    return "", None


def converted(command: str, to: str, source: Path) -> tuple[str, tuple[Path, tuple[str, ...]] | None]:
    """Run a conversion if its programs are installed; nothing is installed. The result is as of `follow`."""
    names = re.findall(r"pip install '?([\w.\[\]-]+)'?", command)
    modules = [re.sub(r"\[.*", "", name) for name in names]
    rest = re.sub(r"pip install [^;]*; ", "", command)
    missing = [name for name in modules if find_spec(name) is None]
    program = shlex.split(rest)[0]
    fix = f"{names[0]}" if names else program
    if missing or (program not in ("python", "mkdir") and shutil.which(program) is None) or program == "npx":
        return f"{fix} (not installed here)", None
    if program == "python":
        rest = rest.replace("python", shlex.quote(sys.executable), 1)
    done = subprocess.run(rest, shell=True, cwd=source.parent, capture_output=True, text=True)
    if re.search("ImportError|ModuleNotFoundError", done.stderr):
        return f"{fix} (not installed here)", None
    if done.returncode:
        return "", None
    path = source.parent / to
    inside = sorted(path.iterdir()) if path.is_dir() else [path]
    return fix, (inside[0] if len(inside) == 1 else path, ())
