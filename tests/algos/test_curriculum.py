"""Curricula: equal totals, the command line's scenario in every period, clear refusals."""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest

from algos.curriculum import CurriculumSpec, Period, capacity, period_scenario, plan, same_world
from tests.algos.conftest import CONF, group, spec, world

CHOICES = sorted(path.stem for path in (CONF / "curriculum").glob("*.yaml"))
MIXED = world("mixed").scenario


def curriculum(choice: str) -> CurriculumSpec:
    return spec(CurriculumSpec, "curriculum", choice)


@pytest.mark.parametrize("choice", CHOICES)
def test_every_curriculum_spends_the_whole_budget_and_ends_in_the_configured_scenario(choice: str) -> None:
    scenario = replace(MIXED, ball_aim="box", columns=12)
    stages = plan(curriculum(choice), scenario, steps=315_000, steps_per_update=1_000)
    assert (stages[0].first, stages[-1].last) == (0, 315)
    assert all(one.last == other.first for one, other in pairwise(stages))
    assert stages[-1].scenario == scenario
    assert {stage.scenario.ball_aim for stage in stages} == {"box"}
    assert group("curriculum", choice)["name"] == choice


def test_the_papers_periods() -> None:
    stages = plan(curriculum("three_period"), MIXED, steps=315_000_000, steps_per_update=65_536)
    sizes = [(s.period.name, s.scenario.columns, s.scenario.balls, s.last - s.first) for s in stages]
    assert sizes == [("free", 0, 0, 229), ("static", 10, 0, 2288), ("mixed", 10, 2, 2289)]
    assert capacity(stages) == (10, 2)
    assert capacity(plan(curriculum("three_period_dynamic"), MIXED, 4000, 1000)) == (10, 2)


def test_every_period_gets_an_update() -> None:
    stages = plan(curriculum("three_period"), MIXED, steps=3_999, steps_per_update=1_000)
    assert [(s.first, s.last) for s in stages] == [(0, 1), (1, 2), (2, 3)]
    with pytest.raises(ValueError, match=r"2000 steps .*1000 steps\) for each of the 3 periods .*three_period"):
        plan(curriculum("three_period"), MIXED, steps=2_000, steps_per_update=1_000)


def test_periods_that_differ_in_what_is_drawn_share_a_world() -> None:
    stages = plan(curriculum("three_period"), MIXED, 4000, 1000)
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
        plan(CurriculumSpec("odd", (Period("a", 0, {}, "previous"),)), MIXED, 4000, 1000)
    with pytest.raises(ValueError, match="has no periods"):
        plan(CurriculumSpec("odd", ()), MIXED, 4000, 1000)
