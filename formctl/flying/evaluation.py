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
from envs.formation import FormationEnv, WorldSpec
from envs.scenarios import cast, pad, select
from envs.spec import Scenarios
from envs.vocabulary import CONTACTS, FAILURES, METRIC_VERSION, OBJECTIVES
from formctl.engines import workers
from formctl.flying import flights
from formctl.flying.recording import Again, Maker, Recorder
from formctl.settings import build
from formctl.settings.build import environment
from formctl.store.files import StoreError, atomic, disk_errors

if TYPE_CHECKING:
    from baselines.protocol import Agent
    from envs.spec import ScenarioSpec
    from formctl.flying.keeping import Keeper
    from formctl.flying.methods import Method
    from formctl.settings import Config


@dataclass(frozen=True)
class Scene:
    """A world and the episodes to fly in it."""

    world: WorldSpec
    bank: Bank


def check(config: "Config", flown: list["Method"], scenes: Sequence[Scene]) -> list["Method"]:
    """Return ``flown`` if each of them can fly every scene. Raises ValueError, before anything is flown."""
    for method in flown:
        for scene in scenes:
            env = environment(method.fit(scene.world), config.sim, config.deploy)
            build.linked(method.make(env), env, config.deploy)
    return flown


def fly(
    method: "Method",
    scenes: Sequence[Scene],
    config: "Config",
    listen: Callable[[int], None] = lambda done: None,
    keeper: "Keeper | None" = None,
    *,
    jobs: int = 1,
    journal: Path | None = None,
) -> pd.DataFrame:
    """Fly every episode of every scene and return their rows, scene by scene in the banks' order.

    The scenes may differ in their numbers of columns and balls only: a batched method flies them side by side, which is
    several times faster. ``jobs`` worker processes share its batches, and the episodes of any other method; those are
    kept in the file ``journal`` until the caller has stored the rows. ``listen`` hears how many episodes are done;
    ``keeper`` is offered their recordings. The same call gives the same rows, whatever ``jobs`` is and however often it
    was interrupted. Recorded flights and deployments are never compiled (``eval.compile``).
    Raises ValueError where the method does not fit the world, RunFailed when a worker process dies.
    """
    world = method.fit(scenes[0].world)
    env = environment(world, config.sim, config.deploy)
    alone = method.make(env)
    agent = build.linked(alone, env, config.deploy)
    if not agent.capabilities.batched:
        episodes = [one for scene in scenes for one in batches(stack([scene]), 1, env.dtype)]
        pilot = flights.Pilot(method.make, world, config.sim, config.eval, config.deploy)
        party = flights.flock(alone, len(episodes), jobs)
        rows = flights.fly(pilot, episodes, jobs, flights.Journal(journal), listen, party)
        if keeper is not None:
            columns = {str(name): column.to_numpy() for name, column in rows.items()}
            keeper.offer(columns, 0, Again(method, scenes, config))
    elif keeper is None:
        squadron = flights.Squadron(method.make, world, config.sim, config.eval, config.deploy)
        rows = _shared(squadron, list(batches(stack(scenes), config.eval.batch, env.dtype)), jobs, listen)
    else:
        rows = _recorded(env, agent, method, scenes, config, listen, keeper)
    names = pd.concat([identity(method, scene, env.drones, config) for scene in scenes], ignore_index=True)
    return pd.concat([names, rows], axis=1)


def _shared(
    squadron: flights.Squadron, chunks: Sequence[Scenarios], jobs: int, listen: Callable[[int], None]
) -> pd.DataFrame:
    """Rows of whole batches, flown by ``jobs`` processes, or by this one where one is enough."""
    alone = ((index, squadron(chunk)) for index, chunk in enumerate(chunks))
    tables: dict[int, pd.DataFrame] = {}
    for index, columns in workers.share(squadron, chunks, jobs) if min(jobs, len(chunks)) > 1 else alone:
        tables[index] = pd.DataFrame(columns)
        listen(sum(map(len, tables.values())))
    rows = pd.concat([tables[index] for index in range(len(chunks))], ignore_index=True)
    return rows.assign(planner_failures=0, planner_reason="")


