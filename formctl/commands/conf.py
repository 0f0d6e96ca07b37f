"""``formctl conf``: the composed settings and what every key means."""

import typer

from formctl.options import Multirun, Overrides, configs

app = typer.Typer(help="Show the composed settings and what every key means.", add_completion=False)


@app.command()
def show(overrides: Overrides = None, multirun: Multirun = False) -> None:
    """Print the composed settings as YAML."""
    for _ in configs(overrides, multirun, show=True):
        pass
