"""Several planners in one world (what they do to rows: tests/formctl/test_jobs.py)."""

import pytest
import torch

from baselines.planner.batched import BatchedPlanners
from envs.scenarios import sample, select
from envs.spec import State
from tests.baselines import example


def test_every_episode_has_the_commands_that_it_has_alone(make_env):
    env = make_env("scenario=mixed", "scenario.throw_time=[0.1,0.3]", dtype=torch.float32)
    scenarios = sample(env.world.scenario, 3, 0, env.dtype)
    together, alone = BatchedPlanners([example.make(env) for _ in range(3)]), [example.make(env) for _ in range(3)]
    state = env.reset(scenarios)
    together.reset(scenarios, state)
    ones = [slice(number, number + 1) for number in range(3)]
    for planner, own in zip(alone, ones, strict=True):
        planner.reset(select(scenarios, own), State(*(field[own] for field in state)))
    for _ in range(20):
        command = together.act(state, scenarios)
        for planner, own in zip(alone, ones, strict=True):
            mine = planner.act(State(*(field[own] for field in state)), select(scenarios, own))
            assert torch.equal(mine, command[own])
        state = env.advance(state, command, scenarios)[1]


def test_a_planner_for_every_episode(make_env):
    env = make_env("scenario=free")
    scenarios = sample(env.world.scenario, 2, 0, env.dtype)
    with pytest.raises(ValueError, match="3 planners cannot fly 2 episodes"):
        BatchedPlanners([example.make(env) for _ in range(3)]).reset(scenarios, env.reset(scenarios))
