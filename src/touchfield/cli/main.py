"""The `touchfield` command: a command's room is opened when the command is asked for, all of them for the
help.

Exit code 0 if all went well, 2 for a usage error, 1 for data at fault; an error is one line on stderr, of a
command with ``--json`` one object.
"""

from __future__ import annotations

import inspect
import io
import json
import os
import signal
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from copy import copy
from functools import wraps
from importlib import import_module
from typing import Annotated, Any, Final

import typer

from touchfield._version import __version__
from touchfield.errors import InvalidArgument, TouchfieldError, UnboundedError
from touchfield.sources.samples import SAMPLES

app = typer.Typer(rich_markup_mode="rich", pretty_exceptions_enable=False)

_SAMPLES = ", ".join(f"sample:{name}" for name in SAMPLES)

Asked = dict[str, Any]
"""What was asked for by the options of `touchfield.cli.options.asks`."""

Json = Annotated[
    bool, typer.Option("--json", help="Print one machine-readable object; an error, too, as one.")
]
Source = Annotated[str, typer.Argument(help=f"File or folder, or {_SAMPLES}.")]
Stream = Annotated[str, typer.Argument(help="A .touch file, or the address of one: https://...")]


def command(panel: str, *examples: str, name: str | None = None) -> Callable[[Callable[..., Any]], Any]:
    """Make a function a command, in a panel of the help, with examples at the end of its own help.

    A parameter ``Annotated[TYPE, "words"]`` is an argument, or with a default an option of its name; `asked`
    are those of `touchfield.cli.options.asks`. One that returns an `Answer` is given ``--json``, and that is
    printed.
    """
    epilog = (
        "\n\n".join(["Examples:", *(f"touchfield {example}" for example in examples)]) if examples else None
    )

    def register(function: Any) -> Any:
        signature = inspect.signature(function, eval_str=True)
        options: list[inspect.Parameter] = getattr(function, "options", [])
        names, has_answer = {p.name for p in options}, signature.return_annotation is not None
        own = [_described(p) for p in signature.parameters.values() if p.name != "asked"]
        if has_answer:
            own.append(inspect.Parameter("as_json", BY_NAME, default=False, annotation=Json))
        own.append(inspect.Parameter("context", BY_NAME, annotation=typer.Context))

        def call(context: typer.Context, **given: Any) -> None:
            as_json = given.pop("as_json") if has_answer else False
            if options:  # as on the command line; what is not there follows
                given["asked"] = {key.rstrip("_"): given.pop(key) for key in context.params if key in names}
            try:
                with _warnings_shown() as shown:
                    answer = function(**given)
            except InvalidArgument as error:  # a job names a field; here it is an option
                typed = {p.name: p.opts[0] for p in context.command.params if p.param_type_name == "option"}
                if error.where not in typed:
                    raise
                raise InvalidArgument(typed[error.where], error.found, error.expected, error.mend) from error
            if answer is not None:
                answer.show(as_json, shown)

        made: Any = wraps(function)(call)
        made.__signature__ = inspect.Signature([*own, *options])
        made.__annotations__ = {p.name: p.annotation for p in (*own, *options)}
        return app.command(name=name, rich_help_panel=panel, epilog=epilog)(made)

    return register


@contextmanager
def _warnings_shown() -> Iterator[list[str]]:
    """Print warnings of bounds that are not proved to stderr as they come, each once; yields their texts."""
    texts: list[str] = []
    with warnings.catch_warnings():
        usual = warnings.showwarning

        def show(message: Any, category: type[Warning], *place: Any, **more: Any) -> None:
            if not issubclass(category, UnboundedError):
                usual(message, category, *place, **more)
            elif str(message) not in texts:
                texts.append(str(message))
                sys.stderr.write(f"warning: {message}\n")

        warnings.showwarning = show
        warnings.simplefilter("always", UnboundedError)
        yield texts


BY_NAME: Final = inspect.Parameter.KEYWORD_ONLY


def _described(parameter: inspect.Parameter) -> inspect.Parameter:
    words = getattr(parameter.annotation, "__metadata__", (None,))[0]
    if not isinstance(words, str):
        return parameter.replace(kind=BY_NAME)
    flag = f"--{parameter.name.replace('_', '-')}"
    is_argument = parameter.default is parameter.empty
    declaration = typer.Argument(help=words) if is_argument else typer.Option(flag, help=words)
    return parameter.replace(kind=BY_NAME, annotation=Annotated[parameter.annotation.__origin__, declaration])


# typer carries a click of its own in some versions and imports it in others; its errors' base is found either
# way
USAGE_ERROR: Any = next(c for c in typer.BadParameter.__mro__ if c.__name__ == "ClickException")

