"""The command-line application, which reports each error by one line on standard error and an exit code."""

from __future__ import annotations

import errno
import importlib
import os
import signal
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from enum import IntEnum
from types import SimpleNamespace
from typing import Annotated, Any

import typer
from pydantic import ValidationError
from typer.core import TyperCommand

from petmjx.cli.command_options import as_typed
from petmjx.cli.console import as_notes, asking, lines_beside_data, prepare_streams
from petmjx.cli.run_command import RunInterrupted, last_stop, stoppable
from petmjx.common.checked_records import describe, typed_options
from petmjx.common.errors import EngineUnavailable, InputError, PetmjxError
from petmjx.common.safe_read import named_pipes
from petmjx.common.text import one_line, printable
from petmjx.version import __version__


class ExitCode(IntEnum):
    """The exit codes of commands. A command that ends without an error returns 0, whether plans stand or fall."""

    OK = 0
    FAILURE = 1
    UNUSABLE = 2
    HUNG_UP = 129
    INTERRUPTED = 130
    TERMINATED = 143


_BY_SIGNAL = {
    signal.SIGHUP: ExitCode.HUNG_UP,
    signal.SIGINT: ExitCode.INTERRUPTED,
    signal.SIGTERM: ExitCode.TERMINATED,
}
"""Signal → exit code after this signal: 128 + the number of the signal, as in shells."""


_USAGE_ERROR: type[Exception] = typer.BadParameter.__base__ or typer.BadParameter
"""The exception for wrong usage, Click's UsageError. The module that defines UsageError depends on the version of
typer. So UsageError is found as the base class of ``typer.BadParameter``."""


_SETTINGS = SimpleNamespace(debug=False)
"""Values of the options that the user writes before the name of the command, such as ``petmjx --debug score``."""

_COMMANDS = {
    "score": "Say which packing plans stand.",
    "sweep": "Simulate plans in many variants: forces, friction, errors.",
    "repair": "Say what to change in plans so that they stand.",
    "show": "Show what happens to one plan: page, picture, film.",
    "report": "Write a page about runs: charts, tables, plans in 3D.",
    "compare": "Compare packers, or two runs of the same plans.",
    "figure": "Draw the answers of a sweep as a figure for a paper.",
    "kpis": "Rate plans as BED-BPP's leaderboard does.",
    "leaderboard": "Rate packers by physics, as a site.",
    "criteria": "Evaluate criteria of stability; compare them with a run.",
    "loads": "Say which boxes bear more than they can.",
    "merge": "Join the shards of a run.",
    "info": "Say what a file is, how it is read and what is odd.",
    "convert": "Write packing plans as JSON, CSV or Parquet.",
    "samples": "Write packing plans with BED-BPP's statistics.",
    "label": "Label placements by physics, to train models with.",
    "export": "Write the MuJoCo model of one plan.",
    "warm-up": "Compile all kernels now, so that no run waits for them.",
    "doctor": "Show versions, devices and which engines work here.",
}
"""Name of a command → what the command does, as text for the list of commands. Each command is a function in a module
of this package. The function and the module have the name of the command, with underscores instead of hyphens."""


WIDTH = 110
"""Largest width of the help, in columns of characters."""


class SectionedCommand(TyperCommand):
    """A command whose help lists options under headings. The attribute ``rich_help_panel`` of an option is its
    heading."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the arguments, then the options with headings, and finally the options without a heading. Headings have
        the order in which their first options appear in the command."""
        sections: dict[str, list[tuple[str, str]]] = {}
        for parameter in self.get_params(ctx):
            row = parameter.get_help_record(ctx)
            if row is None:
                continue
            name, text = row
            heading = getattr(parameter, "rich_help_panel", None) or "Options"
            if parameter.param_type_name == "argument":
                name, heading = name.partition(" <")[0], "Arguments"  # "PLANS <list[Path]>" becomes "PLANS"
            sections.setdefault(heading, []).append((name, text))
        for heading in sorted(sections, key=lambda name: name == "Options"):
            with formatter.section(heading):
                formatter.write_dl(sections[heading])


def application(words: Sequence[str] = ()) -> typer.Typer:
    """Make the application. ``words`` are the arguments of the command line. If they name a command, the application
    has only this command. Otherwise, the application has all commands.

    Loading the modules of all commands would take longer than scoring a few plans.
    """
    app = typer.Typer(
        name="petmjx",
        help="Scores the stability of pallet packing plans by physics, many thousands at a time.",
        epilog="Exit codes: 0 success, whatever the verdicts are; 1 internal failure; 2 unusable input or options; 130 "
        "interrupted (143 by SIGTERM, 129 by SIGHUP).",
        rich_markup_mode=None,  # rich's layout would leave only 24 of 80 columns for the descriptions
        context_settings={"help_option_names": ["--help", "-h"], "max_content_width": WIDTH},
    )
    app.callback()(options)
    # Options before the command take no values, so the first word that is not an option is the command.
    command = next((word for word in words if not word.startswith("-")), "")
    for name in (command,) if command in _COMMANDS else _COMMANDS:
        module = name.replace("-", "_")
        function = getattr(importlib.import_module(f"petmjx.cli.{module}"), module)
        app.command(name, cls=SectionedCommand, short_help=_COMMANDS[name])(as_typed(function))
    return app


