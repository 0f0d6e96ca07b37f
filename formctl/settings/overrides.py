"""Hydra overrides as the user types them: checked, swept, and explained in one line when they are wrong."""

import re
from collections.abc import Iterable, Iterator, Sequence
from difflib import get_close_matches
from itertools import product
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException

from formctl.errors import ConfigError
from formctl.settings.paths import choices

OPTIONAL = ("baseline", "deploy", "experiment", "survey")
"""Groups that may be null."""


TEXT = ("name", "runs")
"""Keys whose value is taken as it is typed: names and paths may hold any letter, and look like numbers."""

SWEEPS = "-m takes lists (seed=0,1,2), choices (seed=choice(0,1)) and ranges (seed=range(0,3))"

_KEY = re.compile(r"(?P<key>[A-Za-z_][\w./@]*)=(?P<value>.+)", re.DOTALL)


def parse(overrides: Sequence[str]) -> list[Override]:
    """Check the form of each override. Raises ConfigError for anything but ``KEY=VALUE``."""
    parser = OverridesParser.create()
    parsed = []
    for text in overrides:
        try:
            override = parser.parse_override(quoted(text))
        except HydraException as error:
            raise ConfigError(f"cannot read {text!r}: write KEY=VALUE, for example seed=3") from error
        if override.type is None or override.is_add() or override.is_delete():
            raise ConfigError(f"cannot read {text!r}: keys can be set, not added or deleted; write KEY=VALUE")
        parsed.append(override)
    return parsed


def quoted(text: str) -> str:
    """An override as Hydra's grammar takes it: text that the grammar has no word for becomes a quoted string.

    Paths with spaces, ``~``, ``#`` or letters beyond ASCII are such text. Where a key wants no text, its own check says
    so.
    """
    match = _KEY.fullmatch(text)
    if match is None or match["value"][0] in "'\"":
        return text
    key, value = match["key"], match["value"]
    if key not in TEXT:
        try:
            OverridesParser.create().parse_override(text)
            return text
        except HydraException:
            if value[0] in "[{":  # an unfinished list or table is a slip, not a text
                return text
    escaped = re.sub(r"(\\*)('|$)", lambda found: 2 * found[1] + (found[2] and "\\'"), value)
    return f"{key}='{escaped}'"


def expand_sweep(overrides: Sequence[str]) -> list[list[str]]:
    """One list of overrides per combination of ``key=a,b`` values, in the order typed; the last key varies fastest.

    Raises ConfigError for what Hydra's sweeps have beyond lists, choices and ranges.
    """
    axes = []
    for text in overrides:
        key, _, value = text.partition("=")
        if text.startswith("weights=@") or (key == "name" and "," in value):  # texts, not in Hydra's grammar
            axes.append([f"{key}={part}" for part in value.split(",")])
            continue
        (override,) = parse([text])
        if not override.is_sweep_override():
            axes.append([text])
            continue
        try:
            axes.append([f"{override.get_key_element()}={part}" for part in override.sweep_string_iterator()])
        except (HydraException, TypeError, ValueError) as error:
            raise ConfigError(f"cannot sweep over {text!r}: {SWEEPS}") from error
    return [list(combination) for combination in product(*axes)]


def check(overrides: Sequence[Override]) -> None:
    """Raise ConfigError for a sweep outside ``-m`` and for an unknown choice of a group."""
    for override in overrides:
        if override.is_sweep_override():
            raise ConfigError(f"{override.input_line} lists several values: add -m to run each of them")
        names = choices(override.key_or_group)
        value = override.value()
        if names and value is None and override.key_or_group not in OPTIONAL:
            raise ConfigError(f"{override.key_or_group} cannot be left out; the choices are {', '.join(names)}")
        if names and value is not None and not isinstance(value, dict) and str(value) not in names:
            hint = nearest(str(value), names)
            raise ConfigError(
                f"{override.key_or_group} has no choice {str(value)!r}{hint}; the choices are {', '.join(names)}"
            )


def unknown_key(key: str, tree: dict[str, Any]) -> ConfigError | None:
    """The complaint about a key that the composed tree does not have, with the nearest that it has."""
    keys = list(flatten(tree))
    if key in keys:
        return None
    leaf = key.rpartition(".")[2]
    same_leaf = [known for known in keys if known.rpartition(".")[2] == leaf]
    hint = f": did you mean {same_leaf[0]!r}?" if same_leaf else nearest(key, keys)
    return ConfigError(f"unknown key {key!r}{hint or '; formctl conf keys lists them all'}")


def flatten(tree: Any, prefix: str = "") -> Iterator[str]:
    """Dotted names of every key in a nested dict or list, parents before children."""
    items: Iterable[tuple[Any, Any]] = ()
    if isinstance(tree, dict):
        items = tree.items()
    elif isinstance(tree, list):
        items = enumerate(tree)
    for key, value in items:
        yield f"{prefix}{key}"
        yield from flatten(value, f"{prefix}{key}.")


def nearest(word: str, words: Sequence[str]) -> str:
    """``: did you mean 'this'?`` or nothing."""
    close = get_close_matches(word, words, n=1)
    return f": did you mean {close[0]!r}?" if close else ""
