"""Cells rebuilt by hand with pandas from the rows on disk, and what a table says where there are none."""

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binomtest
from statsmodels.stats.proportion import proportion_confint

from analysis import stats
from analysis.claims import verdicts
from analysis.data import evidence, published, rows
from analysis.data.evidence import Evidence, Stamp
from analysis.figures import report_figures
from analysis.figures.style import ReportFigure
from analysis.tables import ablations, deployment, main, render
from analysis.tables import table as cells
from analysis.tables.table import Table
from tests.analysis.synthetic import Made, episodes


def raw(root: Path, method: str) -> pd.DataFrame:
    """All rows of a method, read without the package under test."""
    files = [path for path in root.glob("eval/*/*/episodes.parquet")]
    frame = pd.concat([pd.read_parquet(path) for path in files], ignore_index=True)
    return frame[frame["method"] == method]


def cell(table: Table, row: str, column: str) -> cells.Cell:
    """The cell in the row that begins with this text."""
    keys = [c.key for c in table.columns]
    (found,) = [line for line in table.rows if line[0].text == row]
    return found[keys.index(column)]


def test_cfr_of_a_baseline_by_hand(root: Path, full: Evidence) -> None:
    frame = raw(root, "swarm_rl")
    frame = frame[(frame["scenario"] == "mixed") & (frame["columns"] == 10) & (frame["balls"] == 2)]
    k, n = int(frame["cfr"].sum()), len(frame)
    low, high = proportion_confint(k, n, method="wilson")
    found = cell(main.tables(full)[0], "Swarm-RL", "cfr")
    assert found.value == k / n
    assert found.plain() == f"{k / n:.3f} [{low:.3f}, {high:.3f}] {k}/{n}"


def test_fm_on_successes_by_hand(root: Path, full: Evidence) -> None:
    frame = raw(root, "rmader").query("scenario == 'mixed' and cfr")
    found = cell(main.tables(full)[0], "R-MADER", "fm")
    assert found.value == pytest.approx(frame["fm"].mean())
    assert found.details[1] == f"n = {len(frame)}"


def test_cells_of_three_seeds_by_hand(root: Path, full: Evidence) -> None:
    frame = raw(root, "main").query("scenario == 'mixed'")
    assert frame["seed"].nunique() == 3
    table = main.tables(full)[0]
    assert cell(table, "Ours, MAPPO", "sr").value == frame["sr"].mean()
    assert cell(table, "Ours, MAPPO", "cfr_strict").value == frame["cfr_strict"].mean()
    assert (
        cell(table, "Ours, MAPPO", "evidence").plain()
        == "180 episodes 3 seeds 6 M steps reward shaped weights best of stage1 0.25/0.25/0.30/0.20"
    )


def test_objectives_of_an_arm_by_hand(root: Path, full: Evidence) -> None:
    frame = raw(root, "no_sa-three_period")
    table = ablations.encoder(full)
    for objective in ablations.OBJECTIVES:
        assert cell(table, "w/o SA", f"ok_{objective}").value == frame[f"ok_{objective}"].mean()
    assert [row[0].text for row in table.rows] == ["Ours", "w/o CA", "w/o SA", "MLP"]
    assert [row[0].text for row in ablations.curriculum(full).rows] == [
        "Ours",
        "3-period, dynamic",
        "2-period",
        "w/o CL",
    ]


def test_the_papers_numbers_stand_beside_ours(full: Evidence) -> None:
    table = main.tables(full)[0]
    assert cell(table, "Ours, MAPPO", "cfr_paper").plain() == "0.89 [0.81, 0.94] 89/100"
    assert cell(table, "R-MADER", "fm_paper").plain() == "4.052 n = 5"
    assert cell(table, "Hover", "cfr_paper").plain() == cells.NOTHING


