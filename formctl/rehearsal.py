"""The dry run of a deployment: an evaluated episode flown again, as the set-points that would have been sent."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from envs.bank import Bank
from envs.deployment import Link
from envs.flight import fly
from envs.scenarios import cast, select
from formctl import build, console, crazyflie, methods, store
from formctl.config import compose, restore
from formctl.errors import RunFailed
from formctl.evaluation import read_rows
from formctl.files import StoreError, write_text

if TYPE_CHECKING:
    import pandas as pd
    from numpy.typing import NDArray

    from formctl.config import Config
    from formctl.methods import Method


def rehearse(text: str, config: "Config", out: Path) -> None:
    """Turn RUN:EPISODE into a stream of set-points, write and check it.

    Raises StoreError for an episode that is not there or cannot be drawn again, RunFailed where a check fails.
    """
    run, row = find(text, config.runs)
    flown = restore(run.config)
    commands, again = fly_again(run, row, flown, config.runs)
    if bool(again["cfr"]) != bool(row["cfr"]) or again["failure"] != row["failure"]:
        raise RunFailed(f"{text} ended with {row['failure'] or 'success'!r}, flown again with {again['failure']!r}")
    limits = flown.deploy or compose(["deploy=mocap"]).deploy
    assert limits is not None
    stream = crazyflie.setpoints(commands, flown.drone, flown.drone.control_period)
    write_text(out, "\n".join(crazyflie.lines(stream)) + "\n")
    checks = crazyflie.checks(stream, limits, flown.drone)
    seconds = len(stream.time) * flown.drone.control_period
    console.say(f"{text}: {row['method']} in {row['scenario']}, {seconds:.1f} s, {row['failure'] or 'success'}")
    rows = [(check.what, check.found, check.allowed, "ok" if check.ok else "NOT OK") for check in checks]
    console.table(("check", "found", "allowed", ""), rows, title="cflib: send_setpoint(roll, pitch, yawrate, thrust)")
    console.say(f"set-points: {out}")
    if failed := [check for check in checks if not check.ok]:
        unclipped = "" if flown.deploy else "; it was flown without a deployment's clip: fly it with formctl deploy"
        raise RunFailed(f"{text} may not be sent: {', '.join(check.what for check in failed)}{unclipped}")


def find(text: str, root: Path) -> "tuple[store.Run, pd.Series[Any]]":
    """The evaluation and the row that RUN:EPISODE means; episodes are counted from 0 in the order of the rows."""
    name, colon, number = text.rpartition(":")
    if not colon or not number.isdigit():
        raise StoreError(f"{text!r} names no episode: write RUN:EPISODE, for example main:0")
    run = store.resolve(name, root, kind="eval", holding="episodes.parquet")
    rows = read_rows(run.path / "episodes.parquet")
    if int(number) >= len(rows):
        raise StoreError(f"{run.path} has no episode {number}: it holds 0 to {len(rows) - 1}")
    return run, rows.iloc[int(number)]


def fly_again(
    run: store.Run, row: "pd.Series[Any]", config: "Config", root: Path
) -> "tuple[NDArray[np.float64], dict[str, Any]]":
    """The commands (T, N, 4) in [-1, 1] that were sent until the goal, and the row of the flight."""
    counts = {"columns": int(row["columns"]), "balls": int(row["balls"])}
    config = restore(config.tree | {"scenario": config.tree["scenario"] | counts})
    facts = next(bank for bank in run.record["banks"] if bank["sha256"] == row["bank"])
    bank = Bank.create(config.scenario, facts["episodes"], facts["seed"])
    if bank.sha256 != row["bank"]:
        raise StoreError(f"{run.path} flew bank {row['bank'][:12]}, which its seed does not draw again: fly it anew")
    build.use_threads(config)
    env = build.environment(build.world(config), config.sim, config.deploy)
    agent = build.linked(method(run, root).make(env), env, config.deploy)
    chosen = cast(select(bank.scenarios, bank.scenarios.id == int(row["scenario_id"])), env.dtype)
    agent.reset(chosen, env.reset(chosen))
    sent: list[torch.Tensor] = []

    def watch(state: Any, reward: Any) -> None:
        sent.append((agent.sent if isinstance(agent, Link) else state.command)[0])

    again = {name: values[0] for name, values in fly(env, agent.act, chosen, config.eval, watch).items()}
    passed = again["time_to_goal"] if again["reached"] else config.eval.time_limit
    return torch.stack(sent)[: round(passed / env.dt)].double().numpy(), again


def method(run: store.Run, root: Path) -> "Method":
    """Who flew an evaluation."""
    facts = run.record["method"]
    if facts["kind"] == "policy":
        return methods.policy(facts["run"], root)
    return methods.baseline(facts["name"], settings=run.config["baseline"])
