"""``formctl card``: what a policy is for, what it was measured to do, and how to use it."""

from pathlib import Path
from typing import Annotated

import typer


def command(
    policy: Annotated[str, typer.Argument(metavar="RUN|FILE|NAME", help="A trained policy.")],
    runs: Annotated[Path, typer.Option(help="The store whose evaluations the card shows.")] = Path("runs"),
    out: Annotated[
        Path | None,
        typer.Option(help="Make the card anew and write it here instead of printing it."),
    ] = None,
) -> None:
    """Show a policy's card: task, training, measured rates, limits, how to use it.

    Example: formctl card mixed
    """
    from formctl import cards
    from formctl.console import say
    from formctl.evaluation import methods

    path = methods.policy_file(policy, runs)
    shipped = {file.resolve(): name for name, file in methods.shipped().items()}
    name = shipped.get(path.resolve(), policy)
    ready = cards.shipped_card(path)
    if out is None and path.resolve() in shipped and ready.is_file():
        print(ready.read_text(encoding="utf-8"), end="")
        return
    text = cards.render(path, name, runs)
    if out is None:
        print(text, end="")
        return
    cards.write(out, text)
    say(f"card: {out}")