def test_an_empty_store_shows_the_papers_numbers_and_no_other(tmp_path: Path) -> None:
    empty = evidence.gather(rows.load(tmp_path))
    for table in [
        *main.tables(empty),
        ablations.encoder(empty),
        ablations.curriculum(empty),
        deployment.table(empty),
        verdicts.table(empty),
    ]:
        assert not table.measured
        assert all(c.paper or c.value is None for row in table.rows for c in row)
        assert (
            table.numbers()
            .drop(columns=[c.key for c in table.columns if c.left or "paper" in c.key])
            .isna()
            .all(axis=None)
        )
    numbers = {c.value for row in main.tables(empty)[0].rows for c in row if c.value is not None}
    assert numbers == {n for p in published.SIMULATION for n in (p.cfr, p.fm)}
    assert ablations.paired_table(empty) is None


def test_different_budgets_are_said(made: Made) -> None:
    made.evaluation(made.policy(made.training(steps=1_000_000)), episodes(10, 0.5))
    made.evaluation(made.policy(made.training(steps=2_000_000, encoder="mlp")), episodes(10, 0.5))
    table = ablations.encoder(evidence.gather(rows.load(made.root)))
    assert "Training budgets differ (1 M, 2 M steps)" in table.notes[0]


def test_paired_comparison_by_hand(made: Made) -> None:
    made.evaluation(made.policy(made.training()), episodes(80, 0.9, 0.2, seed=1))
    made.evaluation(made.baseline("straight_line"), episodes(80, 0.6, 0.4, seed=2))
    table = ablations.paired_table(evidence.gather(rows.load(made.root)))
    assert table is not None
    ours, other = (raw(made.root, name).set_index("scenario_id") for name in ("main", "straight_line"))
    only = (int((ours["cfr"] & ~other["cfr"]).sum()), int((~ours["cfr"] & other["cfr"]).sum()))
    both = ours["cfr"] & other["cfr"]
    assert cell(table, "Straight line", "cfr_difference").value == pytest.approx(
        ours["cfr"].mean() - other["cfr"].mean()
    )
    assert cell(table, "Straight line", "p_holm").value == pytest.approx(binomtest(min(only), sum(only), 0.5).pvalue)
    assert cell(table, "Straight line", "fm_difference").value == pytest.approx((ours["fm"] - other["fm"])[both].mean())


def paired(made: Made) -> Table:
    """The paired table of what was made."""
    table = ablations.paired_table(evidence.gather(rows.load(made.root)))
    assert table is not None
    return table


@pytest.mark.parametrize(("second", "p"), [(True, "< 0.001"), (False, "1.000")])
def test_seeds_that_disagree_on_who_is_better_prove_nothing(made: Made, second: bool, p: str) -> None:
    """Half of the episodes tell the first seed from the baseline in its favour, the other half or none the second."""
    flown = episodes(60, 1.0)
    made.evaluation(made.baseline("straight_line"), flown.assign(cfr=flown["scenario_id"] < 30))
    for seed, able in enumerate((True, second)):
        made.evaluation(made.policy(made.training(seed)), flown.assign(cfr=able))
    assert cell(paired(made), "Straight line", "p_holm").plain() == f"{p} weakest of 2"


def test_a_flight_paired_with_several_seeds_counts_once(made: Made) -> None:
    made.evaluation(made.policy(made.training()), episodes(80, 0.9, 0.2, seed=9))
    for seed in (0, 1, 2):
        id = made.training(seed, curriculum="own", name="other")
        made.evaluation(made.policy(id), episodes(80, 0.7, 0.3, seed=seed))
    table, name = paired(made), "MAPPO, own"
    ours, theirs = (raw(made.root, name).query("cfr") for name in ("main", "other"))
    ours = ours[ours["scenario_id"].isin(theirs["scenario_id"])]
    theirs = theirs[theirs["scenario_id"].isin(ours["scenario_id"])]
    for side, flown in (("fm_first", ours), ("fm_other", theirs)):
        assert cell(table, name, side).value == pytest.approx(flown["fm"].mean())
        assert cell(table, name, side).details[1] == f"n = {len(flown)}"
    assert cell(table, name, "method").details == ("seeds: 1 against 3", "differs in curriculum")


def test_seeds_without_a_partner_are_counted(made: Made, full: Evidence) -> None:
    for seed in (0, 1, 2):
        made.evaluation(made.policy(made.training(seed)), episodes(20, 0.9))
    for seed in (0, 1):
        made.evaluation(made.policy(made.training(seed, curriculum="own")), episodes(20, 0.7))
    assert cell(paired(made), "MAPPO, own", "method").details == ("seeds: 2 of 3 against 2", "differs in curriculum")
    of_all = ablations.paired_table(full)
    assert of_all is not None and cell(of_all, "Straight line", "method").details == ("seeds: 3 against –",)


