"""Options that the composing commands share, and the one way from them to a Config."""

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from envs.vocabulary import Weights
    from formctl.settings import Config

Overrides = Annotated[
    list[str] | None,
    typer.Argument(metavar="KEY=VALUE", help="Settings, e.g. seed=3 scenario=static scenario.columns=20."),
]
Multirun = Annotated[bool, typer.Option("--multirun", "-m", help="Run every combination of comma lists (seed=0,1,2).")]
ShowConfig = Annotated[bool, typer.Option("--cfg", help="Print the composed settings and stop.")]
Policies = Annotated[
    list[str] | None, typer.Option("--policy", metavar="RUN|FILE|NAME", help="A trained policy; may be repeated.")
]
Baselines = Annotated[
    list[str] | None, typer.Option("--baseline", metavar="NAME", help="A baseline of conf/baseline; may be repeated.")
]


def configs(
    overrides: list[str] | None,
    multirun: bool = False,
    show: bool = False,
    resolve_weights: "Callable[[str], Weights] | None" = None,
) -> "Iterator[Config]":
    """The composed settings, one Config per combination with ``-m``; all are checked before the first is used.

    With ``show`` they are printed as YAML and the program ends.
    """
    from formctl.settings import compose, expand_sweep

    combinations = expand_sweep(overrides or []) if multirun else [list(overrides or [])]
    composed = [compose(combination, resolve_weights) for combination in combinations]
    if show:
        from formctl.console import print_yaml

        for config in composed:
            if len(composed) > 1:
                print("---")
            print_yaml(config.tree)
        raise typer.Exit()
    yield from composed
