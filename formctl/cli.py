"""The ``formctl`` command: names and one-line helps of all commands, and the one place where errors become exit codes.

Importing this module stays cheap; a command's module is imported when the command is typed.
Exit codes: 0 done, 1 the run failed, 2 the call was wrong, 130 interrupted.
"""

import os
import re
import signal
import sys
from importlib import import_module
from typing import Annotated, Any, NoReturn

import typer
from typer.core import TyperArgument, TyperCommand, TyperGroup
from typer.exceptions import TyperException

from formctl import __version__, guard, interrupts
from formctl.errors import RunFailed, fail

COMMANDS = {
    "demo": "Fly one episode of the mixed scenario and show what happened.",
    "search": "Stage 1: random reward weights, a policy per weight vector.",
    "train": "Stage 2: one policy through the periods of the curriculum.",
    "eval": "Fly policies and baselines on the same stored scenarios.",
    "replay": "Show an episode again: page, MCAP, pictures, film.",
    "deploy": "Fly over simulated motion capture and radio; make set-points.",
    "export": "Write a policy as ONNX, or with --c as C, with a contract and a proof of parity.",
    "card": "Show a policy's card: task, training, measured rates, limits, how to use it.",
    "report": "The paper's tables and figures from whatever is in the store.",
    "reproduce": "The whole pipeline as one resumable graph of stages.",
    "compare": "Compare two methods on the same episodes: intervals, exact McNemar, paired difference.",
    "bank": "Create and show banks of stored scenarios.",
    "runs": "List, show and compare runs, tag, verify and remove them.",
    "conf": "Show the composed settings and what every key means.",
    "bench": "Measure the speed of world, learner and evaluation on this machine.",
    "doctor": "Check this machine and this installation.",
}
"""Every command in the order of the help page; the module of ``name`` is ``formctl.commands.<name>``."""


class LazyGroup(TyperGroup):
    """Knows its commands by name and help only; imports a command's module when it is called."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        for name, help_line in COMMANDS.items():
            self.add_command(TyperCommand(name, help=help_line, rich_markup_mode=None))

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        name, command, rest = super().resolve_command(ctx, args)
        return name, _load(name) if name in COMMANDS else command, rest

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as interrupt:
            fail(str(interrupt) or "interrupted; the same command again goes on where it stopped")
            raise typer.Exit(130) from None


__all__ = ["COMMANDS", "RunFailed", "app", "main", "run"]

app = typer.Typer(
    name="formctl",
    cls=LazyGroup,
    no_args_is_help=True,
    rich_markup_mode=None,  # rich help costs 0.3 s at every start
    pretty_exceptions_show_locals=False,
    epilog="Settings are given as KEY=VALUE, e.g. seed=3 scenario=static; formctl conf keys explains them all.",
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"formctl {__version__}")
        raise typer.Exit()


@app.callback()
def formctl(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and stop.")
    ] = False,
) -> None:
    """Multi-UAV formation control with obstacle avoidance: from reward-weight search to the paper's tables."""


def main() -> NoReturn:
    """Run the command line; every way out goes through here."""
    interrupts.outlive_audience()
    with interrupts.handled(interrupts.interrupt, (signal.SIGTERM, signal.SIGHUP)):  # Python does it for Ctrl-C
        sys.exit(run(sys.argv[1:]))


def run(args: list[str]) -> int:
    """Run one command line and return its exit code; errors are one line on stderr.

    With FORMCTL_TRACEBACK=1 in the environment they keep their traceback instead.
    """
    try:
        guard.check()
        result = typer.main.get_command(app).main(args, prog_name="formctl", standalone_mode=False)
        return result if type(result) is int else 0  # an exit code, or whatever the command returned
    except TyperException as error:  # the call does not fit the command
        if type(error).__name__ == "NoArgsIsHelpError":  # its message is the help page
            print(error.format_message(), file=sys.stderr)
            return 2
        message = error.format_message()
        if re.fullmatch(r"No such option: \S+", message):
            message += "; settings are written without dashes, as KEY=VALUE"
        return fail(message, error.exit_code)
    except Exception as error:
        if os.environ.get("FORMCTL_TRACEBACK") == "1":
            raise
        if isinstance(error, ValueError):  # the call names something that cannot be used
            return fail(str(error), 2)
        if isinstance(error, OSError) and error.strerror and error.filename:
            return fail(f"{error.filename}: {error.strerror.lower()}", 1)
        if isinstance(error, RunFailed):
            return fail(str(error), 1)
        said = (str(error).strip().splitlines() or [""])[0][:200]
        return fail(f"{type(error).__name__}: {said}; the details are in {_log(error)}", 1)


def _log(error: Exception) -> str:
    """Keep the traceback of an error that nobody foresaw; return where."""
    import tempfile
    import traceback

    with tempfile.NamedTemporaryFile("w", prefix="formctl-", suffix=".log", delete=False) as file:
        traceback.print_exception(error, file=file)
    return file.name


def _load(name: str) -> Any:
    module = import_module(f"formctl.commands.{name}")
    if hasattr(module, "app"):
        module.app.rich_markup_mode = None
        module.app.info.no_args_is_help = True
        command: Any = typer.main.get_group(module.app)
    else:
        single = typer.Typer(rich_markup_mode=None, add_completion=False)
        single.command(name)(module.command)
        command = typer.main.get_command(single)
    command.name = name
    for part in (command, *getattr(command, "commands", {}).values()):
        for param in part.params:
            if isinstance(param, TyperArgument):  # its metavar and help say more than <list[str]>
                param.display_type_rich = lambda ctx: None  # type: ignore[method-assign]
    return command
