"""Composition: what wins over what, what is saved, sweeps, and that every shipped file composes."""

from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from hydra.core.global_hydra import GlobalHydra

from envs.vocabulary import Weights
from formctl.settings import ConfigError, chosen, compose, conf_dir, expand_sweep, restore
from tests.cli.conftest import Result

DEFAULTS = chosen()
CHOICES = [
    f"{path.parent.name}={path.stem}"
    for path in sorted(conf_dir().glob("*/*.yaml"))
    if DEFAULTS.get(path.parent.name) not in (None, path.stem) or path.parent.name in ("baseline", "experiment")
]


def test_defaults_are_the_laptop_profile_with_its_learner() -> None:
    config = compose()
    assert (config.profile, config.scenario.name, config.sim, config.seed) == ("laptop", "mixed", "torch", 0)
    assert config.tree["algo"]["target"] == "algos.shac.ShacSpec"
    assert config.search.scenario.name == "stage1"
    assert config.runs == Path("runs")
    assert config.baseline is None


@pytest.mark.parametrize("choice", CHOICES)
def test_every_shipped_choice_composes(choice: str) -> None:
    config = compose([choice])
    assert restore(config.tree) == config


def test_the_command_line_beats_the_profile_and_the_profile_beats_the_group() -> None:
    smoke = compose(["profile=smoke"])
    assert smoke.train.compile is False
    assert smoke.search.trials < compose().search.trials
    changed = compose(["train.compile=true", "profile=smoke", "search.trials=7"])
    assert changed.train.compile is True
    assert changed.search.trials == 7
    assert compose(["profile=smoke", "algo=mappo_fast"]).algo.envs == 128
    assert compose(["profile=smoke", "algo=mappo_fast", "algo.envs=64"]).algo.envs == 64


def test_an_experiment_changes_other_groups_and_is_stamped() -> None:
    config = compose(["experiment=release", "scenario.balls=1"])
    assert config.experiment == "release"
    assert (config.observation.name, config.encoder.name, config.scenario.ball_aim) == ("release", "release", "box")
    assert config.scenario.balls == 1


def test_weights_come_in_the_order_of_the_reward_vector() -> None:
    assert compose(["weights=release"]).weights == (0.142409, 0.126483, 0.218762, 0.512345)


def test_a_weight_reference_is_resolved_by_whoever_knows_the_store() -> None:
    asked = []

    def resolve(reference: str) -> Weights:
        asked.append(reference)
        return (0.1, 0.2, 0.3, 0.4)

    config = compose(["weights=@studies/pilot/trial=17"], resolve)
    assert asked == ["studies/pilot/trial=17"]
    assert config.weights == (0.1, 0.2, 0.3, 0.4)
    assert config.tree["weights"]["name"] == "@studies/pilot/trial=17"
    with pytest.raises(ConfigError, match=r"sum to 1\.1, not to 1"):
        compose(["weights=@pilot/best"], lambda reference: (0.2, 0.2, 0.3, 0.4))


def test_what_is_saved_is_what_was_used_and_composes_to_the_same() -> None:
    config = compose(["train.steps=2e6", "scenario.formation=[[0,0,0],[1,0,0],[0,1,0]]", "baseline=straight_line"])
    assert config.tree["train"]["steps"] == 2_000_000
    assert config.scenario.formation == ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    saved = yaml.safe_load(yaml.safe_dump(config.tree))
    assert restore(saved) == config


def test_a_saved_tree_with_a_foreign_key_is_refused() -> None:
    tree = compose().tree
    with pytest.raises(ConfigError, match="unknown key 'speed'"):
        restore({**tree, "speed": 3})
    with pytest.raises(ConfigError, match=r"unknown key 'scenario\.speed'"):
        restore({**tree, "scenario": {**tree["scenario"], "speed": 3}})


def test_sweeps_expand_in_the_order_typed() -> None:
    assert expand_sweep(["seed=0,1", "encoder=no_sa", "scenario.columns=5,10"]) == [
        ["seed=0", "encoder=no_sa", "scenario.columns=5"],
        ["seed=0", "encoder=no_sa", "scenario.columns=10"],
        ["seed=1", "encoder=no_sa", "scenario.columns=5"],
        ["seed=1", "encoder=no_sa", "scenario.columns=10"],
    ]
    assert expand_sweep(["scenario.field=[2,34]"]) == [["scenario.field=[2,34]"]]
    assert expand_sweep(["weights=@a/best,@b/trial=3"]) == [["weights=@a/best"], ["weights=@b/trial=3"]]


def test_a_sweep_is_checked_whole_before_anything_runs(formctl: Callable[..., Result]) -> None:
    result = formctl("conf", "show", "-m", "search.trials=1,0")
    assert result == Result(2, "", "formctl: search.trials=0 cannot be used: it should be greater than or equal to 1\n")


def test_show_prints_yaml_that_can_be_read_back(formctl: Callable[..., Result]) -> None:
    result = formctl("conf", "show", "profile=smoke", "seed=5")
    assert result.code == 0
    assert restore(yaml.safe_load(result.out)) == compose(["profile=smoke", "seed=5"])


def test_a_sweep_is_shown_as_one_document_each(formctl: Callable[..., Result]) -> None:
    documents = list(yaml.safe_load_all(formctl("conf", "show", "-m", "seed=1,2").out))
    assert [document["seed"] for document in documents] == [1, 2]


def test_cfg_prints_the_settings_of_a_command_and_stops(formctl: Callable[..., Result], tmp_path: Path) -> None:
    result = formctl("bank", "create", "--cfg", "--episodes", "3", "--out", "bank.npz")
    assert yaml.safe_load(result.out)["eval"]["episodes"] == 3
    assert list(tmp_path.iterdir()) == []


def test_a_group_with_nothing_chosen_is_refused() -> None:
    tree = {key: value for key, value in compose().tree.items() if key != "reward"}
    with pytest.raises(ConfigError, match="reward has to be one of paper, release, shaped"):
        restore(tree)


def test_composing_leaves_no_state_behind() -> None:
    compose(["seed=1"])
    assert not GlobalHydra.instance().is_initialized()
    assert compose().seed == 0
