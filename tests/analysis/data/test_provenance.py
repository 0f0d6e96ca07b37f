"""Settings told once: from what the provenance says, every setting of every run can be put together again."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from analysis.data import methods, provenance
from analysis.data import runs as records
from analysis.data.runs import Run
from tests.analysis.synthetic import Made

SHARED: dict[str, Any] = {"seed": 0, "scenario": {"name": "mixed", "start": [0.0, 1.5], "extra": {}}}
POLICY = SHARED | {"baseline": None, "deploy": None}
PLANNER = SHARED | {"baseline": {"cost": {"time": 80.0, "swarm": 5.0}, "clock": 0.1}, "deploy": None}


def flown(root: Path) -> list[Run]:
    """Evaluations of a policy, also in a deployment and without any settings on record, and of a planner."""
    made = Made(root)
    policy, planner = made.policy(made.training(log=False)), made.baseline("rmader")
    for tree in (POLICY, POLICY | {"seed": 1}, POLICY | {"name": "other"}, {"seed": 0}):
        made.run("eval", "main", method=policy, config=tree)
    made.run("eval", "deployed", method=policy, config=POLICY | {"deploy": {"latency": 0.02}})
    (made.run("eval", "bare", method=policy) / "config.yaml").unlink()
    for tree in (PLANNER, PLANNER | {"baseline": {"cost": {"time": 10.0, "swarm": 5.0}}}, PLANNER):
        made.run("eval", "planners", method=planner, config=tree)
    return records.scan(root, ["eval"])[0]


def applied(common: Mapping[str, str], lines: Sequence[str]) -> dict[str, str]:
    """``common`` with what ``lines`` say instead, as a reader would do it."""
    tree = dict(common)
    for line in lines:
        if line.startswith("# without "):
            for key in line.removeprefix("# without ").split(", "):
                del tree[key]
            continue
        key, _, value = line.partition(": ")
        tree = {k: v for k, v in tree.items() if not k.startswith(f"{key}.") and not key.startswith(f"{k}.")}
        tree[key] = value
    return tree


def test_every_setting_of_every_run_can_be_put_together_again(tmp_path: Path) -> None:
    seen = 0
    for kind in provenance.shared_settings(flown(tmp_path)):
        shared = applied({}, kind.lines)
        for family in kind.parts:
            common = applied(shared, family.lines)
            for own in family.parts:
                assert not own.runs[0].config or applied(common, own.lines) == methods.leaves(own.runs[0].config)
                seen += 1
    assert seen == 9


def test_what_is_shared_is_said_once(tmp_path: Path) -> None:
    (kind,) = provenance.shared_settings(flown(tmp_path))
    assert [family.name for family in kind.parts] == ["eval mappo", "eval mappo, deployment", "eval rmader"]
    assert 'scenario.name: "mixed"' in kind.lines and "scenario.start: [0.0, 1.5]" in kind.lines
    policies, deployed, planners = kind.parts
    assert deployed.lines == ("baseline: null", "deploy.latency: 0.02")
    assert planners.lines == ("baseline.cost.time: 80.0", "baseline.cost.swarm: 5.0", "baseline.clock: 0.1")
    first, other, named, old, bare = (own.lines for own in policies.parts)
    assert (first, other, named, bare) == ((), ("seed: 1",), ('name: "other"',), ())
    assert old == ("# without scenario.name, scenario.start, scenario.extra, baseline, deploy",)
    assert [own.lines for own in planners.parts] == [(), ("baseline.cost.time: 10.0", "# without baseline.clock"), ()]


def test_half_is_not_most() -> None:
    assert provenance.usual([{"a": "1", "b": "1"}, {"a": "2", "b": "1"}]) == {"b": "1"}
    assert provenance.usual([{"a": "1"}, {"a": "1"}, {}, {}]) == {"a": "1"}
    assert provenance.usual([{"a": "1"}, {"b": "1"}, {"b": "1"}]) == {"b": "1"}


def test_damaged_settings_are_passed_over(tmp_path: Path) -> None:
    runs = flown(tmp_path)
    (runs[0].folder / "config.yaml").write_text("seed: [")
    (runs[1].folder / "config.yaml").write_text(json.dumps([1]))
    (kind,) = provenance.shared_settings(records.scan(tmp_path, ["eval"])[0])
    assert [own.lines for own in kind.parts[0].parts[:2]] == [(), ()]
