"""Curricula: equal totals, the command line's scenario in every period, clear refusals."""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest

from algos.curriculum import CurriculumSpec, Period, advance, between, capacity, period_scenario, plan, same_world
from tests.algos.conftest import CONF, curriculum_spec, group, mappo, shac, world

CHOICES = sorted(path.stem for path in (CONF / "curriculum").glob("*.yaml"))
MIXED = world("mixed").scenario


MILLE = mappo(envs=250)
"""A learner of 1,000 steps per update."""


@pytest.mark.parametrize("choice", CHOICES)
def test_every_curriculum_spends_the_whole_budget_and_ends_in_the_configured_scenario(choice: str) -> None:
    scenario = replace(MIXED, ball_aim="box", columns=12)
    stages = plan(curriculum_spec(choice), scenario, MILLE, steps=315_000)
    assert stages[0].first == 0 and 315_000 - stages[-1].last < stages[-1].size
    assert all(one.last == other.first for one, other in pairwise(stages))
    assert stages[-1].scenario == scenario
    assert {stage.scenario.ball_aim for stage in stages} == {"box"}
    assert group("curriculum", choice)["name"] == choice


def test_the_papers_periods() -> None:
    stages = plan(curriculum_spec("three_period"), MIXED, mappo(envs=16_384), steps=315_000_000)
    sizes = [(s.period.name, s.scenario.columns, s.scenario.balls, s.updates) for s in stages]
    assert sizes == [("free", 0, 0, 229), ("static", 10, 0, 2288), ("mixed", 10, 2, 2289)]
    assert capacity(stages) == (10, 2)
    assert capacity(plan(curriculum_spec("three_period_dynamic"), MIXED, MILLE, 4000)) == (10, 2)


def test_every_period_gets_an_update() -> None:
    stages = plan(curriculum_spec("three_period"), MIXED, MILLE, steps=3_999)
    assert [(s.first, s.updates) for s in stages] == [(0, 1), (1000, 1), (2000, 1)]
    with pytest.raises(ValueError, match=r"2000 steps .*1000 steps\) for each of the 3 periods .*three_period"):
        plan(curriculum_spec("three_period"), MIXED, MILLE, steps=2_000)


def test_periods_that_differ_in_what_is_drawn_share_a_world() -> None:
    stages = plan(curriculum_spec("three_period"), MIXED, MILLE, 4000)
    assert all(same_world(MIXED, stage.scenario) for stage in stages)
    assert not same_world(MIXED, replace(MIXED, velocity=(0.0, 1.0, 0.0)))


