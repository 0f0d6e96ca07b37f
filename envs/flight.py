"""Flying episodes: any agent, any physics, one row per episode."""

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from envs import metrics
from envs.formation import FormationEnv
from envs.metrics import EvalSpec
from envs.spec import Events, Scenarios, State

Act = Callable[[State, Scenarios], Tensor]
"""Commands (E, N, 4) in [-1, 1] for the episodes' states."""

Watch = Callable[[State, Tensor, Events], None]
"""Called after every step with the new state, the reward vector (E, N, 4) and the events: recorders, progress bars."""


@torch.no_grad()
def fly(
    env: FormationEnv, act: Act, scenarios: Scenarios, evaluation: EvalSpec, watch: Watch | None = None
) -> dict[str, np.ndarray]:
    """Fly ``evaluation.seconds`` of every scenario with ``act`` and return one entry per episode and metric column.

    Episodes are never cut: what happens is latched by ``envs.metrics``. Drones that have crashed below the ground
    limit keep being integrated; their rows already say so. Rows are made of samples 20 ms apart at every control rate.
    """
    state = sampled = env.reset(scenarios)
    log, span = metrics.start(env, state, evaluation), metrics.span(env)
    update = env.compiler(metrics.update)
    steps: list[Events] = []
    for _ in range(round(evaluation.seconds / env.dt)):
        state, reward, events = env.step(state, act(state, scenarios), scenarios)
        steps.append(events)
        if len(steps) == span:
            log = update(log, env, state, metrics.merged(steps, sampled, state), evaluation)
            steps, sampled = [], state
        if watch is not None:
            watch(state, reward, events)
    return metrics.rows(log, evaluation)
