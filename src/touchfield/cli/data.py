"""The command `data`: cards of public haptic data sets. It downloads nothing."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from touchfield.cli.main import command
from touchfield.cli.output import Answer, literal_console, show_table
from touchfield.errors import InvalidArgument, require_one_of

if TYPE_CHECKING:
    from touchfield.datasets import DataCard

_ACTIONS = ("list", "show")


@command("Set up", "data list", "data show penn-hatt")
def data(
    action: Annotated[str, typer.Argument(help="list, or show.", metavar="list|show")] = "list",
    name: Annotated[str | None, typer.Argument(help="With show: name of the data set.")] = None,
) -> Answer:
    """List public haptic data sets with licence, size and origin, or show the card of one."""
    from touchfield.datasets import data_card, data_cards

    require_one_of("list|show", action, _ACTIONS)
    if action == "show":
        if name is None:
            raise InvalidArgument("NAME", "nothing", "the name of a data set", "touchfield data list")
        card = data_card(name)
        return Answer(asdict(card), card.title, print_text=lambda: _print_card(card))
    if name is not None:
        raise InvalidArgument("NAME", repr(name), "none with list", f"touchfield data show {name}")
    cards = data_cards()
    return Answer({card.name: asdict(card) for card in cards}, "", print_text=lambda: _print_table(cards))


def _print_table(cards: tuple[DataCard, ...]) -> None:
    rows = [
        (card.name if label == "what" else "", label, text)
        for card in cards
        for label, text in (
            ("what", card.what),
            ("size", card.size),
            ("licence", card.licence),
            ("cite", card.cite),
        )
    ]
    show_table(rows, ("name", "", ""), "public haptic data sets", unbroken=2)
    literal_console().print("layout, origin and commands: touchfield data show NAME. Nothing is downloaded.")


def _print_card(card: DataCard) -> None:
    console = literal_console()
    console.print(card.title, style="bold", soft_wrap=True)
    passed_on = "yes" if card.may_redistribute else "no"
    show_table(
        (
            ("what", card.what),
            ("purpose", card.purpose),
            ("size", card.size),
            ("licence", card.licence),
            ("may be passed on", passed_on),
            ("origin", card.origin),
            ("get it", card.get),
            ("cite", card.cite),
            ("verified", f"{card.verified}: {card.check}"),
            ("not read", card.not_read),
        )
    )
    for heading, lines in (("layout", card.layout.splitlines()), ("commands", card.commands)):
        console.print(heading, style="bold")
        for line in lines:
            console.print(f"  {line}", soft_wrap=True)
