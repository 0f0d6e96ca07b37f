"""Periods with a learner or a reward of their own: names become settings, settings become dataclasses."""

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from formctl.errors import ConfigError
from formctl.settings import overrides as typed
from formctl.settings import validation

if TYPE_CHECKING:
    from algos.curriculum import CurriculumSpec

GROUPS = ("algo", "reward")
"""What a period may choose for itself, by the name of a file in the group's folder."""

Compose = Callable[[list[str]], dict[str, Any]]


def resolve(tree: dict[str, Any], compose: Compose) -> None:
    """Put the settings of the named files into the composed tree, so that it holds all that a training is made from.

    The profile's budgets hold for them too; what was typed for the configured learner or reward does not.
    Raises ConfigError for a name that is none of the group's files.
    """
    curriculum = tree.get("curriculum")
    for period in curriculum.get("periods", ()) if isinstance(curriculum, dict) else ():
        for group in GROUPS:
            name = period.get(group)
            if isinstance(name, str):
                choice = f"{group}={name}"
                try:
                    typed.check(typed.parse([choice]))
                except ConfigError as error:
                    raise ConfigError(f"curriculum period {period.get('name')!r}: {error}") from error
                period[group] = compose([choice, f"profile={tree['profile']}"])[group]


def read(spec: "CurriculumSpec") -> "CurriculumSpec":
    """The curriculum with its periods' learners and rewards as dataclasses. Raises ConfigError."""
    periods = []
    for number, period in enumerate(spec.periods):
        own = {group: getattr(period, group) for group in GROUPS if getattr(period, group) is not None}
        for group, values in own.items():
            key = f"curriculum.periods.{number}.{group}"
            if not isinstance(values, dict):
                raise ConfigError(f"{key}={values!r} has to be the name of a file in conf/{group}")
            own[group] = validation.read(key, values)
        periods.append(replace(period, **own))
    return replace(spec, periods=tuple(periods))


def plain(values: dict[str, Any]) -> dict[str, Any]:
    """A curriculum's plain values without what its periods leave open."""
    periods = [{key: value for key, value in period.items() if value is not None} for period in values["periods"]]
    return {**values, "periods": periods}