def test_one_seed_is_said_wherever_there_is_one(made: Made) -> None:
    learnt = made.baseline("swarm_rl") | {"steps": 20_000_000, "published_steps": 1_000_000_000}
    sweep = [episodes(10, 0.9, scenario="static", columns=columns, balls=0) for columns in (5, 10)]
    made.evaluation(learnt, [episodes(10, 0.5), *sweep])
    made.evaluation(made.baseline("hover"), [episodes(10, 0.5), *sweep])
    made.evaluation(made.policy(made.training(0)), [episodes(10, 0.9), *sweep])
    made.evaluation(made.policy(made.training(1)), sweep[0])
    seen = evidence.gather(rows.load(made.root))
    table = main.tables(seen)[0]
    assert cell(table, "Swarm-RL", "evidence").plain() == "10 episodes one seed 20 M steps of 1 G published"
    assert cell(table, "Hover", "evidence").plain() == "10 episodes"
    for notes in (table.notes, paired(made).notes):
        assert [note.partition(". ")[0] for note in notes] == ["One training seed: Ours, MAPPO; Swarm-RL"]
    (plate,) = report_figures.sweeps(seen, "columns")
    assert isinstance(plate, ReportFigure) and "One training seed: Ours, MAPPO (in part); Swarm-RL." in plate.caption


def test_who_was_gone_before_a_ball_was_thrown_is_said(made: Made) -> None:
    """Of four successes two met no ball; the crash before the first throw does not count."""
    met = [np.nan, np.nan, 0.5, 0.7, np.nan]
    won = [True, True, True, True, False]
    for name, closest in (("rmader", met), ("swarm_formation", [0.4] * 5)):
        frame = episodes(5, 1.0).assign(cfr=won, min_ball=closest)
        real = frame.assign(scenario="real_dynamic", columns=0, balls=1, deploy="mocap")
        sweep = pd.concat([frame, frame]).assign(scenario="dynamic", columns=0, balls=2, scenario_id=range(10))
        made.evaluation(made.baseline(name), [frame, real, sweep])
    found = evidence.gather(rows.load(made.root))
    told = "At the goal before any ball was thrown: R-MADER in {} of {} successful flights."
    assert main.tables(found)[0].notes == (told.format(2, 4),) == deployment.table(found).notes
    (plate,) = report_figures.sweeps(found, "balls")
    assert isinstance(plate, ReportFigure) and told.format(4, 8) in plate.caption


def test_episodes_of_other_banks_are_not_paired(made: Made) -> None:
    made.evaluation(made.policy(made.training()), episodes(20, 0.9, bank="one"))
    made.evaluation(made.baseline("straight_line"), episodes(20, 0.6, bank="two"))
    assert ablations.paired_table(evidence.gather(rows.load(made.root))) is None


def test_real_scenarios(made: Made) -> None:
    """Table II's own row is that of a policy trained for its scenes; one of the mixed scene stands below."""
    flights = episodes(40, 0.8, scenario="real_mixed", columns=2, balls=1)
    made.evaluation(made.policy(made.training(scenario="real_mixed")), flights)
    made.evaluation(made.policy(made.training(name="simulated")), flights)
    table = deployment.table(evidence.gather(rows.load(made.root)))
    lines = [line for line in table.rows if line[0].text == published.REAL_SCENES["real_mixed"]]
    (row,) = [line for line in lines if line[1].text == "MAPPO, three periods, trained on real_mixed"]
    (other,) = [line for line in lines if line[1].text == "Ours, MAPPO"]
    assert other[2].plain() == cells.NOTHING
    assert row[2].plain() == "0.80 [0.49, 0.94] 8/10"
    assert row[4].value == raw(made.root, "main")["cfr"].mean()
    assert row[3].value == raw(made.root, "main")["cfr"][:10].mean()
    assert sum(line[4].missing for line in table.rows) == 8


