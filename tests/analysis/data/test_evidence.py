import pandas as pd
import pytest

from analysis import report
from analysis.data import evidence, rows
from analysis.data.evidence import Evidence
from analysis.data.text import short
from analysis.figures import series
from analysis.tables import main
from tests.analysis.synthetic import Made, episodes


def gathered(made: Made, profile: str | None = None) -> Evidence:
    return evidence.gather(rows.load(made.root), profile)


def test_profiles_never_mix(made: Made) -> None:
    for profile, share in (("smoke", 0.2), ("laptop", 0.9)):
        policy = made.training(profile=profile, steps=1000 if profile == "smoke" else 2000)
        made.evaluation(made.policy(policy), episodes(50, share), profile=profile)
    smoke, laptop = gathered(made, "smoke"), gathered(made)
    assert laptop.profile == "laptop"
    assert {len(frame) for frame in (*smoke.cells.values(), *laptop.cells.values())} == {50}
    assert {str(p) for frame in smoke.cells.values() for p in frame["profile"].unique()} == {"smoke"}
    assert {str(p) for frame in laptop.cells.values() for p in frame["profile"].unique()} == {"laptop"}
    assert [m.facts.steps for m in laptop.methods.values()] == [2000]


def test_a_policy_trained_under_smoke_stays_smoke(made: Made) -> None:
    policy = made.policy(made.training(profile="smoke"))
    made.evaluation(policy, episodes(20, 0.5), profile="paper")
    assert gathered(made).profile == "smoke"
    assert not gathered(made, "paper").cells


def test_rows_of_a_policy_file_say_what_it_was_trained_under(made: Made) -> None:
    facts = made.baseline("x") | {"kind": "policy", "name": "downloaded"}
    folder = made.evaluation(facts, episodes(20, 0.5), profile="laptop")
    path = folder / "episodes.parquet"
    pd.read_parquet(path).assign(profile="smoke").to_parquet(path)
    assert gathered(made).profile == "smoke"


def test_the_default_profile_is_the_most_serious_with_a_policy(made: Made) -> None:
    made.evaluation(made.baseline("hover"), episodes(5, 0.0), profile="paper")
    assert gathered(made).profile == "paper"
    made.evaluation(made.policy(made.training(profile="laptop")), episodes(5, 0.5), profile="laptop")
    assert gathered(made).profile == "laptop"


def test_seeds_pool_and_nothing_else_does(made: Made) -> None:
    for seed, changed in (
        (0, {}),
        (1, {}),
        (2, {"steps": 99_000}),
        (3, {"reward": "release"}),
        (4, {"encoder": "mlp"}),
    ):
        made.evaluation(made.policy(made.training(seed=seed, **changed)), episodes(10, 0.5, seed=seed))
    found = gathered(made)
    seeds = {found.names[key]: sorted(rows["train_seed"].unique()) for (key, _), rows in found.cells.items()}
    assert sorted(seeds.values()) == [[0, 1], [2], [3], [4]]
    names = set(seeds)
    assert {"MAPPO, MLP", "Ours, MAPPO (99 k steps, reward shaped)", "Ours, MAPPO (6 M steps, reward release)"} <= names


def test_an_episode_flown_twice_counts_once_in_its_latest_evaluation(made: Made) -> None:
    made.evaluation(made.baseline("hover"), episodes(10, 0.0))
    made.evaluation(made.baseline("hover"), episodes(10, 1.0))
    found = gathered(made)
    (frame,) = found.cells.values()
    assert len(frame) == 10 and frame["cfr"].all()
    assert "10 episodes were flown again" in found.notes[0]


def test_another_metric_version_is_left_out_and_named(made: Made) -> None:
    made.evaluation(made.baseline("straight_line"), episodes(7, 0.0, metric_version=2))
    others = [made.evaluation(made.baseline("hover"), episodes(n, 0.0, metric_version=99)) for n in (1, 2, 3, 4)]
    store = rows.load(made.root)
    found = evidence.gather(store, metric_version=2)  # one file of another version takes nothing over
    assert sum(map(len, found.cells.values())) == 7
    files = ", ".join(str(folder / "episodes.parquet") for folder in others[:3])
    assert found.notes == (
        f"10 episodes of metric version 99 are left out, 2 counts: {files}, +1; "
        "fly them again, or report with the formctl that flew them",
    )
    assert not evidence.gather(store, metric_version=3).cells
    assert report.compose(evidence.gather(store, metric_version=3)).provenance.left_out


def test_without_a_metric_version_the_most_frequent_counts(made: Made) -> None:
    made.evaluation(made.baseline("hover"), episodes(8, 0.0, metric_version=1))
    made.evaluation(made.baseline("straight_line"), episodes(1, 0.0, metric_version=99))
    found = gathered(made)
    assert sum(map(len, found.cells.values())) == 8
    assert found.notes[0].startswith("1 episode of metric version 99 is left out, 1 counts: ")


