"""The ``formctl`` command: names and one-line helps of all commands, and the one place where errors become exit codes.

Importing this module stays cheap; a command's module is imported when the command is typed.
Exit codes: 0 done, 1 the run failed, 2 the call was wrong, 130 interrupted.
"""

import sys
from importlib import import_module
from typing import Annotated, Any, NoReturn

import typer
from typer.core import TyperCommand, TyperGroup
from typer.exceptions import TyperException

from formctl import __version__

COMMANDS = {
    "demo": "Fly one episode of the mixed scenario and show what happened.",
    "search": "Stage 1: random reward weights, a policy per weight vector, satisfaction rates.",
    "train": "Stage 2: one policy through the periods of the curriculum.",
    "eval": "Fly a policy or a baseline on stored scenarios, one row per episode.",
    "report": "The paper's tables and figures from whatever is in the store.",
    "reproduce": "The whole pipeline as one resumable graph of stages.",
    "bank": "Create and show banks of stored scenarios.",
    "runs": "List, show and compare runs.",
    "conf": "Show the composed settings and what every key means.",
    "bench": "Measure the speed of the world on this machine.",
    "doctor": "Check this machine and this installation.",
}
"""Every command in the order of the help page; the module of ``name`` is ``formctl.commands.<name>``."""


class RunFailed(RuntimeError):
    """A run that could not finish: exit code 1; the message is one line and names the log."""


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


app = typer.Typer(
    name="formctl",
    cls=LazyGroup,
    rich_markup_mode=None,  # rich help costs 0.3 s at every start
    pretty_exceptions_show_locals=False,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"formctl {__version__}")
        raise typer.Exit()


@app.callback()
def formctl(
    version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Print it.")] = False,
) -> None:
    """Multi-UAV formation control with obstacle avoidance: from reward-weight search to the paper's tables."""


def main() -> NoReturn:
    """Run the command line; every way out goes through here."""
    sys.exit(run(sys.argv[1:]))


def run(args: list[str]) -> int:
    """Run one command line and return its exit code; errors are one line on stderr."""
    try:
        return int(typer.main.get_command(app).main(args, prog_name="formctl", standalone_mode=False) or 0)
    except TyperException as error:  # the call does not fit the command
        return fail(error.format_message(), 2)
    except ValueError as error:  # the call names something that cannot be used
        return fail(str(error), 2)
    except (RunFailed, OSError) as error:
        return fail(str(error), 1)


def fail(message: str, code: int = 1) -> int:
    """Print one line on stderr and pass the exit code through."""
    print(f"formctl: {' '.join(message.split())}", file=sys.stderr)
    return code


def _load(name: str) -> Any:
    module = import_module(f"formctl.commands.{name}")
    if hasattr(module, "app"):
        module.app.rich_markup_mode = None
        command: Any = typer.main.get_group(module.app)
    else:
        single = typer.Typer(rich_markup_mode=None, add_completion=False)
        single.command(name)(module.command)
        command = typer.main.get_command(single)
    command.name = name
    return command
