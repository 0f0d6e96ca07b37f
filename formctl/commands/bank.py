"""``formctl bank``: episodes frozen to a file, so that every method meets the very same ones."""

from pathlib import Path
from typing import Annotated

import typer

from formctl.commands.options import Overrides, ShowConfig, configs

app = typer.Typer(help="Create and show banks of stored scenarios.", add_completion=False)


@app.command()
def create(
    out: Annotated[Path, typer.Option(metavar="FILE", help="Where to write it, e.g. box.npz.")],
    overrides: Overrides = None,
    episodes: Annotated[int | None, typer.Option(min=1, help="Number of episodes; eval.episodes by default.")] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="What they are drawn from; eval.seed by default.")] = None,
    cfg: ShowConfig = False,
) -> None:
    """Draw episodes and freeze them in a file.

    For example: formctl bank create scenario=mixed scenario.ball_aim=box --episodes 300 --seed 7 --out box.npz
    """
    given = {"eval.episodes": episodes, "eval.seed": seed}
    words = [*(overrides or []), *(f"{key}={value}" for key, value in given.items() if value is not None)]
    (config,) = configs(words, show=cfg)
    from envs.bank import Bank
    from formctl.console import say

    bank = Bank.create(config.scenario, config.eval.episodes, config.eval.seed)
    bank.save(out)
    say(f"{out}: {len(bank)} episodes of {config.scenario.name}, seed {bank.seed}, sha256 {bank.sha256}")
    say(f"fly them with: formctl eval --baseline straight_line --bank {out}")


@app.command()
def show(file: Annotated[Path, typer.Argument(metavar="FILE", help="A bank written by bank create.")]) -> None:
    """What a bank holds, after checking it against its hash."""
    from envs.bank import Bank
    from formctl.console import print_yaml

    bank = Bank.load(file)
    head = {"file": str(file), "sha256": bank.sha256, "seed": bank.seed, "episodes": len(bank)}
    print_yaml({**head, "scenario": bank.spec})