TYPER_INTERRUPTED = 130
"""Typer's result for Ctrl-C."""


COMMANDS: Final = {
    **dict.fromkeys(("encode", "filter", "field", "plan"), "make"),
    "decode": "reading",
    **dict.fromkeys(("export", "import"), "make"),
    **dict.fromkeys(("edit", "splice", "resample", "lod", "partition"), "editing"),
    **dict.fromkeys(("texture", "deform"), "editing"),
    "info": "reading",
    **dict.fromkeys(("view", "compare"), "look"),
    "play": "feel",
    **dict.fromkeys(("serve", "live", "mux", "demux"), "broadcast"),
    "measure": "look",
    "reduce": "editing",
    **dict.fromkeys(("index", "search", "similar", "correlate", "points"), "library"),
    **dict.fromkeys(("demo", "devices", "sources", "doctor", "warmup"), "machine"),
}
"""Module of each command, which registers it when it is imported; in the order of the help."""


_FILELESS: Final = ("index", "live", "play", "serve")


def open_rooms(arguments: Sequence[str] = ()) -> typer.Typer:
    """An app of the command that these arguments name, or of all where they name none."""
    named = COMMANDS.get(arguments[0]) if arguments else None
    for room in [named] if named else dict.fromkeys(COMMANDS.values()):
        import_module(f"touchfield.cli.{room}")
    known = {str(one.name or getattr(one.callback, "__name__", "")): one for one in app.registered_commands}
    opened = copy(app)
    opened.registered_commands = [known[name] for name in (arguments[:1] if named else COMMANDS)]
    return opened


@app.callback(invoke_without_command=True)
def root(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Show the version and exit.")] = False,
) -> None:
    """Touch as a medium: a scene becomes a force field, a stream, and a field again."""
    if version:
        typer.echo(f"touchfield {__version__}")
    elif context.invoked_subcommand is None:
        typer.echo(context.get_help())


def run(arguments: list[str] | None = None, commands: typer.Typer = app) -> None:
    """The console entry point."""
    # a request to end (a job scheduler, `timeout`) cleans up as Ctrl-C does
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    if isinstance(
        sys.stdout, io.TextIOWrapper
    ):  # a name may have letters that the terminal's encoding has not
        sys.stdout.reconfigure(errors="backslashreplace")
    sys.exit(_exit_code(arguments, commands))


def _exit_code(arguments: list[str] | None, commands: typer.Typer = app) -> int:
    """Run a command, and say what ended it."""
    given = sys.argv[1:] if arguments is None else arguments
    as_json = "--json" in given

    def say(text: str, code: int, kind: str) -> int:
        line = " ".join(text.split())
        told = (
            json.dumps({"error": line, "kind": kind, "exit_code": code}) if as_json else f"touchfield: {line}"
        )
        sys.stderr.write(told + "\n")
        return code

    try:
        opened = open_rooms(given) if commands is app else commands
        result = opened(args=arguments, standalone_mode=False)
        if result == TYPER_INTERRUPTED:
            raise KeyboardInterrupt
        return result if isinstance(result, int) else 0
    except TouchfieldError as error:
        return say(str(error), error.exit_code, type(error).__name__)
    except (KeyboardInterrupt, typer.Abort) as error:
        if isinstance(error.__cause__, EOFError):  # which Typer takes for somebody who leaves
            return say(f"a file ended too early: {error.__cause__}. Make it anew", 1, "EOFError")
        kept = "" if given[:1] and given[0] in _FILELESS else "; nothing was written under the final name"
        return say(f"interrupted{kept}", 1, "Interrupted")
    except USAGE_ERROR as error:
        own = f"{given[0]} " if commands is app and given and given[0] in COMMANDS else ""
        return say(f"{error.format_message()} (touchfield {own}--help tells more)", 2, "UsageError")
    except MemoryError:
        text = "out of memory: a smaller --nw, fewer --frames or a thinner --thickness-m take less"
        return say(text, 1, "MemoryError")
    except BrokenPipeError:
        return 1
    except OSError as error:
        name = error.filename or "file system"
        text = f"{name}: {error.strerror or error}. Check the path, the permissions and the free space"
        return say(text, 1, "OSError")
    except Exception as error:
        if os.environ.get("TOUCHFIELD_TRACEBACK"):
            raise
        text = f"a fault of touchfield itself ({type(error).__name__}: {error})"
        return say(f"{text}. Run again with TOUCHFIELD_TRACEBACK=1 and report what it prints", 1, "Fault")
