"""Several processes that train together: one set of networks, reproducible, resumed bit for bit, changed in number."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from algos import checkpoint
from algos.replicas import ALONE, Replicas
from algos.trainer import Trainer, TrainSettings, share
from formctl import processes
from tests.algos.conftest import mappo, run, shac, train_settings
from tests.algos.test_trainer import TWO


@pytest.fixture(scope="module")
def pair() -> Iterator[Replicas]:
    """This process and another one, which follows through all the tests."""
    with processes.replicas(2) as replicas:
        yield replicas


def settings(learner: str) -> TrainSettings:
    small = replace(train_settings(updates=4), curriculum=TWO)
    return small if learner == "mappo" else replace(small, algo=shac(envs=8, rollout=4))


def begin(chosen: TrainSettings, replicas: Replicas) -> Trainer:
    replicas.tell(chosen)
    return Trainer(chosen, replicas=replicas)


def without_times(progress: list[Any]) -> list[Any]:
    times = ("steps_per_second",)
    return [(p.steps, p.period, {k: v for k, v in p.metrics.items() if k not in times}) for p in progress]


@pytest.mark.parametrize("learner", ["mappo", "shac"])
def test_two_processes_learn_one_policy_and_resume_bit_for_bit(pair: Replicas, tmp_path: Path, learner: str) -> None:
    """The stop falls into the second period, between two pools of scenarios."""
    straight = begin(settings(learner), pair)
    progress = run(straight)
    states = straight.states()
    networks = [checkpoint.digest({k: v for k, v in s["learner"].items() if k != "generator"}) for s in states]
    assert networks[0] == networks[1], "the same networks, optimisers and normaliser in both"
    assert not torch.equal(states[0]["learner"]["generator"], states[1]["learner"]["generator"])
    columns = [state["arena"]["scenarios"]["columns"] for state in states]
    assert columns[0].shape[0] == 4 and not torch.equal(*columns), "each flies other episodes"

    stopped = begin(settings(learner), pair)
    begun = run(stopped, 3)
    checkpoint.save(tmp_path / "latest.pt", {"states": stopped.states()})
    resumed = begin(settings(learner), pair)
    resumed.load_states(checkpoint.load(tmp_path / "latest.pt")["states"])
    rest = run(resumed)
    assert without_times(begun + rest) == without_times(progress)
    ours = ("learner", "arena", "steps", "plan")
    for one, other in zip(states, resumed.states(), strict=True):
        assert checkpoint.digest({k: one[k] for k in ours}) == checkpoint.digest({k: other[k] for k in ours})


def test_a_training_goes_on_in_another_number_of_processes(pair: Replicas) -> None:
    two = begin(settings("shac"), pair)
    run(two, 3)
    states = two.states()
    one = Trainer(settings("shac"))
    one.load_states(states)
    assert one.steps == 96 and one.stage.period.name == "mixed" and one.arena.scenarios.columns.shape[0] == 8
    assert checkpoint.digest(dict(one.policy.state_dict())) == checkpoint.digest(dict(two.policy.state_dict()))
    assert [p.steps for p in run(one)] == [128]
    back = begin(settings("shac"), pair)
    back.load_states([states[0]])
    assert [p.steps for p in run(back)] == [128]
    after = [dict(state["learner"]["fast"]) for state in back.states()]
    assert checkpoint.digest(after[0]) == checkpoint.digest(after[1])


def test_figures_and_gradients_are_means_in_the_order_of_ranks(monkeypatch: pytest.MonkeyPatch) -> None:
    def gather(parts: list[torch.Tensor], values: torch.Tensor) -> None:
        for rank, part in enumerate(parts):
            part.copy_(values * (1 + rank))

    monkeypatch.setattr(torch.distributed, "all_gather", gather)
    three = Replicas(1, 3)
    assert three.mean_figures({"a": 1.0, "b": -2.0}) == {"a": 2.0, "b": -4.0}
    weight, bias = torch.nn.Parameter(torch.zeros(2, 3)), torch.nn.Parameter(torch.zeros(2))
    loss = (weight * torch.arange(6.0).view(2, 3)).sum() + 5 * bias.sum()
    (loss + 7).backward()
    assert three.average_gradients([weight, bias], loss + 7).item() == 14
    torch.testing.assert_close(weight.grad, 2 * torch.arange(6.0).view(2, 3))
    torch.testing.assert_close(bias.grad, torch.full((2,), 10.0))
    assert ALONE.average_gradients([weight], loss) is loss


def test_shares_of_a_learner() -> None:
    assert share(mappo(envs=8, pool=16), 4).envs == 2 and share(mappo(envs=8, pool=16), 4).pool == 4
    assert share(shac(), 1) is not None and share(shac(envs=4, pool=4), 2).pool == 2
    with pytest.raises(ValueError, match=r"algo.envs=8 does not divide into train.processes=3: choose one of \[1, 2"):
        share(mappo(), 3)