def test_planners_for_real_flights_stand_in_their_table_only(made: Made) -> None:
    made.evaluation(made.baseline("rmader"), episodes(20, 0.8))
    real = episodes(20, 0.8, scenario="real_mixed", columns=2, balls=1)
    made.evaluation(made.baseline("rmader_real"), real, scenario="real_mixed")
    found = evidence.gather(rows.load(made.root))
    assert "R-MADER, for real flights" in [line[1].text for line in deployment.table(found).rows]
    assert "R-MADER, for real flights" not in [line[0].text for line in main.tables(found)[0].rows]


def every_table(full: Evidence) -> list[Table]:
    paired = ablations.paired_table(full)
    assert paired is not None
    return [
        *main.tables(full),
        paired,
        ablations.encoder(full),
        ablations.curriculum(full),
        deployment.table(full),
        verdicts.table(full),
    ]


def test_latex_is_balanced_and_escaped(full: Evidence, tmp_path: Path) -> None:
    for table in [*every_table(full), *main.tables(evidence.gather(rows.load(tmp_path)))]:
        text = render.latex(table)
        bare = re.sub(r"\\[\\{}&%$#_]", "", text)
        assert bare.count("{") == bare.count("}")
        assert bare.count("$") % 2 == 0
        begun, ended = re.findall(r"\\begin{([^}]*)}", text), re.findall(r"\\end{([^}]*)}", text)
        assert begun == ended[::-1] == ["table*", "tabular"]
        body = re.sub(
            r"\\shortstack\[.\]{(?:[^{}]|{[^{}]*}|\\[{}])*}", "", text.split(r"\midrule")[1].split(r"\bottomrule")[0]
        )
        for line in filter(None, (part.strip() for part in body.replace(r"\addlinespace", "").split("\n"))):
            assert line.endswith(r"\\") and len(re.findall(r"(?<!\\)&", line)) == len(table.columns) - 1
        assert not re.search(r"(?<![\\{])_", re.sub(r"\\label{[^}]*}", "", text))
        assert text.isascii()
        assert str(table.stamp.profile) in text


def test_latex_escapes_everything_special() -> None:
    assert render.latex_text(r"a_b & 50 % {x} #1 \y ~ ^ $ – −") == (
        r"a\_b \& 50 \% \{x\} \#1 \textbackslash{}y \textasciitilde{} \textasciicircum{} \$ -- $-$"
    )


def test_markdown_and_html_have_every_cell(full: Evidence) -> None:
    for table in every_table(full):
        text, page = render.markdown(table), render.html(table)
        lines = [line for line in text.splitlines() if line.startswith("|")]
        assert {line.count("|") for line in lines} == {len(table.columns) + 1}
        assert len(lines) == len(table.rows) + 2
        assert page.count("<td") == len(table.rows) * len(table.columns)
        assert page.count("<tr") == page.count("</tr>") == len(table.rows) + 1
        assert str(table.stamp) in text and str(table.stamp) in page


def test_html_is_escaped() -> None:
    table = Table("k", "a<b", "", (cells.Column("x", "<i>"),), ((cells.Cell("<script>"),),), Stamp("laptop"))
    assert "<script>" not in render.html(table) and "&lt;script&gt;" in render.html(table)


def test_one_episode_has_a_value_and_no_interval() -> None:
    assert cells.mean_cell(stats.mean([0.049])).plain() == "0.049 n = 1"
    assert cells.mean_cell(stats.mean([0.1, 0.1])).plain() == "0.100 [0.100, 0.100] n = 2"
    assert cells.difference_cell(stats.paired_difference(np.array([[-0.2]]))).details == ("n = 1",)


def test_a_row_of_another_length_is_refused() -> None:
    with pytest.raises(ValueError, match="a row has 2 cells for 1 columns"):
        Table("k", "t", "", (cells.Column("x", "X"),), ((cells.Cell("1"), cells.Cell("2")),), Stamp("laptop"))


def test_frames(full: Evidence) -> None:
    table = main.tables(full)[0]
    assert list(table.frame().columns) == [column.title for column in table.columns]
    assert table.numbers()["cfr"].tolist() == [row[1].value for row in table.rows]