def _print_version(flag: bool) -> None:
    if flag:
        print(f"petmjx {__version__}")
        raise typer.Exit


def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
    debug: Annotated[
        bool, typer.Option("--debug", envvar="PETMJX_DEBUG", help="Show the traceback of an error.")
    ] = False,
) -> None:
    """The options that are written before the name of the command."""
    _SETTINGS.debug = debug


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    Args:
        arguments: the arguments without the program's name. If ``arguments`` is None, the arguments of this process are
            used.
    """
    _SETTINGS.debug = False
    return run_app(application, arguments)


def run_app(make: Callable[[Sequence[str]], typer.Typer], arguments: Sequence[str] | None = None) -> int:
    """Run the application that ``make`` builds for the arguments, and return the exit code. An error is reported as one
    line."""
    prepare_streams()
    code = _run(make, arguments)
    try:
        sys.stdout.flush()
    except OSError:
        # This branch is for standard output that cannot be written. Without the next line, Python would try to write
        # again at exit, and print an error.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return code


def _run(make: Callable[[Sequence[str]], typer.Typer], arguments: Sequence[str] | None) -> int:
    try:
        command_words = sys.argv[1:] if arguments is None else list(arguments)
        if "" in command_words:  # an empty argument is refused, because an empty path would mean the current folder
            raise InputError(f"argument {command_words.index('') + 1} is empty; is a shell variable not set?")
        if "-" in command_words:  # "-" is refused, because it would be read as the name of a file
            raise InputError(
                f'argument {command_words.index("-") + 1} is "-", which is not supported: '
                "name a file, or /dev/stdin or /dev/stdout"
            )
        with (
            as_notes(),
            typed_options(),
            asking(),
            named_pipes(command_words),
            lines_beside_data(command_words),
            stoppable(),
        ):
            result = make(command_words)(args=command_words or ["--help"], standalone_mode=False)
        if result == ExitCode.INTERRUPTED:  # typer returns this code instead of raising KeyboardInterrupt
            return _report("interrupted", _BY_SIGNAL[last_stop()])
        sys.stdout.flush()  # if the output cannot be written, this line raises the error
        return int(result or ExitCode.OK)
    except KeyboardInterrupt:
        return _report("interrupted", _BY_SIGNAL[last_stop()])
    except RunInterrupted as interrupt:
        return _report(f"interrupted: {interrupt}", _BY_SIGNAL[last_stop()])
    except (InputError, EngineUnavailable) as error:
        return _report(str(error), ExitCode.UNUSABLE)
    except PetmjxError as error:
        return _report(str(error), ExitCode.FAILURE)
    except _USAGE_ERROR as error:
        message = _usage_text(error)
        command = getattr(getattr(error, "ctx", None), "command_path", None) or "petmjx"
        return _report(f"{message} (see {command} --help)" if message else "", ExitCode.UNUSABLE)
    except (BrokenPipeError, SystemExit):
        # the reader of the output has closed the pipe (petmjx … | head); typer and rich then raise SystemExit
        return ExitCode.OK
    except OSError as error:
        if error.filename is not None or error.errno != errno.ENOSPC:  # any error but a full disk at standard output
            return _report(_inside(error), ExitCode.FAILURE)
        return _report(f"cannot write to standard output: {error.strerror}", ExitCode.FAILURE)
    except Exception as error:
        return _report(_inside(error), ExitCode.FAILURE)


def _usage_text(error: Exception) -> str:
    """The text that explains an error of usage. If pydantic has refused the value of an option, the text is petmjx's
    description of the fault in one line, because typer's text would contain pydantic's message of several lines. If an
    unknown option has the name of an argument in Python, such as ``--forbid``, the text names the option that sets this
    argument."""
    argument = getattr(error, "option_name", "").lstrip("-").replace("-", "_")
    known = getattr(getattr(getattr(error, "ctx", None), "command", None), "params", ())
    if meant := [one.opts[0] for one in known if one.name == argument]:
        vars(error)["possibilities"] = meant
    names = getattr(getattr(error, "param", None), "opts", None)
    if not names or not isinstance(error.__cause__, ValidationError):
        return str(getattr(error, "format_message", error.__str__)())
    name = next((name for name in names if name.startswith("--")), names[0])
    return f"{name} {describe(error.__cause__)}"


def _inside(error: Exception) -> str:
    return f"failure inside petmjx: {one_line(error)}; petmjx --debug … shows the traceback"


def _report(message: str, code: ExitCode) -> int:
    """Print one line on standard error. With --debug, the traceback is printed before this line."""
    with suppress(OSError):  # standard error may be closed
        if _SETTINGS.debug and code not in _BY_SIGNAL.values():
            import traceback

            traceback.print_exc()
        if message:
            print(f"petmjx: {printable(' '.join(message.split()))}", file=sys.stderr)
    return code
