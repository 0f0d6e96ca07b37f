"""``formctl conf``: the composed settings and what every key means."""

from typing import Annotated

import typer

from formctl.commands.options import Multirun, Overrides, configs

app = typer.Typer(help="Show the composed settings and what every key means.", add_completion=False)


@app.command()
def show(overrides: Overrides = None, multirun: Multirun = False) -> None:
    """Print the composed settings as YAML."""
    for _ in configs(overrides, multirun, show=True):
        pass


@app.command()
def keys(
    words: Annotated[
        list[str] | None,
        typer.Argument(metavar="PREFIX|KEY=VALUE", help="Where to look, e.g. scenario, and settings (algo=mappo)."),
    ] = None,
) -> None:
    """List every key with its value and what it means."""
    from formctl.console import table
    from formctl.settings import ConfigError, chosen, compose
    from formctl.settings.manual import rows

    prefixes = [word for word in words or [] if "=" not in word]
    overrides = [word for word in words or [] if "=" in word]
    known = rows(compose(overrides).tree, chosen(overrides))
    found = []
    for prefix in prefixes or [""]:
        inside = [row for row in known if f"{row[0]}.".startswith(f"{prefix.rstrip('.')}." if prefix else "")]
        if not inside:
            raise ConfigError(f"no key starts with {prefix!r}; formctl conf keys lists them all")
        found += inside
    table(("key", "value", "meaning"), found)
