"""Cards of public haptic data sets, and the command that prints them."""

from __future__ import annotations

import json
import socket
from dataclasses import asdict, replace
from importlib import resources

import pytest

from touchfield import __version__
from touchfield.cli.main import COMMANDS, _exit_code
from touchfield.datasets import DataCard, data_card, data_cards
from touchfield.errors import InvalidArgument


def test_every_card_file_is_listed_once() -> None:
    files = sorted(f.name for f in (resources.files("touchfield.datasets") / "cards").iterdir())
    assert [f"{card.name}.toml" for card in data_cards()] == files
    assert len(files) >= 6


@pytest.mark.parametrize("card", data_cards(), ids=lambda card: card.name)
def test_commands_of_a_card_exist(card: DataCard) -> None:
    for line in card.commands:
        program, name = line.split()[:2]
        assert program == "python" or (program == "touchfield" and name in COMMANDS), line


def test_a_card_without_a_licence_or_with_an_unknown_check_is_refused() -> None:
    card = data_card("penn-hatt")
    with pytest.raises(InvalidArgument, match=r"penn-hatt: licence: found ''"):
        replace(card, licence="")
    with pytest.raises(InvalidArgument, match=r"penn-hatt: verified: found 'guessed'; expected read or doc"):
        replace(card, verified="guessed")


def test_list_and_show_print_the_cards_and_open_no_connection(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*arguments: object, **named: object) -> None:
        raise AssertionError("a connection was opened")

    monkeypatch.setattr(socket.socket, "connect", refuse)
    monkeypatch.setattr(socket, "create_connection", refuse)
    assert _exit_code(["data", "list"]) == 0
    table = capsys.readouterr().out
    assert all(card.name in table for card in data_cards())
    assert _exit_code(["data", "list", "--json"]) == 0
    values = json.loads(capsys.readouterr().out)
    assert values["penn-hatt"]["may_redistribute"] is False
    assert _exit_code(["data", "show", "penn-hatt", "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    expected = json.loads(json.dumps(asdict(data_card("penn-hatt"))))
    assert {**shown, "notes": None} == {**expected, "notes": None, "touchfield": __version__}
    assert _exit_code(["data", "show", "penn-hatt"]) == 0
    text = capsys.readouterr().out
    assert "Models_MATERIAL.xml" in text and "non-profit" in text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["show", "pen-hat"], "NAME: found 'pen-hat'; expected one of cluster-textures"),
        (["show", "pen-hat"], "Did you mean penn-hatt?"),
        (["show"], "NAME: found nothing; expected the name of a data set"),
        (["list", "penn-hatt"], "NAME: found 'penn-hatt'; expected none with list"),
        (["fetch"], "list|show: found 'fetch'; expected list or show"),
    ],
)
def test_errors_name_what_to_type(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _exit_code(["data", *arguments]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1
