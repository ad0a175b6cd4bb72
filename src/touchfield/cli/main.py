"""Entry point of the `touchfield` command. It imports only the module of the requested command; the help
imports all.

Exit codes: 0 success, 2 usage error, 1 faulty data. An error is one line on stderr, or with ``--json`` one
JSON object.
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
from touchfield.cli.citations import sources_of
from touchfield.errors import InvalidArgument, TouchfieldError, UnboundedError, printable
from touchfield.sources.samples import SAMPLES

app = typer.Typer(rich_markup_mode="rich", pretty_exceptions_enable=False)

_SAMPLES = ", ".join(f"sample:{name}" for name in SAMPLES)

Options = dict[str, Any]
"""Values of the options that `touchfield.cli.options.with_options` adds, by parameter name."""

Json = Annotated[
    bool, typer.Option("--json", help="Print one machine-readable object; an error, too, as one.")
]
Cite = Annotated[bool, typer.Option("--cite", help="Add the sources behind the figures, to be cited.")]
Source = Annotated[str, typer.Argument(help=f"File or folder, or {_SAMPLES}.")]
Stream = Annotated[str, typer.Argument(help="A .touch file, or the address of one: https://...")]


def command(panel: str, *examples: str, name: str | None = None) -> Callable[[Callable[..., Any]], Any]:
    """Register a function as a command in a panel of the help; its own help ends with the examples.

    A parameter ``Annotated[TYPE, "help text"]`` becomes an argument or, with a default, an option of the same
    name. The parameter `options` receives the values of `touchfield.cli.options.with_options`. A command
    that returns an `Answer` also gets ``--json``, and ``--cite`` if its figures have sources; its answer is
    printed.
    """
    epilog = (
        "\n\n".join(["Examples:", *(f"touchfield {example}" for example in examples)]) if examples else None
    )

    def register(function: Any) -> Any:
        signature = inspect.signature(function, eval_str=True)
        options: list[inspect.Parameter] = getattr(function, "options", [])
        names, has_answer = {p.name for p in options}, signature.return_annotation is not None
        command_parameters = [_described(p) for p in signature.parameters.values() if p.name != "options"]
        if has_answer:
            command_parameters.append(inspect.Parameter("as_json", BY_NAME, default=False, annotation=Json))
        sources = sources_of(name or function.__name__) if has_answer else ()
        if sources:
            command_parameters.append(inspect.Parameter("is_cited", BY_NAME, default=False, annotation=Cite))
        command_parameters.append(inspect.Parameter("context", BY_NAME, annotation=typer.Context))

        def call(context: typer.Context, **arguments: Any) -> None:
            as_json = arguments.pop("as_json") if has_answer else False
            is_cited = arguments.pop("is_cited", False)
            if options:  # options of the command line first, then the defaults
                arguments["options"] = {
                    key.rstrip("_"): arguments.pop(key) for key in context.params if key in names
                }
            try:
                with _print_warnings() as warning_texts:
                    answer = function(**arguments)
            except InvalidArgument as error:  # the task names a field; the command line names the option
                typed = {p.name: p.opts[0] for p in context.command.params if p.param_type_name == "option"}
                if error.where not in typed:
                    raise
                raise InvalidArgument(typed[error.where], error.found, error.expected, error.hint) from error
            if answer is not None:
                answer.show(as_json, warning_texts, sources if is_cited else ())

        command_function: Any = wraps(function)(call)
        command_function.__signature__ = inspect.Signature([*command_parameters, *options])
        command_function.__annotations__ = {p.name: p.annotation for p in (*command_parameters, *options)}
        return app.command(name=name, rich_help_panel=panel, epilog=epilog)(command_function)

    return register


@contextmanager
def _print_warnings() -> Iterator[list[str]]:
    """Print each distinct `UnboundedError` to stderr when it occurs; yield a list of their texts.

    Of the letters that Matplotlib's font lacks, one for each, a single text is printed.
    """
    texts: list[str] = []
    with warnings.catch_warnings():
        usual = warnings.showwarning

        def show(message: Any, category: type[Warning], *location: Any, **details: Any) -> None:
            text = _BOXES if str(message).startswith("Glyph ") else str(message)
            if not (text is _BOXES or issubclass(category, UnboundedError)):
                usual(message, category, *location, **details)
            elif text not in texts:
                texts.append(text)
                sys.stderr.write(printable(f"warning: {text}\n"))

        warnings.showwarning = show
        warnings.simplefilter("always", UnboundedError)
        yield texts


_BOXES: Final = "The font of the picture lacks letters; it shows boxes in their place."
BY_NAME: Final = inspect.Parameter.KEYWORD_ONLY


def _described(parameter: inspect.Parameter) -> inspect.Parameter:
    help_text = getattr(parameter.annotation, "__metadata__", (None,))[0]
    if not isinstance(help_text, str):
        return parameter.replace(kind=BY_NAME)
    flag = f"--{parameter.name.replace('_', '-')}"
    is_argument = parameter.default is parameter.empty
    declaration = typer.Argument(help=help_text) if is_argument else typer.Option(flag, help=help_text)
    return parameter.replace(kind=BY_NAME, annotation=Annotated[parameter.annotation.__origin__, declaration])


# some versions of typer bundle click and others import it: this finds the base of its errors in both
USAGE_ERROR: Any = next(c for c in typer.BadParameter.__mro__ if c.__name__ == "ClickException")

TYPER_INTERRUPTED = 130
"""Result that Typer returns after Ctrl-C."""


COMMANDS: Final = {
    **dict.fromkeys(("encode", "filter", "field", "plan"), "encode"),
    "map": "map",
    "watch": "watch",
    "decode": "decode",
    **dict.fromkeys(("export", "import"), "encode"),
    **dict.fromkeys(("edit", "splice", "resample", "lod", "partition"), "editing"),
    **dict.fromkeys(("texture", "deform"), "editing"),
    "info": "decode",
    **dict.fromkeys(("view", "compare"), "view"),
    "play": "play",
    "guide": "guide",
    **dict.fromkeys(("serve", "live", "mux", "demux"), "broadcast"),
    "measure": "view",
    "study": "study",
    "reduce": "editing",
    **dict.fromkeys(("index", "search", "similar", "correlate", "points"), "library"),
    **dict.fromkeys(("demo", "devices", "sources"), "setup"),
    "data": "data",
    **dict.fromkeys(("doctor", "warmup"), "setup"),
}
"""Module of each command, in the order of the help. Importing the module registers the command."""


_FILELESS: Final = ("guide", "index", "live", "play", "serve")


def load_commands(arguments: Sequence[str] = ()) -> typer.Typer:
    """Import and return an app with the command that the arguments name, or with all commands."""
    module = COMMANDS.get(arguments[0]) if arguments else None
    for module_name in [module] if module else dict.fromkeys(COMMANDS.values()):
        import_module(f"touchfield.cli.{module_name}")
    registered = {
        str(command_info.name or getattr(command_info.callback, "__name__", "")): command_info
        for command_info in app.registered_commands
    }
    loaded = copy(app)
    loaded.registered_commands = [registered[name] for name in (arguments[:1] if module else COMMANDS)]
    return loaded


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
    # SIGTERM (from a job scheduler or `timeout`) cleans up as Ctrl-C does
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    if isinstance(sys.stdout, io.TextIOWrapper):
        # a name may contain characters that the terminal's encoding cannot represent
        sys.stdout.reconfigure(errors="backslashreplace")
    sys.exit(_exit_code(arguments, commands))


def _exit_code(arguments: list[str] | None, commands: typer.Typer = app) -> int:
    """Run a command, print the error that ended it, and return the exit code."""
    argv = sys.argv[1:] if arguments is None else arguments
    as_json = "--json" in argv

    def fail(text: str, code: int, kind: str, notes: Sequence[str] = ()) -> int:
        line = " ".join(text.split())
        if as_json:
            noted = {"notes": list(notes)} if notes else {}
            output = json.dumps({"error": line, "kind": kind, "exit_code": code, **noted})
        else:
            output = "\n".join([f"touchfield: {line}", *(f"note: {note}" for note in notes)])
        sys.stderr.write(printable(output + "\n"))
        return code

    try:
        opened = load_commands(argv) if commands is app else commands
        result = opened(args=arguments, standalone_mode=False)
        if result == TYPER_INTERRUPTED:
            raise KeyboardInterrupt
        return result if isinstance(result, int) else 0
    except TouchfieldError as error:
        notes = getattr(error, "__notes__", ())
        return fail(str(error), error.exit_code, type(error).__name__, notes)
    except (KeyboardInterrupt, typer.Abort) as error:
        if isinstance(error.__cause__, EOFError):  # Typer treats it as an abort
            return fail(f"a file ended too early: {error.__cause__}. Make it anew", 1, "EOFError")
        note = "" if argv[:1] and argv[0] in _FILELESS else "; nothing was written under the final name"
        return fail(f"interrupted{note}", 1, "Interrupted")
    except USAGE_ERROR as error:
        command_name = f"{argv[0]} " if commands is app and argv and argv[0] in COMMANDS else ""
        return fail(f"{error.format_message()} (touchfield {command_name}--help tells more)", 2, "UsageError")
    except MemoryError:
        text = "out of memory: a smaller --nw, fewer --frames or a thinner --thickness-m take less"
        return fail(text, 1, "MemoryError")
    except BrokenPipeError:
        return 1
    except OSError as error:
        name = error.filename or "file system"
        text = f"{name}: {error.strerror or error}. Check the path, the permissions and the free space"
        return fail(text, 1, "OSError")
    except Exception as error:
        if os.environ.get("TOUCHFIELD_TRACEBACK"):
            raise
        text = f"a fault of touchfield itself ({type(error).__name__}: {error})"
        return fail(f"{text}. Run again with TOUCHFIELD_TRACEBACK=1 and report what it prints", 1, "Fault")
