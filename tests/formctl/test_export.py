"""``formctl export``: one graph, its contract, and the same numbers as torch."""

import hashlib
import json

import numpy as np
import pytest
import torch

from algos.export import contract as fields_of
from algos.export import onnx
from formctl import store
from formctl.settings import build, compose

pytest.importorskip("onnxscript")
pytest.importorskip("onnxruntime")


@pytest.fixture(scope="module")
def exported(call, tiny_words, stocked):
    """A finished export of the stocked store's policy: the answer and its run (tracing takes most of this file)."""
    words = ("scenario.duration=1", "drone.thrust_range=[0.4,0.9]", "--observations", "1000")
    answer = call("export", "ours", *tiny_words, f"runs={stocked}", *words)
    assert answer.code == 0, answer.err
    return answer, store.latest(stocked, "export", "ours")


def test_equal_to_torch_with_two_numbers_of_balls(exported):
    answer, run = exported
    contract = json.loads((run.path / "contract.json").read_text())
    proofs = contract["parity"]["flights"]
    assert [proof["balls"] for proof in proofs] == [2, 5]
    assert {proof["observations"] for proof in proofs} == {1000}
    assert all(0 <= value <= 1e-5 for proof in proofs for value in proof["largest"].values())
    assert run.record["result"]["parity"] == proofs and "torch against onnxruntime" in answer.out


def test_the_contract_names_the_graph(exported):
    _, run = exported
    contract = json.loads((run.path / "contract.json").read_text())
    session = onnx.session(run.path / "policy.onnx")
    assert [entry["name"] for entry in contract["inputs"]] == [entry.name for entry in session.get_inputs()]
    assert [entry["name"] for entry in contract["outputs"]] == [entry.name for entry in session.get_outputs()]
    assert contract["files"]["policy.onnx"] == hashlib.sha256((run.path / "policy.onnx").read_bytes()).hexdigest()
    assert contract["rate_hz"] == 50 and contract["limits"]["thrust_range"] == [0.4, 0.9]
    own = contract.pop("sha256")
    assert own == hashlib.sha256(json.dumps(contract, sort_keys=True).encode()).hexdigest()


def test_limits_and_absent_obstacles_are_inside(exported, stocked):
    """Any number of columns, balls that do not fly ignored, thrust clamped: from onnxruntime alone."""
    _, run = exported
    session = onnx.session(run.path / "policy.onnx")
    config = compose(["scenario=mixed"])
    from algos.policy import Policy

    policy = Policy.load(store.resolve("train/ours", stocked).path / "policy.pt")
    env = build.environment(build.world(config), "torch")
    inputs = {name: value.numpy() for name, value in fields_of.blank(policy, env, 3, 1, 1).items()}
    rates, thrust, command = session.run(None, inputs)
    other = inputs | {"ball_position": np.full((3, 4, 3), 0.5, np.float32)}
    other |= {"ball_velocity": np.ones((3, 4, 3), np.float32), "ball_flying": np.zeros((3, 4), bool)}
    assert session.run(None, other)[2] == pytest.approx(command, abs=1e-6)
    assert thrust.min() >= 0.4 and thrust.max() <= 0.9 and rates == pytest.approx(np.pi * command[..., :3], abs=1e-5)
    with torch.no_grad():
        torch_command = policy.command(env.observe(env.reset(_still(env, 3)), _still(env, 3)))
    first = session.run(None, inputs | {"columns": _still(env, 3).columns.numpy()})[2]
    assert first == pytest.approx(torch_command.numpy(), abs=1e-5)


def _still(env, episodes):
    from envs.scenarios import sample

    return sample(env.world.scenario, episodes, seed=0)


def test_a_missing_package_is_one_line(call, tiny_words, stocked, monkeypatch):
    monkeypatch.setattr(onnx, "find_spec", lambda name: None if name == "onnx" else True)
    answer = call("export", "ours", *tiny_words, f"runs={stocked}")
    assert answer.code == 2 and answer.line == "export needs onnx: pip install 'formctl[export]'"


def test_a_file_that_differs_is_refused(exported, stocked, monkeypatch):
    """Parity is measured, not assumed: another policy's graph does not pass."""
    from algos.policy import Policy
    from formctl.deployment.export import Subject, prove_onnx
    from formctl.errors import RunFailed
    from formctl.evaluation.methods import Method, PolicyAgent

    _, run = exported
    config = compose(["scenario=mixed", "scenario.duration=0.5"])
    policy = Policy.load(store.resolve("train/ours", stocked).path / "policy.pt")
    with torch.no_grad():
        policy.head.bias += 0.01
    env = build.environment(build.world(config), "torch")
    with pytest.raises(RunFailed, match="do not fly this file"):
        prove_onnx(
            Subject(Method({}, "", (), PolicyAgent, trained=policy), config, env), run.path / "policy.onnx", 50, 2
        )
