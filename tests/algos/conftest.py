"""Small settings from the files in conf/, so that what is tested is what is shipped."""

from pathlib import Path
from typing import Any

import pytest
import torch
from omegaconf import OmegaConf
from pydantic import TypeAdapter

from algos.curriculum import CurriculumSpec
from algos.encoder import EncoderSpec
from algos.mappo import MappoSpec
from algos.shac import ShacSpec
from algos.trainer import Trainer, TrainSettings
from envs import reward
from envs.formation import WorldSpec
from envs.spec import DroneSpec, Observation, ObservationLayout, ObservationSpec, ScenarioSpec

torch.set_num_threads(1)  # two threads on such small tensors wait for each other, above all on a busy machine

CONF = Path(__file__).parents[2] / "conf"
LAYOUT = ObservationLayout("test", 3, 25, 7, 9, 10)


def group(name: str, choice: str) -> dict[str, Any]:
    """One group file with the files it builds upon."""
    values = OmegaConf.to_container(OmegaConf.load(CONF / name / f"{choice}.yaml"))
    bases = [base for base in values.pop("defaults", []) if base != "_self_"]
    return {key: value for base in bases for key, value in group(name, base).items()} | values


def spec(kind: type, name: str, choice: str, **changes: Any) -> Any:
    """A settings dataclass from its file, with changes."""
    return TypeAdapter(kind).validate_python(group(name, choice) | changes)


def encoder_spec(choice: str = "attention", **changes: Any) -> EncoderSpec:
    return spec(EncoderSpec, "encoder", choice, **changes)


def reward_spec(choice: str) -> reward.Reward:
    values = group("reward", choice)
    return TypeAdapter(getattr(reward, values["target"].rpartition(".")[2])).validate_python(values)


def world(scenario: str = "mixed", reward: str = "shaped", **changes: Any) -> WorldSpec:
    return WorldSpec(
        spec(ScenarioSpec, "scenario", scenario, **changes),
        spec(DroneSpec, "drone", "crazyflie"),
        spec(ObservationSpec, "observation", "paper"),
        reward_spec(reward),
    )


def shac(**changes: Any) -> ShacSpec:
    """SHAC with 4 episodes and 6 steps."""
    small = {"envs": 4, "rollout": 6, "critic_minibatches": 2, "pool": 8, "pool_updates": 2}
    return spec(ShacSpec, "algo", "shac", **(small | changes))


def mappo(**changes: Any) -> MappoSpec:
    """MAPPO with 8 episodes and 4 steps."""
    small = {"envs": 8, "rollout": 4, "epochs": 2, "minibatches": 2, "pool": 16, "pool_updates": 2}
    return spec(MappoSpec, "algo", "mappo_fast", **(small | changes))


def curriculum_spec(choice: str) -> CurriculumSpec:
    """A curriculum's file; learners and rewards that its periods name are the small and the shipped ones."""
    named = {"shac": shac, "mappo_fast": mappo}
    plain = group("curriculum", choice)
    for period in plain["periods"]:
        if "algo" in period:
            period["algo"] = named[period["algo"]]()
        if "reward" in period:
            period["reward"] = reward_spec(period["reward"])
    return TypeAdapter(CurriculumSpec).validate_python(plain)


def train_settings(curriculum: str = "none", updates: int = 4, seed: int = 0, **algo: Any) -> TrainSettings:
    """A training of seconds: 8 episodes, 4 steps."""
    return TrainSettings(
        world=world(),
        weights=(0.25, 0.25, 0.25, 0.25),
        encoder=encoder_spec(),
        algo=mappo(**algo),
        curriculum=curriculum_spec(curriculum),
        steps=updates * 32,
        seed=seed,
        compile=False,
    )


def observation(batch: int = 5, drones: int = 3, balls: int = 2, seed: int = 0, absent: bool = True) -> Observation:
    """Random tokens; with `absent`, about half of the balls and static tokens are masked (and hold numbers anyway)."""
    generator = torch.Generator().manual_seed(seed)

    def draw(*shape: int) -> torch.Tensor:
        return torch.randn(batch, drones, *shape, generator=generator)

    keep = -1.0 if not absent else 0.5
    return {
        "self": draw(1, 25),
        "drones": draw(drones - 1, 7),
        "static": draw(1, 9),
        "dynamic": draw(balls, 10),
        "static_mask": torch.rand(batch, drones, 1, generator=generator) > keep,
        "dynamic_mask": torch.rand(batch, drones, balls, generator=generator) > keep,
    }


@pytest.fixture(autouse=True)
def seeded() -> None:
    torch.manual_seed(0)


def run(trainer: Trainer, updates: int | None = None) -> list[Any]:
    """The progress of so many updates, or of all that are left."""
    done = []
    for progress in trainer.train():
        done.append(progress)
        if len(done) == updates:
            break
    return done
