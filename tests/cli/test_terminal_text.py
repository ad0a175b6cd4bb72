"""Text from files on a terminal: it rewrites nothing, and shows in the order in which it is written."""

from __future__ import annotations

import unicodedata
from dataclasses import replace
from pathlib import Path

import pytest

from live_makers import medium
from touchfield.cli.main import _exit_code
from touchfield.cli.output import Answer, echo, literal_console, show_table
from touchfield.errors import SourceError, printable
from touchfield.pipeline import encode

HOSTILE = "a\u202eb\u2066c\u2069d\u200fe\u061cf\x1b[2Jg\rh\x9bi\u2028j\ufeffk"
SHOWN = r"a\u202eb\u2066c\u2069d\u200fe\u061cf\x1b[2Jg\rh\x9bi\u2028j\ufeffk"


def is_harmless(text: str) -> bool:
    return not any(
        unicodedata.category(c) in ("Cc", "Cf", "Zl", "Zp", "Cs") and c not in "\n\t\u200c\u200d"
        for c in text
    )


def test_characters_that_change_a_line_are_shown_as_escapes() -> None:
    assert printable(HOSTILE) == SHOWN and not is_harmless(HOSTILE)
    for text in ("plain", "two\n\tlines", "na\u200cme \u3000\u00a0 \U0001f469\u200d\U0001f52c", "שלום", ""):
        assert printable(text) == text
    every = "".join(map(chr, range(0x3000))) + "\U000e0001\ud800"
    assert is_harmless(printable(every)) and len(printable(every)) > len(every)
    assert "\u202e" not in str(SourceError("a\u202eb"))


def test_tables_titles_and_notes_show_printable_text(capsys: pytest.CaptureFixture[str]) -> None:
    Answer({"name": HOSTILE, "list": [HOSTILE], "map": {HOSTILE: 1.0}}, HOSTILE, (HOSTILE,)).show()
    show_table([(HOSTILE, HOSTILE)], (HOSTILE, "b"), HOSTILE)
    literal_console().print(HOSTILE)
    echo(HOSTILE)
    echo(HOSTILE, to_stderr=True)
    Answer({"name": HOSTILE}, "").show(as_json=True)
    shown = capsys.readouterr()
    text = shown.out + shown.err
    assert is_harmless(text) and text.replace("\n", "").count("u2066") >= 11


def test_commands_show_names_and_texts_of_files_harmlessly(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A title, tags and axes in a file, and the name of the file; in results, warnings and errors."""
    text = "x\u202eright\u2066, y up"
    path = tmp_path / "r\u202etl\x1b[2J.touch"
    encode(replace(medium(), axes=text, tags=("a\u202eb",)), path)
    broken = tmp_path / "b\u202ead.touch"
    broken.write_bytes(path.read_bytes()[:99])
    for command, code in (
        (("info", f"{path}"), 0),
        (("decode", f"{path}", f"{tmp_path / 'o'}\u202e.npz"), 0),
        (("index", f"{tmp_path}"), 0),
        (("search", f"{tmp_path}", f"{path}"), 0),
        (("info", f"{broken}"), 1),
        (("info", f"{tmp_path / 'no'}\u202e"), 1),
        (("info", f"{path}", "--x\u202ey"), 2),
    ):
        done = _exit_code(list(command))
        shown = capsys.readouterr()
        assert is_harmless(shown.out + shown.err) and "\\u202e" in shown.out + shown.err, command
        assert done == code, command
