"""Training on from a policy: it is where the training begins, it is judged first, and what does not fit is refused."""

import pytest
import torch

from algos import checkpoint
from algos.trainer import Trainer
from formctl import store
from formctl.evaluation import methods
from formctl.settings import build, compose

QUICK = ["curriculum=none", "train.steps=64", "train.judge_steps=1000000"]


def weights(path):
    return checkpoint.load(path, kind="policy")["weights"]


@pytest.mark.parametrize("algo", ["mappo_fast", "shac"])
def test_a_training_begins_with_the_policy(algo):
    config = compose([f"algo={algo}", "curriculum=none", "train.compile=false"])
    trainer = Trainer(build.training(config))
    policy = methods.policy("mixed", config.runs).policy()
    trainer.begin_from(policy)
    known = policy.state_dict()
    assert all(torch.equal(x, known[name]) for name, x in trainer.policy.state_dict().items())


def test_what_a_run_says_of_its_start(formctl_stocked, stocked):
    assert formctl_stocked("train", *QUICK, "start=ours", "name=on").code == 0
    run = store.resolve("on", stocked)
    ours = store.resolve("ours", stocked)
    assert run.record["start"] == {"policy": "ours", "name": "ours", "run": ours.id}
    assert run.record["parents"] == [ours.id]


def test_the_policy_itself_is_kept_where_nothing_better_came(formctl_stocked, stocked, monkeypatch):
    from formctl.stages import train

    scores = iter([1.0, 0.5, 0.25, 0.125])
    judged = {"cfr": 0.0, "fm": 1.0, "sr": 0.0, "collision_free": 0.0}
    monkeypatch.setattr(train, "judge", lambda config: lambda policy: judged | {"score": next(scores)})
    assert formctl_stocked("train", *QUICK, "start=ours", "name=kept").code == 0
    run = store.resolve("kept", stocked)
    assert run.record["result"]["policy_steps"] == 0
    known, kept = (weights(store.resolve(name, stocked).path / "policy.pt") for name in ("ours", "kept"))
    assert all(torch.equal(kept[name], known[name]) for name in known)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["start=nothing"], "shipped with formctl"),
        (["start=swarm_rl"], "only policies that formctl train has written can be trained on"),
        (["start=ours", "observation=release"], "use observation=paper"),
        (["start=ours", "encoder=mlp"], "is built otherwise"),
    ],
)
def test_what_does_not_fit_is_refused_before_a_run_is_made(formctl_stocked, stocked, words, message):
    before = len(store.scan(stocked, kind="train"))
    answer = formctl_stocked("train", *QUICK, *words)
    assert answer.code == 2
    assert message in answer.line
    assert len(store.scan(stocked, kind="train")) == before