@pytest.mark.parametrize("change", [{"ball_aim": "box"}, {"sim": "mujoco"}])
def test_another_world_is_another_table(made: Made, change: dict[str, str]) -> None:
    made.evaluation(made.baseline("straight_line"), [episodes(10, 0.2), episodes(12, 0.9, **change)])  # type: ignore[arg-type]
    first, second = main.tables(gathered(made))
    assert [cell.text for cell in first.rows[-1]][-1] == "10 episodes"
    assert [cell.text for cell in second.rows[-1]][-1] == "12 episodes"
    assert second.key == "main_2" and next(iter(change.values())) in second.caption
    assert next(iter(change.values())) in second.title.removeprefix(f"{first.title}; ")


def test_changed_settings_are_another_world_and_are_named(made: Made) -> None:
    made.evaluation(made.baseline("hover"), episodes(10, 0.2), config={"scenario": {"hit_radius": 0.15, "columns": 10}})
    made.evaluation(made.baseline("straight_line"), episodes(9, 0.2), config={"scenario": {"hit_radius": 0.3}})
    _, second = main.tables(gathered(made))
    assert "scenario.hit_radius = 0.3" in second.caption


def test_without_balls_their_aim_does_not_matter(made: Made) -> None:
    static = {"scenario": "static", "columns": 5, "balls": 0}
    made.evaluation(made.baseline("hover"), episodes(5, 0.2, ball_aim="box", **static))  # type: ignore[arg-type]
    made.evaluation(made.baseline("straight_line"), episodes(5, 0.2, ball_aim="drone", **static))  # type: ignore[arg-type]
    assert len(gathered(made).places("static")) == 1


def test_a_policy_of_the_simplified_task_is_not_the_papers(made: Made) -> None:
    id = made.training(curriculum="none", name="stage1-3")
    config = made.root / "train" / "stage1-3" / id / "config.yaml"
    config.write_text('{"scenario": {"name": "stage1"}}')
    made.evaluation(made.policy(id), episodes(5, 0.5))
    found = gathered(made)
    (method,) = found.methods.values()
    assert method.role == "other" and found.names[method.key] == "MAPPO, w/o CL, trained on stage1"


def test_an_arm_of_no_full_method_stands_for_itself(made: Made) -> None:
    for changed in ({}, {"curriculum": "none"}, {"curriculum": "none", "reward": "release"}):
        made.evaluation(made.policy(made.training(**changed)), episodes(5, 0.5))  # type: ignore[arg-type]
    found = gathered(made)
    names = [found.names[method.key] for method in found.shown]
    assert names == ["Ours, MAPPO", "MAPPO, w/o CL (reward release)"]
    assert [row[0].text for row in main.tables(found)[0].rows][:2] == names


def test_a_record_without_a_method_is_named(made: Made) -> None:
    made.evaluation(made.baseline("hover"), episodes(5, 0.0))
    folder = made.run("eval", "foreign")
    episodes(5, 0.0).assign(method="x", seed=0, run="", profile="laptop").to_parquet(folder / "episodes.parquet")
    assert "names no method" in gathered(made).notes[0]


@pytest.mark.parametrize(
    ("count", "text"), [(None, "–"), (999, "999"), (30_000, "30 k"), (6_000_000, "6 M"), (315_000_000, "315 M")]
)
def test_short_counts(count: int | None, text: str) -> None:
    assert short(count) == text


def test_stamp(full: Evidence) -> None:
    text = str(full.stamp(full.cells))
    assert text.startswith("profile laptop · trained 6 M steps · seeds 0–2 · ")
    assert text.endswith("episodes per cell · commit 38e1a72")


def test_a_stamp_speaks_of_every_learnt_method(made: Made) -> None:
    made.evaluation(made.policy(made.training(seed=3, steps=2_500_000)), episodes(5, 0.5))
    made.evaluation(made.baseline("swarm_rl") | {"steps": 16_121_856, "seed": 1}, episodes(5, 0.5))
    made.evaluation(made.baseline("hover") | {"seed": 9}, episodes(5, 0.5))
    found = gathered(made)
    assert str(main.tables(found)[0].stamp).startswith("profile laptop · trained 2.5 M to 16.1 M steps · seeds 1, 3 · ")


def test_learning_curves_are_stamped_with_the_steps_that_were_trained(made: Made) -> None:
    for seed, reached in enumerate((16_121_856, 16_120_000)):
        id = made.training(seed=seed, steps=20_000_000)
        (made.root / "train" / "main" / id / "metrics.jsonl").write_text(f'{{"steps": {reached}, "train/cfr": 0.5}}\n')
    curves = series.learning(rows.load(made.root), "laptop")
    assert curves is not None
    assert str(curves.stamp(curves.table)).startswith("profile laptop · trained 16.1 M steps · seeds 0, 1")
