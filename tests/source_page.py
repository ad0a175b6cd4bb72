"""Writes docs/sources.md, a page with the command and a sample of the files of every layout that is read.

    python tests/source_page.py

The samples are the files that the writers of `source_corpus` write; a test compares the page with them.
"""

from __future__ import annotations

import re
import tempfile
from importlib.util import find_spec
from pathlib import Path

from PIL import Image

from source_corpus import CORPUS, Input

PAGE = Path(__file__).resolve().parents[1] / "docs" / "sources.md"
WIDTH, LINES, DIGITS = 100, 2, 6
TEXTS = re.compile(
    r"\.(txt|csv|json|log|xml|toml|urdf|obj|off|asc|gltf|dae|usda|step|freiburg|tact|ahap|vti|pgw|pcd|ply)"
)
PICTURES = {"I;16": "16 bits", "I;16B": "16 bits", "L": "8 bits", "F": "32-bit floats", "RGB": "colour"}
SECTIONS = {
    "depth": ("Depth sequences", "[Depth sequences](depth-sequences.md) says what is taken from each file."),
    "heights": ("Heights", "Row 0 is north, unless the file says otherwise. Degrees become metres."),
    "mesh": ("Meshes", "[Meshes](moving-scenes.md#meshes) says how holes, shells and overlaps are treated."),
    "model": ("Animated models", "[Animated models](moving-scenes.md#animated-models)."),
    "shapes": ("Shapes and bodies", "[Rigid bodies](moving-scenes.md#rigid-bodies-toml-or-mjcf)."),
    "field": ("Stored fields", "The forces are used as they are."),
    "recorded": ("Recorded contacts", "[Recorded contacts](exchange.md#import-recorded-contacts)."),
    "video": ("Video", "For arrays of actuators: what catches the eye is driven."),
    "effect": ("Effects", "[Effects](exchange.md#import-effects) of vibration, for arrays."),
    "foreign": (
        "Formats of other programs",
        "Read, or refused in one line with the command that converts them, depending on what is installed.",
    ),
}
JOINED = {"bodies": "shapes"}
HEAD = """# Samples of every source
Every layout that is read, with what to type and the beginning of its files. They show a room, a hill or a
cube of 1 m, and are written by `tests/source_page.py`, which writes this page, too. `touchfield sources`
lists the kinds. `python bench/bench_sources.py` brings every sample in and measures what came in, along with
wrong inputs and the fixes that their messages name.
"""


def section_of(entry: Input) -> str:
    """Return the key of the section of an input."""
    first = entry.kind.partition(":")[0].partition(",")[0].partition(" contacts")[0]
    return "foreign" if entry.is_foreign else JOINED.get(first, first)


def page(folder: Path) -> str:
    """Return the page; the samples are written into a folder."""
    parts = [HEAD]
    layouts = [entry for entry in CORPUS if entry.is_layout]
    for key, (title, text) in SECTIONS.items():
        parts.append(f"## {title}\n{text}\n")
        parts += [sample(entry, folder / entry.name) for entry in layouts if section_of(entry) == key]
    return "\n".join(parts)


def sample(entry: Input, folder: Path) -> str:
    """Return the part of one input: title, command and files."""
    source = entry.write(folder)
    given = source.relative_to(folder).as_posix() if source != folder else "FOLDER"
    typed = " ".join(["touchfield", entry.command, given, "OUT.touch", *entry.options])
    _, _, title = entry.kind.partition(": ")
    name = title if title and title[0].isupper() else f"{title or entry.kind}"
    head = f"### {name[0].upper()}{name[1:]} ({entry.name})"
    return f"{head}\n```sh\n{typed}\n```\n```text\n{files_of(folder)}\n```\n"


def files_of(folder: Path) -> str:
    """Return one file of each sort with its first lines, and how many there are of the sort."""
    sorts: dict[tuple[str, str], list[Path]] = {}
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        relative = path.relative_to(folder)
        key = re.sub(r"\d+", "0", relative.as_posix())
        sorts.setdefault((relative.parent.as_posix(), key), []).append(path)
    lines = []
    for paths in sorts.values():
        more = f" (and {len(paths) - 1} more)" if len(paths) > 1 else ""
        name = paths[0].relative_to(folder).as_posix()
        text = beginning(paths[0])
        lines.append(f"{name}{more}{text}" if text.startswith("\n") else f"{name}{more}: {text}".rstrip(": "))
    return "\n".join(lines)


def beginning(path: Path) -> str:
    """Return the first lines of a text, or what a picture holds; nothing for other files."""
    if path.suffix in (".png", ".jpg", ".pgm", ".gif", ".tif"):
        if not path.stat().st_size:
            return "any picture"
        with Image.open(path) as image:
            pages = getattr(image, "n_frames", 1)
            several = f", {pages} pages" if pages > 1 else ""
            return f"{image.width} x {image.height} pixels, {PICTURES.get(image.mode, image.mode)}{several}"
    data = path.read_bytes()
    if not TEXTS.fullmatch(path.suffix) or b"\0" in data[:400]:
        return ""
    shown = [shortened(line) for line in data[:4000].decode("utf-8", "replace").splitlines()[:LINES]]
    indent = "\n    "
    return indent + indent.join(shown) if shown else ""


def shortened(line: str) -> str:
    """Return a line with numbers of at most `DIGITS` digits behind the point, cut to `WIDTH`."""
    line = re.sub(r"-?\d+\.\d{7,}(?:e[-+]?\d+)?", lambda match: f"{float(match[0]):.{DIGITS}g}", line)
    line = re.sub(r"(?<![\w.])-0(?![\w.])", "0", line)
    return line if len(line) <= WIDTH else f"{line[: WIDTH - 4]} ..."


def main() -> None:
    """Write the page."""
    missing = [entry.name for entry in CORPUS if entry.is_layout and not entry.is_available]
    if missing or find_spec("scipy") is None:
        raise SystemExit(f"libraries for {', '.join(missing)} are missing")
    with tempfile.TemporaryDirectory() as folder:
        PAGE.write_text(page(Path(folder)))


if __name__ == "__main__":
    main()
