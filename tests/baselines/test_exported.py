"""Policies of other libraries, as exported programs, and agents out of files."""

import pytest
import torch
from torch import nn

from baselines import exported, registry
from envs.interfaces.stream import flatten
from envs.scenarios import sample
from formctl.evaluation import methods


class Net(nn.Module):
    def __init__(self, width: int, out: int = 4) -> None:
        super().__init__()
        torch.manual_seed(0)
        self.layer = nn.Linear(width, out)

    def forward(self, seen):
        return self.layer(seen).tanh()


@pytest.fixture
def world(make_env):
    return make_env("scenario=mixed", dtype=torch.float32)


@pytest.fixture
def file(world, tmp_path):
    """An exported network of the mixed scene, and the network."""
    net = Net(25 + 14 + 9 + 20 + 1 + 2)
    exported.save(tmp_path / "net.pt2", net, world, {"name": "own", "steps": 7, "algo": "mine"})
    return tmp_path / "net.pt2", net


def agent(file, env):
    return exported.ExportedPolicy("own", env, exported.ExportedSpec(str(file)))


def test_commands_are_the_network_s(file, world):
    path, net = file
    for episodes in (1, 5):
        scenarios = sample(world.world.scenario, episodes, 3, world.dtype)
        state = world.reset(scenarios)
        told = agent(path, world).act(state, scenarios)
        with torch.no_grad():
            torch.testing.assert_close(told, net(flatten(world.observe(state, scenarios))))


def test_fewer_balls_are_absent_ones(file, make_env):
    path, net = file
    none = make_env("scenario=static", dtype=torch.float32)
    scenarios = sample(none.world.scenario, 2, 3, none.dtype)
    state = none.reset(scenarios)
    seen = none.observe(state, scenarios)
    blank = torch.zeros(2, 3, 20)
    parts = [seen[name].flatten(2) for name in ("self", "drones", "static")]
    vector = torch.cat((*parts, blank, seen["static_mask"].float(), torch.zeros(2, 3, 2)), -1)
    with torch.no_grad():
        torch.testing.assert_close(agent(path, none).act(state, scenarios), net(vector))


def test_what_does_not_fit_is_refused_in_one_line(file, make_env, tmp_path, world):
    path, net = file
    with pytest.raises(ValueError, match="made for 2 balls at most, the scene has 5"):
        agent(path, make_env("scenario=mixed", "scenario.balls=5"))
    with pytest.raises(ValueError, match="flies 3 drones, the formation has 4"):
        agent(path, make_env("scenario=mixed", "scenario.formation=square"))
    with pytest.raises(ValueError, match=r"there is no policy .*nothing\.pt2"):
        exported.load(tmp_path / "nothing.pt2")
    (tmp_path / "damaged.pt2").write_bytes(path.read_bytes()[:900])
    with pytest.raises(ValueError, match="is damaged, of another torch"):
        exported.load(tmp_path / "damaged.pt2")
    with pytest.raises(ValueError, match=r"has to end in \.pt2"):
        exported.save(tmp_path / "net.pt", net, world)
    with pytest.raises(ValueError, match=r"the network gives \(2, 3, 5\)"):
        exported.save(tmp_path / "net.pt2", Net(71, out=5), world)


def test_a_policy_file_becomes_a_method_with_its_facts(file, world, tmp_path):
    method = methods.policy(str(file[0]), tmp_path)
    assert (method.name, method.facts["steps"], method.facts["algo"]) == ("own", 7, "mine")
    assert len(method.facts["sha256"]) == 64
    assert method.make(world).capabilities.batched


OWN = """
from dataclasses import dataclass
import torch
from baselines.protocol import Capabilities

@dataclass(frozen=True)
class Settings:
    thrust: float = 0.5

class Up:
    capabilities = Capabilities(command="ctbr", batched=True, needs_ball_parameters=False, max_drones=None)
    def __init__(self, name, env, spec: Settings):
        self.name, self.spec = name, spec
    def reset(self, scenarios, state): ...
    def act(self, state, scenarios):
        return torch.full((*state.position.shape[:2], 4), self.spec.thrust)

class Plain(Up):
    def __init__(self, name, env):
        self.name, self.spec = name, Settings()
"""


@pytest.mark.parametrize(("words", "thrust"), [([], 0.5), (["baseline.thrust=0.75"], 0.75)])
def test_a_class_in_a_file_is_flown_with_its_settings(words, thrust, world, tmp_path):
    (tmp_path / "up.py").write_text(OWN)
    method = methods.baseline(f"{tmp_path / 'up.py'}:Up", words)
    assert method.name == "up" and len(method.facts["sha256"]) == 64
    flown = method.make(world)
    scenarios = sample(world.world.scenario, 2, 0, world.dtype)
    assert flown.act(world.reset(scenarios), scenarios).unique().item() == thrust


def test_a_class_without_settings_needs_none(world, tmp_path):
    (tmp_path / "up.py").write_text(OWN)
    assert methods.baseline(f"{tmp_path / 'up.py'}:Plain").make(world).spec.thrust == 0.5
    with pytest.raises(ValueError, match=r"baseline\.thrust: it takes no settings"):
        registry.make("up", world, {"target": f"{tmp_path / 'up.py'}:Plain", "thrust": 1})


def test_a_changed_file_is_read_again(world, tmp_path):
    (tmp_path / "up.py").write_text(OWN)
    assert methods.baseline(f"{tmp_path / 'up.py'}:Up").make(world).spec.thrust == 0.5
    (tmp_path / "up.py").write_text(OWN.replace("0.5", "0.25"))
    assert methods.baseline(f"{tmp_path / 'up.py'}:Up").make(world).spec.thrust == 0.25


@pytest.mark.parametrize(
    ("target", "message"),
    [
        ("up.py:Nobody", "has no Nobody"),
        ("missing.py:Up", "No such file"),
        ("broken.py:Up", "invalid syntax"),
        ("up.py:Settings", "is no agent"),
    ],
)
def test_a_file_that_cannot_be_flown_says_why(target, message, tmp_path):
    (tmp_path / "up.py").write_text(OWN)
    (tmp_path / "broken.py").write_text("def (")
    with pytest.raises(ValueError, match=message) as caught:
        methods.baseline(str(tmp_path / target))
    assert "\n" not in str(caught.value)
