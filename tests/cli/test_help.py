"""Help pages, word for word, and that asking for help stays cheap.

After a deliberate change: FORMCTL_GOLDEN=write pytest tests/cli/test_help.py, then read the difference in git.
"""

import os
import subprocess
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

import pytest

from formctl import __version__
from formctl.cli import COMMANDS
from tests.cli.conftest import Result

GOLDEN = Path(__file__).parent / "golden"
PAGES = [
    "",
    *COMMANDS,
    "bank create",
    "bank show",
    "conf show",
    "conf keys",
    "runs ls",
    "runs show",
    "runs diff",
    "runs tag",
    "runs rm",
    "runs seal",
    "runs verify",
]
HEAVY = "torch mujoco pandas optuna hydra omegaconf numpy matplotlib rich torchrl tensordict".split()


@pytest.mark.parametrize("page", PAGES)
def test_help_pages(page: str, formctl: Callable[..., Result]) -> None:
    result = formctl(*page.split(), "--help")
    path = GOLDEN / f"help{page.replace(' ', '_') and '_' + page.replace(' ', '_')}.txt"
    if os.environ.get("FORMCTL_GOLDEN") == "write":
        path.parent.mkdir(exist_ok=True)
        path.write_text(result.out)
    assert (result.code, result.err) == (0, "")
    assert result.out == path.read_text()


@pytest.mark.parametrize("name", COMMANDS)
def test_line_on_the_first_page_begins_the_command_s_own_help(name: str) -> None:
    module = import_module(f"formctl.commands.{name}")
    own = module.app.info.help if hasattr(module, "app") else module.command.__doc__
    assert " ".join(own.split()).startswith(COMMANDS[name].rstrip("."))


def test_version(formctl: Callable[..., Result]) -> None:
    assert formctl("--version").out == f"formctl {__version__}\n"


@pytest.mark.parametrize("group", ["", "bank", "conf", "runs"])
def test_no_arguments_is_a_wrong_call_that_gets_help(group: str, formctl: Callable[..., Result]) -> None:
    result = formctl(*group.split())
    assert (result.code, result.out) == (2, "")
    assert result.err.startswith(f"Usage: formctl {group}".rstrip())


@pytest.mark.parametrize("args", [[], ["--help"], ["--version"]])
def test_starting_imports_nothing_heavy(args: list[str]) -> None:
    assert loaded(args, [*HEAVY, "pydantic"]) == []


@pytest.mark.parametrize("args", [["trian"], *([name, "--help"] for name in COMMANDS)])
def test_help_and_mistakes_import_nothing_heavy(args: list[str]) -> None:
    assert loaded(args, HEAVY) == []  # typer itself reads arguments with pydantic


def loaded(args: list[str], modules: list[str]) -> list[str]:
    """Those of ``modules`` that a new process has imported after ``formctl ARGS`` (after the import alone without)."""
    program = (
        f"import sys; from formctl.cli import run; args = {args!r}; args and run(args); "
        f"print('loaded', *sorted(set({modules!r}) & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    last = done.stdout.splitlines()[-1].split()
    assert last[0] == "loaded"
    return last[1:]
