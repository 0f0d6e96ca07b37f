"""Flying methods on stored scenarios: one row per episode, and the few rates that are printed."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import torch

from envs.metrics import METRIC_VERSION
from envs.bank import Bank
from envs.flight import fly as fly_batch
from envs.formation import FormationEnv, WorldSpec
from envs.scenarios import select
from envs.spec import OBJECTIVES, Scenarios
from formctl.build import environment
from formctl.files import StoreError, atomic, disk_errors

if TYPE_CHECKING:
    from envs.spec import ScenarioSpec
    from formctl.config import Config
    from formctl.methods import Method

IDENTITY = (
    "method",
    "seed",
    "run",
    "profile",
    "scenario",
    "columns",
    "balls",
    "ball_aim",
    "drones",
    "sim",
    "drone",
    "bank",
    "scenario_id",
    "metric_version",
)
"""Columns that say which episode of whom a row is; the metric columns follow."""


def fly(
    method: "Method", bank: Bank, world: WorldSpec, config: "Config", listen: Callable[[int], None] = lambda done: None
) -> pd.DataFrame:
    """Fly every episode of ``bank`` and return its rows, in the bank's order.

    ``listen`` hears how many episodes are done. The same call gives the same rows.
    Raises ValueError where the method does not fit the world.
    """
    env = environment(world, config.sim)
    agent = method.make(env)
    tables = []
    done = 0
    for chunk in batches(bank.scenarios, config.eval.batch if agent.capabilities.batched else 1, env.dtype):
        agent.reset(chunk, env.reset(chunk))
        rows = pd.DataFrame(fly_batch(env, agent.act, chunk, config.eval))
        rows["scenario_id"] = chunk.id.numpy()
        tables.append(rows)
        done += len(rows)
        listen(done)
    rows = pd.concat(tables, ignore_index=True)
    for name, value in identity(method, bank, env, config).items():
        rows[name] = value
    return rows[[*IDENTITY, *(name for name in rows.columns if name not in IDENTITY)]]


def identity(method: "Method", bank: Bank, env: FormationEnv, config: "Config") -> dict[str, Any]:
    """The identity columns that all rows of one flight share."""
    from analysis.records import weakest

    scenario = env.world.scenario
    return {
        "method": method.name,
        "seed": int(method.facts["seed"]),
        "run": str(method.facts["run"]),
        "profile": weakest([method.profile, config.profile]) if method.profile else config.profile,
        "scenario": scenario.name,
        "columns": scenario.columns,
        "balls": scenario.balls,
        "ball_aim": scenario.ball_aim,
        "drones": env.drones,
        "sim": config.sim,
        "drone": env.world.drone.name,
        "bank": bank.sha256,
        "metric_version": METRIC_VERSION,
    }


def batches(scenarios: Scenarios, size: int, dtype: torch.dtype) -> Iterator[Scenarios]:
    """The episodes in their order, ``size`` at a time, their real numbers as ``dtype``."""
    real = Scenarios(*(field.to(dtype) if field.is_floating_point() else field for field in scenarios))
    for first in range(0, len(real.id), size):
        yield select(real, torch.arange(first, min(first + size, len(real.id))))


def save_bank(path: Path, scenario: "ScenarioSpec", episodes: int, seed: int) -> Bank:
    """Draw a bank and store it."""
    bank = Bank.create(scenario, episodes, seed)
    with disk_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        bank.save(path)
    return bank


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
    figures = {"sr": float(rows["sr"].mean()), "sr_k": int(rows["sr"].sum()), "sr_n": len(rows)}
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