@pytest.mark.parametrize(
    "scenario, message",
    [
        ({"colums": 3}, "'slalom': the scenario has no field 'colums'; did you mean 'columns'"),
        ({"ball_aim": "head"}, "'slalom': scenario ball_aim='head': "),
        ({"throw_time": [1.0]}, r"'slalom': scenario throw_time=\[1.0\]: "),
    ],
)
def test_overrides_are_checked(scenario: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        period_scenario(MIXED, Period("slalom", 1.0, scenario, "previous"))
    assert "\n" not in str(error.value)


def test_overrides_from_yaml_become_the_fields_types() -> None:
    changed = period_scenario(MIXED, Period("early", 1.0, {"throw_time": [1, 4], "columns": 4}, "previous"))
    assert changed == replace(MIXED, throw_time=(1.0, 4.0), columns=4)


def test_shares_have_to_be_positive() -> None:
    with pytest.raises(ValueError, match="'a': share=0 has to be positive"):
        plan(CurriculumSpec("odd", (Period("a", 0, {}, "previous"),)), MIXED, MILLE, 4000)
    with pytest.raises(ValueError, match="has no periods"):
        plan(CurriculumSpec("odd", ()), MIXED, MILLE, 4000)


def periods(*shares: float, **last: Any) -> CurriculumSpec:
    """Periods of these shares; `last` belongs to the last of them."""
    plain = [Period(str(share), share, {}, "previous") for share in shares]
    return CurriculumSpec("test", (*plain[:-1], replace(plain[-1], **last)))


def test_learners_of_other_sizes_share_the_same_steps() -> None:
    small = shac(envs=25)  # 150 steps an update
    stages = plan(periods(1, 1, algo=small), MIXED, MILLE, 10_000)
    assert [(s.first, s.updates, s.size, s.last) for s in stages] == [(0, 5, 1000, 5000), (5000, 33, 150, 9950)]
    stages = plan(CurriculumSpec("turned", periods(1, 1, algo=small).periods[::-1]), MIXED, MILLE, 10_400)
    assert [(s.first, s.updates, s.size) for s in stages] == [(0, 33, 150), (4950, 5, 1000)]
    with pytest.raises(ValueError, match=r"1100 steps are less than one update \(150 \+ 1000 steps\)"):
        plan(periods(1, 1, algo=small), MIXED, MILLE, 1_100)


def test_what_a_period_leaves_goes_to_the_later_ones_by_their_shares() -> None:
    stages = plan(periods(2, 1, 1), MIXED, MILLE, 40_000)
    assert [s.updates for s in stages] == [20, 10, 10]
    shorter = advance(stages, 0, 4_000, 40_000)
    assert [(s.first, s.updates) for s in shorter] == [(0, 4), (4_000, 18), (22_000, 18)]
    assert [(s.first, s.updates) for s in advance(shorter, 2, 30_000, 40_000)][-1] == (22_000, 8)


def test_a_rule_asks_for_all_its_statistics_and_for_enough_episodes() -> None:
    (stage,) = plan(periods(1, advance_when={"cfr": 0.9, "fm": 0.3}), MIXED, MILLE, 4_000)
    good = {"train/cfr": 0.9, "train/fm": 0.2, "train/episodes": 100.0}
    assert stage.over(0, good)
    for change in ({"train/cfr": 0.89}, {"train/fm": 0.31}, {"train/episodes": 99.0}):
        assert not stage.over(0, good | change)
    assert not stage.over(0, {})
    (stage,) = plan(periods(1, advance_when={"cfr": 0.9, "episodes": 12}), MIXED, MILLE, 4_000)
    assert stage.over(0, {"train/cfr": 1.0, "train/episodes": 12.0})
    (stage,) = plan(periods(1), MIXED, MILLE, 4_000)
    assert not stage.over(0, good)


def test_a_ramp_goes_from_its_first_to_its_last_value_with_the_pools() -> None:
    ramp = {"columns": (2, 20), "balls": (0, 5), "ball_aim": ("box", "mix", "drone"), "throw_time": ([1, 2], [3, 4])}
    (stage,) = plan(periods(1, ramp=ramp, advance_when={"cfr": 0}), MIXED, MILLE, 14_000)
    assert stage.draws == 7 and capacity((stage,)) == (20, 5)
    laws = [stage.law(draw) for draw in range(7)]
    assert [law.columns for law in laws] == [2, 5, 8, 11, 14, 17, 20]
    assert [law.balls for law in laws] == [0, 1, 2, 2, 3, 4, 5]
    assert [law.ball_aim for law in laws] == ["box"] * 2 + ["mix"] * 2 + ["drone"] * 3
    assert (laws[0].throw_time, laws[-1].throw_time) == ((1.0, 2.0), (3.0, 4.0))
    facts = {"period/columns": 5.0, "period/balls": 1.0, "period/ball_aim": 0.0, "period/throw_time": 0.0}
    assert stage.facts(1) == facts
    done = {"train/cfr": 1.0, "train/episodes": 500.0}
    assert stage.over(6, done) and not stage.over(5, done)


def test_numbers_on_a_ramp() -> None:
    assert between((0.0, 1.0, 4.0), 0.75) == 2.5
    assert between((10, 2), 0.5) == 6 and isinstance(between((10, 2), 0.1), int)


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"ramp": {"column": (1, 2)}}, r"'1': ramp of 'column'; did you mean 'columns'"),
        ({"ramp": {"hit_radius": (0.1, 0.2)}}, r"'1': ramp of 'hit_radius'"),
        ({"ramp": {"columns": (1,)}}, "needs a first and a last value"),
        ({"ramp": {"ball_aim": ("box", "head")}}, "'1': scenario ball_aim='head': "),
        ({"advance_when": {"cfrr": 0.9}}, "'1': advance_when knows no statistic 'cfrr'; did you mean 'cfr'"),
    ],
)
def test_ramps_and_rules_are_checked(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        plan(periods(1, **changes), MIXED, MILLE, 4_000)
    assert "\n" not in str(error.value)
