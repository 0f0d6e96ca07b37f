"""The policy as a file and as an agent."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from algos import checkpoint
from algos.checkpoint import CheckpointError
from algos.policy import Policy
from envs import scenarios
from envs.formation import FormationEnv
from envs.spec import ObservationSpec
from tests.algos.conftest import LAYOUT, encoder_spec, observation, spec, world


def policy(choice: str = "attention", balls: int = 2) -> Policy:
    layout = FormationEnv(world()).layout
    return Policy(encoder_spec(choice), layout, spec(ObservationSpec, "observation", "paper"), "crazyflie", balls)


def test_first_commands_hover() -> None:
    made = Policy(
        encoder_spec(),
        LAYOUT,
        spec(ObservationSpec, "observation", "paper"),
        "crazyflie",
        2,
        -0.7,
        hover=(0.0, 0.0, 0.0, 0.038),
    )
    command = made.command(observation())
    torch.testing.assert_close(command, torch.tensor([0, 0, 0, 0.038]).expand(5, 3, 4), atol=0.2, rtol=0)
    torch.testing.assert_close(made.head.bias.tanh(), torch.tensor([0, 0, 0, 0.038]))
    assert torch.equal(made.log_std, torch.full((4,), -0.7))


def test_round_trip_keeps_commands_and_facts(tmp_path: Path) -> None:
    made = policy()
    made.save(tmp_path / "p.pt", {"steps": 5, "weights": [0.1, 0.2, 0.3, 0.4], "curriculum": "none"})
    loaded = Policy.load(tmp_path / "p.pt")
    assert torch.equal(made.command(observation()), loaded.command(observation()))
    assert loaded.meta == {"steps": 5, "weights": [0.1, 0.2, 0.3, 0.4], "curriculum": "none"}
    assert (loaded.layout, loaded.encoder_spec, loaded.observation) == (
        made.layout,
        made.encoder_spec,
        made.observation,
    )
    assert (loaded.drone, loaded.balls) == ("crazyflie", 2)
    assert torch.load(tmp_path / "p.pt", weights_only=True)["content"]["layout"]["self_dim"] == 25


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("choice, changes", [("static", {"columns": 20}), ("dynamic", {"balls": 5}), ("free", {})])
def test_agent_flies_any_number_of_obstacles(choice: str, changes: dict[str, int], dtype: torch.dtype) -> None:
    made = world(choice, **changes)
    env = FormationEnv(made, dtype=dtype)
    drawn = scenarios.sample(made.scenario, 4, 0, dtype=dtype)
    act = policy().agent(env)
    state = env.reset(drawn)
    for _ in range(3):
        action = act(state, drawn)
        assert action.shape == (4, 3, 4) and action.abs().max() <= 1 and action.dtype == dtype
        state, _, _ = env.step(state, action, drawn)
    assert torch.equal(act(state, drawn), act(state, drawn))


def test_another_layout_is_refused_in_one_line() -> None:
    env = FormationEnv(replace(world(), observation=spec(ObservationSpec, "observation", "release")))
    with pytest.raises(
        ValueError, match=r"trained with observation=paper .*observation=release.*: use observation=paper"
    ) as e:
        policy().agent(env)
    assert "\n" not in str(e.value)


def test_another_conditioning_is_refused_with_the_setting_that_fits() -> None:
    seen = replace(world().observation, lookahead=0.0)
    with pytest.raises(ValueError, match=r"lookahead=2.0.*lookahead=0.0.*: use .* observation.lookahead=2.0$"):
        policy().agent(FormationEnv(replace(world(), observation=seen)))


def test_files_of_another_version(tmp_path: Path) -> None:
    made = policy()
    made.save(tmp_path / "p.pt")
    content = checkpoint.load(tmp_path / "p.pt", kind="policy")
    content["encoder"]["depth"] = 3
    checkpoint.save(tmp_path / "q.pt", content, kind="policy")
    with pytest.raises(CheckpointError, match=r"q\.pt holds a policy of another version"):
        Policy.load(tmp_path / "q.pt")
