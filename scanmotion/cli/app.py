"""The application object: how errors end, where output goes, how progress is shown."""

import json
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

import typer
from typer.core import TyperGroup

from scanmotion.core.errors import ScanMotionError
from scanmotion.core.support.later import defer_classes

OK, CHECK_FAILED, BAD_INPUT, FAULT, INTERRUPTED = 0, 1, 2, 3, 130
"""Exit statuses: passes; a plan was made but a check failed; bad input; a fault of ours; Ctrl-C."""

# Help is drawn by rich; typer imports its Markdown and its tracebacks with it, and with them two parsers.
defer_classes("rich.markdown", ("Markdown",))
defer_classes("rich.traceback", ("Traceback",))

Progress = Callable[[str, float], None]

_interrupted: list[bool] = []
"""Holds something once Ctrl-C was pressed."""


def note_interrupts() -> None:
    """Remembers Ctrl-C, for libraries that swallow the exception or make another one of it.

    Compiled callbacks drop it with a note on stderr; an import that it meets fails with an ImportError.
    """

    def note(number: int, frame: FrameType | None) -> None:
        _interrupted.append(True)
        raise KeyboardInterrupt

    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, note)
        tell = sys.unraisablehook
        sys.unraisablehook = lambda told: None if _interrupted else tell(told)


class Commands(TyperGroup):
    """A group whose every failure is one line on stderr and one of the four statuses.

    A command returns its status, or None for 0.
    """

    def main(self, *args: Any, standalone_mode: bool = True, **extra: Any) -> Any:
        """Runs a command line and exits with its status."""
        status = self._status(*args, **extra)
        if standalone_mode:
            sys.exit(status)
        return status

    def _status(self, *args: Any, **extra: Any) -> int:
        try:
            return super().main(*args, standalone_mode=False, **extra) or OK
        except Exception as error:
            return INTERRUPTED if _interrupted else self._answer(error)

    def _answer(self, error: Exception) -> int:
        """What is said of an error, and its status."""
        if isinstance(error, ScanMotionError):
            return refuse(str(error))
        if isinstance(error, BrokenPipeError):
            # The reader of our output went away (`| head`): not a fault, and nothing more can be written.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return OK
        if isinstance(error, OSError):
            name = f"{error.filename}: " if error.filename else ""
            return refuse(f"{name}{error.strerror or error}")
        if isinstance(error, MemoryError):
            return refuse("not enough memory for this input")
        return self._usage(error)

    def _usage(self, error: Exception) -> int:
        """Mistakes in the command line itself; what is none is a fault of ours and is raised."""
        if type(error).__name__ == "NoArgsIsHelpError":
            error.show()
            return BAD_INPUT
        if type(error).__name__ == "Abort":
            return INTERRUPTED
        if not hasattr(error, "format_message"):
            if os.environ.get("SCANMOTION_DEBUG"):
                raise error
            refuse(f"a fault in scanmotion: {type(error).__name__}: {error} (SCANMOTION_DEBUG=1 for more)")
            return FAULT
        context = getattr(error, "ctx", None)
        hint = f" (see {context.command_path} --help)" if context is not None else ""
        return refuse(error.format_message().rstrip(".") + hint)


app = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Plans robot programmes that scan a whole sculpture, and judges them.",
    epilog="Exit status: 0 passes its checks, 1 a check failed, 2 bad input (one line on stderr), "
    "130 interrupted.",
)


def _version(asked: bool) -> None:
    if asked:
        from scanmotion import __version__

        typer.echo(f"scanmotion {__version__}")
        raise typer.Exit()


@app.callback()
def _root(
    version: bool = typer.Option(
        False, "--version", help="Show the version.", callback=_version, is_eager=True
    ),
) -> None:
    pass


def refuse(message: str) -> int:
    """Says on stderr, in one line, what is wrong; returns the status for bad input."""
    typer.echo("scanmotion: " + " ".join(message.split()), err=True)
    return BAD_INPUT


def say_json(document: object) -> None:
    """One JSON document on stdout, for machines."""
    typer.echo(json.dumps(document, indent=2, allow_nan=False))


def _heed(stage: str, fraction: float) -> None:
    """Ends the work where an earlier Ctrl-C was swallowed."""
    if _interrupted:
        raise KeyboardInterrupt


@contextmanager
def progress_bar(*, quiet: bool) -> Iterator[Progress]:
    """A progress callback that draws on stderr; it draws nothing where nobody watches."""
    if quiet or not sys.stderr.isatty():
        yield _heed
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("{task.description:<12}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bars:
        task = bars.add_task("start", total=1.0)

        def report(stage: str, fraction: float) -> None:
            _heed(stage, fraction)
            bars.update(task, description=stage, completed=min(max(fraction, 0.0), 1.0))

        yield report


def print_table(title: str, header: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
    """A table on stdout: drawn for people, tab-separated where it is piped."""
    if not sys.stdout.isatty():
        if header:
            typer.echo("\t".join(header))
        for row in rows:
            typer.echo("\t".join(row))
        return
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table(title=title, title_justify="left", show_header=bool(header))
    for name in header or ("",) * max(map(len, rows), default=1):
        table.add_column(name, overflow="fold")
    for row in rows:
        table.add_row(*(escape(cell) for cell in row))
    Console().print(table)
