"""Scenes: worlds with the stored episodes to fly in them, drawn from settings or read from a bank."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

from envs.bank import Bank
from envs.formation import WorldSpec
from envs.scenarios import pad, select
from envs.spec import Scenarios
from formctl.errors import ConfigError
from formctl.settings import build, restore
from formctl.store.compare import differences
from formctl.store.files import disk_errors

if TYPE_CHECKING:
    from envs.spec import ScenarioSpec
    from formctl.settings import Config

AXES = ("columns", "balls")
"""Scenario counts in which the scenes of one evaluation may differ."""


@dataclass(frozen=True)
class EvaluationScene:
    """A world and the episodes to fly in it."""

    world: WorldSpec
    bank: Bank

    @property
    def record(self) -> dict[str, Any]:
        """The scene as a run's record names it."""
        scenario = self.world.scenario
        return bank_record(self.bank) | {"columns": scenario.columns, "balls": scenario.balls}


def bank_record(bank: Bank) -> dict[str, Any]:
    """A bank as a run's record names it."""
    return {"sha256": bank.sha256, "seed": bank.seed, "episodes": len(bank)}


def draw(config: "Config", axes: Mapping[str, Sequence[int]] | None = None) -> list[EvaluationScene]:
    """Every combination of the axes (AXES), each with its own bank drawn from ``eval.seed``; one scene without axes."""
    axes = axes or {}
    scenes = []
    for values in product(*axes.values()):
        counts = dict(zip(axes, values, strict=True))
        varied = restore(config.tree | {"scenario": config.tree["scenario"] | counts}) if counts else config
        bank = Bank.create(varied.scenario, config.eval.episodes, config.eval.seed)
        scenes.append(EvaluationScene(build.world(varied), bank))
    return scenes


def load(config: "Config", path: Path, overrides: Sequence[str] = ()) -> "tuple[Config, list[EvaluationScene]]":
    """The scene of a stored bank, and the settings with its scenario.

    Raises ConfigError when the overrides ask for another scenario.
    """
    bank = Bank.load(path)
    changed = differences(bank.spec, config.tree["scenario"])
    if changed and any(text.startswith("scenario") for text in overrides):
        key, (was, now) = next(iter(changed.items()))
        raise ConfigError(f"{path} was drawn with scenario.{key}={was}, not {now}: leave out scenario overrides")
    config = restore(config.tree | {"scenario": bank.spec})
    return config, [EvaluationScene(build.world(config), bank)]


def save_bank(path: Path, scenario: "ScenarioSpec", episodes: int, seed: int) -> Bank:
    """Draw a bank and store it."""
    bank = Bank.create(scenario, episodes, seed)
    with disk_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        bank.save(path)
    return bank


def stack(scenes: Sequence[EvaluationScene]) -> Scenarios:
    """All episodes in one batch, with room for the most columns and balls of any scene."""
    scenarios = [scene.bank.scenarios for scene in scenes]
    columns = max(drawn.columns.shape[1] for drawn in scenarios)
    balls = max(drawn.throw_time.shape[1] for drawn in scenarios)
    return concatenate([pad(drawn, columns=columns, balls=balls) for drawn in scenarios])


def concatenate(scenarios: Sequence[Scenarios]) -> Scenarios:
    """All episodes in one batch; their fields have the same shapes."""
    return Scenarios(*(torch.cat(fields) for fields in zip(*scenarios, strict=True)))


def batches(scenarios: Scenarios, size: int) -> Iterator[Scenarios]:
    """The episodes in their order, ``size`` at a time."""
    for first in range(0, len(scenarios.id), size):
        yield select(scenarios, slice(first, first + size))


def locate(scenes: Sequence[EvaluationScene], number: int) -> tuple[EvaluationScene, int]:
    """The scene of row ``number`` of an evaluation of ``scenes``, and the row's place in that scene's bank."""
    for scene in scenes:
        if number < len(scene.bank):
            return scene, number
        number -= len(scene.bank)
    raise IndexError(f"row {number} is in none of the scenes")
