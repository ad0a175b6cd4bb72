"""Make the pages of the gallery: run each narrated script, and set its words, code, output and figures as
Markdown.

    python docs/gallery/build.py [FOLDER]

A script is cells that begin with ``# %%``; the comment lines that open a cell are its words. What a cell
prints follows it, and every PNG that it writes into the folder ``OUT`` is shown after it. The script is also
a script: ``python docs/gallery/figure_2.py FOLDER`` writes the figures alone.
"""

from __future__ import annotations

import contextlib
import io
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
SCRIPTS = (
    "figure_2", "actuator_lowpass", "force_shading", "six_devices", "vibration_with_force", "fewer_numbers",
    "fewest_points", "deformation",
)  # fmt: skip


def cells(text: str) -> list[tuple[str, str]]:
    """The cells of a script: the words, and the code."""
    found = []
    for part in text.split("\n# %%")[1:]:
        lines = part.splitlines()
        words = [lines[0].strip()] if lines[0].strip() else []
        at = 1
        while at < len(lines) and lines[at].startswith("#"):
            words.append(lines[at].removeprefix("#").removeprefix(" "))
            at += 1
        found.append(("\n".join(words), "\n".join(lines[at:]).strip("\n")))
    return found


def page(name: str, folder: Path) -> str:
    """Run one script; its page, with the figures written beside it in `folder`."""
    blocks, seen = [], set(folder.glob("*.png"))
    scope = {"__name__": "__main__", "OUT": folder}
    before = {p: p.stat().st_mtime_ns for p in seen}
    for words, code in cells((HERE / f"{name}.py").read_text()):
        blocks.append(words)
        if not code:
            continue
        said = io.StringIO()
        with contextlib.redirect_stdout(said):
            exec(compile(code, f"{name}.py", "exec"), scope)
        blocks.append(f"```python\n{code}\n```")
        if said.getvalue():
            blocks.append(f"```text\n{said.getvalue().rstrip()}\n```")
        for picture in sorted(folder.glob("*.png")):
            if before.get(picture) != picture.stat().st_mtime_ns:
                before[picture] = picture.stat().st_mtime_ns
                blocks.append(f"![{picture.stem.replace('_', ' ')}]({picture.name})")
    return "\n\n".join(b for b in blocks if b) + "\n"


def main() -> None:
    """Write every page."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else HERE
    folder.mkdir(parents=True, exist_ok=True)
    for name in SCRIPTS:
        (folder / f"{name}.md").write_text(page(name, folder))
        print(f"{folder / name}.md")


if __name__ == "__main__":
    main()
