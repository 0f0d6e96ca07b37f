"""``formctl doctor``: is this machine ready, and is this installation whole?"""

import typer

from formctl.commands.options import Overrides


def command(overrides: Overrides = None) -> None:
    """Check this machine and this installation."""
    from formctl.console import err, table
    from formctl.doctor import examine
    from formctl.settings import compose

    with err.status("looking at packages, disk, compiler, torch and graphics"):
        findings = list(examine(compose(overrides or []).runs))
    table(("subject", "state", "detail"), [(item.subject, item.state, item.detail) for item in findings])
    if any(item.state == "broken" for item in findings):
        raise typer.Exit(1)
