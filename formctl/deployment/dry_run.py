"""The dry run of a deployment: an evaluated episode flown again, as the set-points that would have been sent."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from baselines.protocol import Agent
from envs.deployment import Link
from envs.flight import Watch
from envs.formation import FormationEnv
from envs.scenarios import select
from envs.spec import State
from formctl import console
from formctl.deployment import crazyflie
from formctl.errors import RunFailed
from formctl.evaluation import stored
from formctl.evaluation.flight import EpisodeWorker, rows_of
from formctl.settings import build, compose
from formctl.store.files import write_text

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from formctl.settings import Config


def write_setpoints(text: str, config: "Config", out: Path, policy: str | None = None) -> None:
    """Turn RUN:EPISODE into a stream of set-points, write and check it; ``policy`` is where the one that flew is.

    Raises StoreError for an episode that is not there or cannot be drawn again, RunFailed where a hard check fails.
    """
    episode = stored.find(text, config.runs, policy)
    settings, row = episode.config, episode.row
    build.use_threads(settings)
    commands, again = fly_again(episode)
    if again["cfr"] != row["cfr"] or again["failure"] != row["failure"]:
        raise RunFailed(f"{text} ended with {row['failure'] or 'success'!r}, flown again with {again['failure']!r}")
    limits = settings.deploy or compose(["deploy=mocap"]).deploy
    assert limits is not None
    stream = crazyflie.setpoints(commands, settings.drone, settings.drone.control_period)
    write_text(out, "\n".join(crazyflie.lines(stream)) + "\n")
    checks = crazyflie.checks(stream, limits, settings.drone)
    seconds = len(stream.time) * settings.drone.control_period
    console.say(f"{text}: {row['method']} in {row['scenario']}, {seconds:.1f} s, {row['failure'] or 'success'}")
    rows = [(check.what, check.found, check.allowed, check.verdict) for check in checks]
    console.table(("check", "found", "allowed", ""), rows, title="cflib: send_setpoint(roll, pitch, yawrate, thrust)")
    console.say(f"set-points: {out}")
    if failed := [check for check in checks if check.hard and not check.ok]:
        unclipped = "" if settings.deploy else "; it was flown without a deployment's clip: fly it with formctl deploy"
        raise RunFailed(f"{text} may not be sent: {', '.join(check.what for check in failed)}{unclipped}")
    if (cut := crazyflie.cut(stream)).any():
        low, high = limits.thrust_clip[0], crazyflie.largest_share(settings.drone)
        console.warn(
            f"the firmware cuts {np.count_nonzero(cut)} of {cut.size} set-points ({np.mean(cut > 0):.1%}) to"
            f" {crazyflie.THRUST_CUT}, by up to {cut.max():.1%} of their thrust; to have none cut, fly with"
            f" formctl deploy ... drone.thrust_range=[{low:g},{high:g}]"
        )


def fly_again(episode: stored.StoredEpisode) -> "tuple[NDArray[np.float64], dict[str, Any]]":
    """The commands (T, N, 4) in [-1, 1] that were sent until the goal, and the row of the flight."""
    sent: list[torch.Tensor] = []

    def observe(env: FormationEnv, agent: Agent, start: State) -> Watch:
        def note(state: State, *_: Any) -> None:
            sent.append((agent.sent if isinstance(agent, Link) else state.command)[0])

        return note

    worker = EpisodeWorker.of(episode.method, episode.scene.world, episode.config)
    alone = select(episode.scene.bank.scenarios, slice(episode.episode, episode.episode + 1))
    (again,) = rows_of(worker.fly(alone, observe))
    passed = again["time_to_goal"] if again["reached"] else episode.config.eval.time_limit
    return torch.stack(sent)[: round(passed / worker.env.dt)].double().numpy(), again
