"""Flying methods on stored scenarios: one row per episode, and the few rates that are printed."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import torch

from envs.bank import Bank
from envs.flight import fly as fly_batch
from envs.formation import WorldSpec
from envs.metrics import METRIC_VERSION
from envs.scenarios import cast, pad, select
from envs.spec import OBJECTIVES, Scenarios
from formctl import build
from formctl.build import environment
from formctl.files import StoreError, atomic, disk_errors

if TYPE_CHECKING:
    from envs.spec import ScenarioSpec
    from formctl.config import Config
    from formctl.methods import Method


@dataclass(frozen=True)
class Scene:
    """A world and the episodes to fly in it."""

    world: WorldSpec
    bank: Bank


def fly(
    method: "Method", scenes: Sequence[Scene], config: "Config", listen: Callable[[int], None] = lambda done: None
) -> pd.DataFrame:
    """Fly every episode of every scene and return their rows, scene by scene in the banks' order.

    The scenes may differ in their numbers of columns and balls only: a batched method flies them side by side, which is
    several times faster. ``listen`` hears how many episodes are done. The same call gives the same rows.
    Raises ValueError where the method does not fit the world.
    """
    env = environment(scenes[0].world, config.sim, config.deploy)
    agent = build.agent(method, env, config.deploy)
    together = [scenes] if agent.capabilities.batched else [[scene] for scene in scenes]
    size = config.eval.batch if agent.capabilities.batched else 1
    tables = []
    done = 0
    for group in together:
        for chunk in batches(stack(group), size, env.dtype):
            agent.reset(chunk, env.reset(chunk))
            tables.append(pd.DataFrame(fly_batch(env, agent.act, chunk, config.eval)))
            done += len(chunk.id)
            listen(done)
    rows = pd.concat(tables, ignore_index=True)
    names = pd.concat([identity(method, scene, env.drones, config) for scene in scenes], ignore_index=True)
    return pd.concat([names, rows], axis=1)


def identity(method: "Method", scene: Scene, drones: int, config: "Config") -> pd.DataFrame:
    """The identity columns of a scene's rows."""
    from analysis.records import weakest

    scenario = scene.world.scenario
    values = {
        "method": method.name,
        "seed": int(method.facts["seed"]),
        "run": str(method.facts["run"]),
        "profile": weakest([method.profile, config.profile]) if method.profile else config.profile,
        "scenario": scenario.name,
        "columns": scenario.columns,
        "balls": scenario.balls,
        "ball_aim": scenario.ball_aim,
        "drones": drones,
        "sim": config.sim,
        "drone": scene.world.drone.name,
        "deploy": config.deploy.name if config.deploy else "",
        "bank": scene.bank.sha256,
        "scenario_id": scene.bank.scenarios.id.numpy(),
        "metric_version": METRIC_VERSION,
    }
    return pd.DataFrame(values)


def stack(scenes: Sequence[Scene]) -> Scenarios:
    """All episodes in one batch, with room for the most columns and balls of any scene."""
    drawn = [scene.bank.scenarios for scene in scenes]
    columns = max(scenarios.columns.shape[1] for scenarios in drawn)
    balls = max(scenarios.throw_time.shape[1] for scenarios in drawn)
    padded = [pad(scenarios, columns=columns, balls=balls) for scenarios in drawn]
    return Scenarios(*(torch.cat(fields) for fields in zip(*padded, strict=True)))


def batches(scenarios: Scenarios, size: int, dtype: torch.dtype) -> Iterator[Scenarios]:
    """The episodes in their order, ``size`` at a time, their real numbers as ``dtype``."""
    for first in range(0, len(scenarios.id), size):
        yield cast(select(scenarios, slice(first, first + size)), dtype)


def save_bank(path: Path, scenario: "ScenarioSpec", episodes: int, seed: int) -> Bank:
    """Draw a bank and store it."""
    bank = Bank.create(scenario, episodes, seed)
    with disk_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        bank.save(path)
    return bank


def facts(bank: Bank) -> dict[str, Any]:
    """A bank as a run's record names it."""
    return {"sha256": bank.sha256, "seed": bank.seed, "episodes": len(bank)}


def write_rows(path: Path, rows: pd.DataFrame) -> None:
    """Rows as Parquet, atomically; equal rows give equal bytes."""
    with atomic(path) as temporary:
        rows.to_parquet(temporary, index=False)


def read_rows(path: Path) -> pd.DataFrame:
    """Rows of an evaluation. Raises StoreError where there are none."""
    try:
        return pd.read_parquet(path)
    except (OSError, ValueError) as error:
        raise StoreError(f"{path} cannot be read: {str(error).splitlines()[0]}") from error


def rates(rows: pd.DataFrame) -> dict[str, Any]:
    """What a search keeps of an evaluation: SR with k of n, CFR, FM of the successful episodes, satisfaction rates."""
    figures: dict[str, Any] = {"sr": float(rows["sr"].mean()), "sr_k": int(rows["sr"].sum()), "sr_n": len(rows)}
    figures |= {"cfr": float(rows["cfr"].mean()), "fm": mean_fm(rows)}
    return figures | {f"ok_{name}": float(rows[f"ok_{name}"].mean()) for name in OBJECTIVES}


def mean_fm(rows: pd.DataFrame) -> float | None:
    """FM in m over the collision-free episodes that reached the goal (paper, Sec. V-B); None where there is none."""
    flown = rows.loc[rows["cfr"], "fm"]
    return None if flown.empty else float(flown.mean())


def score(rows: pd.DataFrame) -> dict[str, float]:
    """Figures by which policies of one training are compared; ``score`` decides.

    CFR counts; where it is equal (at first it is 0) the share of episodes without a collision does, then FM.
    """
    clear = float((~rows["failure"].isin(["column", "ball", "drone", "ground", "ceiling"])).mean())
    cfr, fm = float(rows["cfr"].mean()), float(rows["fm"].mean())
    fm = fm if np.isfinite(fm) else 1e9
    total = cfr + 0.01 * clear + 0.001 / (1 + fm)
    return {"score": total, "cfr": cfr, "collision_free": clear, "fm": fm, "sr": float(rows["sr"].mean())}
