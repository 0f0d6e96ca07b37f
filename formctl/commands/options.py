"""Options that commands share."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
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


StoreWords = Annotated[
    list[str] | None, typer.Argument(metavar="KEY=VALUE", help="runs=FOLDER: the store, if it is not ./runs.")
]
StoreOption = Annotated[Path | None, typer.Option("--runs", metavar="FOLDER", help="The store.  [default: runs]")]


SHAPES = {"runs": "runs=FOLDER", "profile": "profile=NAME"}
"""Settings of commands that compose nothing, as they are written."""


def show_settings(
    words: Sequence[str],
    multirun: bool = False,
    compose_one: "Callable[[Sequence[str]], Config] | None" = None,
) -> None:
    """Print the composed settings as YAML, one document per combination with ``-m``, and end the program."""
    from formctl.console import print_yaml
    from formctl.settings import compose, expand_sweep

    combinations = expand_sweep(words) if multirun else [list(words)]
    composed = [(compose_one or compose)(combination) for combination in combinations]
    for config in composed:
        if len(composed) > 1:
            print("---")
        print_yaml(config.tree)
    raise typer.Exit()


def split_words(words: Sequence[str] | None, keys: Sequence[str]) -> dict[str, str]:
    """``KEY=VALUE`` words of a command that takes ``keys`` and nothing else. Raises ConfigError."""
    from formctl.errors import ConfigError

    pairs = {}
    for word in words or ():
        key, equals, value = word.partition("=")
        if not equals or not value or key not in keys:
            raise ConfigError(f"cannot read {word!r}: write {' or '.join(SHAPES[key] for key in keys)}")
        pairs[key] = value
    return pairs


def store_of(words: Sequence[str] | None, option: Path | None) -> Path:
    """The store that ``runs=FOLDER`` or ``--runs FOLDER`` names. Raises ConfigError for any other word."""
    folder = split_words(words, ("runs",)).get("runs", option)
    return Path(folder or "runs").expanduser()


def take_store(words: Sequence[str], option: Path | None) -> tuple[list[str], Path]:
    """Names among which ``runs=FOLDER`` may stand: the names, and the store."""
    folders = [word for word in words if word.startswith("runs=")]
    return [word for word in words if word not in folders], store_of(folders, option)


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
