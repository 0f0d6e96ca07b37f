"""What the user sees: messages, tables, progress."""

from typing import Any

import yaml
from rich.console import Console
from rich.syntax import Syntax

out = Console(highlight=False)
err = Console(stderr=True, highlight=False)


def say(message: str) -> None:
    """One line of news on stdout."""
    out.print(message, soft_wrap=True, markup=False)


def warn(message: str) -> None:
    """One line on stderr about something that does not stop the run."""
    err.print(f"warning: {message}", style="yellow", soft_wrap=True, markup=False)


def print_yaml(tree: dict[str, Any]) -> None:
    """A nested dict as YAML, coloured on a terminal, ready to be piped otherwise."""
    text = yaml.safe_dump(tree, sort_keys=False, allow_unicode=True)
    if out.is_terminal:
        out.print(Syntax(text, "yaml", background_color="default"))
    else:
        print(text, end="")