def _recorded(
    env: FormationEnv,
    agent: "Agent",
    method: "Method",
    scenes: Sequence[Scene],
    config: "Config",
    listen: Callable[[int], None],
    keeper: "Keeper",
) -> pd.DataFrame:
    """Rows of whole batches; ``keeper`` is offered the recordings of each."""
    tables = []
    done = 0
    for chunk in batches(stack(scenes), config.eval.batch, env.dtype):
        start = env.reset(chunk)
        agent.reset(chunk, start)
        recorder = Recorder(env, agent, start, keeper.places(done, len(chunk.id)))
        flown = fly_batch(env, agent.act, chunk, config.eval, recorder.watch)
        keeper.offer(flown, done, Maker(recorder, method, scenes, config, done))
        tables.append(pd.DataFrame(flown))
        done += len(chunk.id)
        listen(done)
    return pd.concat(tables, ignore_index=True).assign(planner_failures=0, planner_reason="")


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
        "message_period": scenario.messages.period,
        "message_delay": sum(scenario.messages.delay) / 2,
        "message_loss": sum(scenario.messages.loss) / 2,
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
    return flights.side_by_side([pad(scenarios, columns=columns, balls=balls) for scenarios in drawn])


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
    """Rows as Parquet, atomically; equal rows give equal bytes.

    Numbers that a float32 world computed are half zeros: split into byte streams they shrink to 60 % of that.
    """
    numbers = [str(name) for name, kind in rows.dtypes.items() if kind == np.float64]
    others = [str(name) for name in rows if name not in numbers]
    small: dict[str, Any] = {"compression": "zstd", "compression_level": 9, "store_schema": False}
    with atomic(path) as temporary:
        rows.to_parquet(temporary, index=False, use_dictionary=others, use_byte_stream_split=numbers, **small)


def read_rows(path: Path) -> pd.DataFrame:
    """Rows of an evaluation. Raises StoreError where there are none."""
    try:
        return pd.read_parquet(path)
    except (OSError, ValueError) as error:
        raise StoreError(f"{path} cannot be read: {str(error).splitlines()[0]}") from error


def rates(rows: pd.DataFrame) -> dict[str, Any]:
    """What a search keeps of an evaluation: SR with k of n, CFR, FM of successes, throttle change, four rates."""
    figures: dict[str, Any] = {"sr": float(rows["sr"].mean()), "sr_k": int(rows["sr"].sum()), "sr_n": len(rows)}
    figures |= {"cfr": float(rows["cfr"].mean()), "fm": mean_fm(rows)}
    figures["throttle_change"] = float(rows["throttle_change"].mean())
    return figures | {f"ok_{name}": float(rows[f"ok_{name}"].mean()) for name in OBJECTIVES}


def reasons(rows: pd.DataFrame) -> list[tuple[str, int, int]]:
    """Why episodes failed: (reason, episodes, row number of the first), by first cause in the order of FAILURES.

    The planner stands last: among those failed episodes are some in which it could not do its work.
    """
    failed = rows[rows["failure"] != ""]
    parts = [(cause, failed[failed["failure"] == cause]) for cause in FAILURES]
    if "planner_failures" in rows:  # rows of earlier versions do not have it
        stuck = failed[failed["planner_failures"] > 0]
        commonest = stuck["planner_reason"].value_counts(sort=True)
        parts.append((f"of these, planner ({commonest.index[0]})" if len(stuck) else "planner", stuck))
    return [(reason, len(part), int(part.index[0])) for reason, part in parts if len(part)]


def mean_fm(rows: pd.DataFrame) -> float | None:
    """FM in m over the collision-free episodes that reached the goal (paper, Sec. V-B); None where there is none."""
    flown = rows.loc[rows["cfr"], "fm"]
    return None if flown.empty else float(flown.mean())


def score(rows: pd.DataFrame) -> dict[str, float]:
    """Figures by which policies of one training are compared; ``score`` decides.

    CFR counts; where it is equal (at first it is 0) the share of episodes without a collision does, then FM.
    """
    clear = float((~rows["failure"].isin(CONTACTS)).mean())
    cfr, fm = float(rows["cfr"].mean()), float(rows["fm"].mean())
    fm = fm if np.isfinite(fm) else 1e9
    total = cfr + 0.01 * clear + 0.001 / (1 + fm)
    return {"score": total, "cfr": cfr, "collision_free": clear, "fm": fm, "sr": float(rows["sr"].mean())}
