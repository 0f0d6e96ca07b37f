"""The published network's size, and the actor that is flown."""

from dataclasses import replace

import pytest
import torch

from algos.learner import Problem
from algos.networks import ActorCritic
from algos.policy import Policy
from baselines.swarm_rl.agent import load
from baselines.swarm_rl.network import SelfAttention, SwarmRlEncoderSpec
from envs.scenarios import sample
from tests.baselines.conftest import compose


def networks(*overrides: str, **seen: int) -> ActorCritic:
    config = compose("experiment=swarm_rl", *overrides)
    observation = replace(config.observation, **seen)
    layout = observation.layout(config.scenario)
    problem = Problem(
        config.encoder, layout, observation, config.drone, 2, (0.25, 0.25, 0.25, 0.25), torch.device("cpu")
    )
    return ActorCritic(problem, config.algo.log_std, config.algo.share_encoder)


def size(module: torch.nn.Module) -> int:
    return sum(parameter.numel() for parameter in module.parameters())


def test_without_balls_it_has_the_published_number_of_parameters() -> None:
    published = networks(balls=0)
    assert size(published) == 3_304_969
    assert size(published.policy.encoder) == 1_651_200


def test_the_paper_s_balls_are_one_more_token() -> None:
    """A perceptron 12 -> 256 -> 256 and 256 more inputs of the last layer, in actor and critic."""
    more = 12 * 256 + 256 + 256 * 256 + 256 + 256 * 512
    assert size(networks()) == 3_304_969 + 2 * more
    assert size(networks("encoder=swarm_rl_small")) < 150_000


def test_attention_is_the_textbook_s() -> None:
    torch.manual_seed(0)
    spec = SwarmRlEncoderSpec("test", width=8, layers=1, heads=4, key_width=6, features=8)
    ours, tokens = SelfAttention(spec), torch.randn(5, 3, 8)
    query, key, value = (
        layer(tokens).unflatten(-1, (4, 6)).transpose(1, 2) for layer in (ours.query, ours.key, ours.value)
    )
    theirs = torch.nn.functional.scaled_dot_product_attention(query, key, value).transpose(1, 2).flatten(2)
    torch.testing.assert_close(ours(tokens), ours.out(theirs))


def test_what_training_saves_is_what_the_agent_flies(tmp_path, make_env, make_agent) -> None:
    torch.manual_seed(1)
    policy: Policy = networks("encoder=swarm_rl_small").policy
    policy.save(tmp_path / "policy.pt", {"steps": 7})
    env = make_env("experiment=swarm_rl", "scenario=mixed", dtype=torch.float32)
    scenarios = sample(env.world.scenario, 3, 0)
    state = env.reset(scenarios)
    agent = make_agent("swarm_rl", env, f"baseline.policy={tmp_path / 'policy.pt'}")
    agent.reset(scenarios, state)
    torch.testing.assert_close(agent.act(state, scenarios), policy.agent(env)(state, scenarios))
    assert load(str(tmp_path / "policy.pt"))[2] == {"steps": 7}


def test_first_commands_hover() -> None:
    policy = networks("encoder=swarm_rl_small").policy
    assert policy.head.bias.tanh().tolist() == pytest.approx([0.1381] * 4, abs=1e-4)


def test_files_that_are_no_policy_of_swarm_rl_are_refused_in_one_line(tmp_path) -> None:
    (tmp_path / "noise.pt").write_bytes(b"noise")
    for policy, message in (
        (str(tmp_path / "nowhere.pt"), "there is no policy .*nowhere.pt: train one with"),
        (str(tmp_path / "noise.pt"), "noise.pt is damaged, or no policy of"),
    ):
        with pytest.raises(ValueError, match=message) as caught:
            load(policy)
        assert "\n" not in str(caught.value)


def test_worlds_that_it_cannot_fly_in_are_refused(tmp_path, make_env, make_agent) -> None:
    for words, message in (
        (("scenario=free",), "'swarm_rl' commands rotor, this world takes ctbr"),
        (("drone=crazyflie_rotor", "scenario.formation=[[0,0,0],[1,0,0]]"), "flies at least 3 drones"),
        (("drone=crazyflie_rotor", "drone.control_period=0.02"), "use drone.control_period=0.01"),
    ):
        with pytest.raises(ValueError, match=message):
            make_agent("swarm_rl", make_env(*words))
