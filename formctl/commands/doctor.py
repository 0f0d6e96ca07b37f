"""``formctl doctor``: is this machine ready, and is this installation whole?"""

from typing import Annotated

import typer

from formctl.commands.options import Overrides


def command(
    overrides: Overrides = None,
    warm: Annotated[
        bool, typer.Option("--warm", help="Compile now what a training with these settings needs, and keep it.")
    ] = False,
) -> None:
    """Check this machine and this installation."""
    from formctl.console import err, table
    from formctl.doctor import examine
    from formctl.settings import compose

    config = compose(overrides or [])
    if warm:
        from formctl.warming import warm as compile_now

        compile_now(config)
        return
    with err.status("looking at packages, disk, compiler, torch and graphics"):
        findings = list(examine(config.runs))
    table(("subject", "state", "detail"), [(item.subject, item.state, item.detail) for item in findings])
    if any(item.state == "broken" for item in findings):
        raise typer.Exit(1)
