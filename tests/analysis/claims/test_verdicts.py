"""From checks to verdicts; every verdict of a whole store rebuilt from its rows with other code."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binomtest, chi2_contingency
from statsmodels.stats.multitest import multipletests
from statsmodels.stats.proportion import proportion_confint

from analysis import report
from analysis.claims import claims, verdicts
from analysis.claims.claims import Check
from analysis.claims.measures import Measured
from analysis.claims.verdicts import Outcome
from analysis.data import evidence, rows
from analysis.data.evidence import Evidence
from tests.analysis.synthetic import Made, episodes


def check(comparison: claims.Comparison, limit: float) -> Check:
    return Check(1, "x", lambda evidence: [], comparison, limit)


@pytest.mark.parametrize(
    ("comparison", "ends", "holds"),
    [
        ("≥", (0.81, 0.9), True),
        ("≥", (0.7, 0.79), False),
        ("≥", (0.7, 0.9), None),
        ("≤", (0.7, 0.8), True),
        ("≤", (0.81, 0.9), False),
        ("≤", (0.7, 0.9), None),
        ("<", (0.7, 0.79), True),
        ("<", (0.8, 0.9), False),
        ("<", (0.7, 0.8), None),
        ("not below", (0.1, 0.8), True),
        ("not below", (0.1, 0.79), False),
        ("not above", (0.8, 0.9), True),
        ("not above", (0.81, 0.9), False),
    ],
)
def test_an_interval_keeps_or_breaks_a_limit_or_leaves_it_open(
    comparison: claims.Comparison, ends: tuple[float, float], holds: bool | None
) -> None:
    assert verdicts.holds(check(comparison, 0.8), *ends) is holds


def outcome(holds: bool | None, lacking: str = "", **seen: object) -> Outcome:
    figures = () if lacking else (Measured("", 0, 0, **seen),)  # type: ignore[arg-type]
    return Outcome(check("≥", 0), holds, figures, lacking)


@pytest.mark.parametrize(
    ("outcomes", "text"),
    [
        ([outcome(True, seeds=3, learner="mappo")], "confirmed"),
        ([outcome(True, seeds=1, learner="mappo")], "confirmed (one seed)"),
        ([outcome(True, seeds=1, learner="shac")], "confirmed (with SHAC, one seed)"),
        ([outcome(True, seeds=3), outcome(False, seeds=3)], "not confirmed"),
        ([outcome(True, seeds=3), outcome(None, "nobody")], "not yet measured"),
        ([outcome(None, seeds=3)], "open: too few episodes"),
        ([outcome(False, seeds=2), outcome(None, "nobody")], "not confirmed"),
    ],
)
def test_a_verdict_names_learner_and_seeds(outcomes: list[Outcome], text: str) -> None:
    assert verdicts.verdict(outcomes) == text


def by_claim(found: Evidence) -> dict[str, str]:
    return {row[0].text: row[2].text for row in verdicts.table(found).rows if row[0].text}


def test_nothing_is_claimed_of_an_empty_store(tmp_path: Path) -> None:
    assert set(by_claim(evidence.gather(rows.load(tmp_path))).values()) == {"not yet measured"}


def test_a_measured_failure_refutes_and_success_confirms(made: Made) -> None:
    def first() -> str:
        return by_claim(evidence.gather(rows.load(made.root)))["1"]

    made.evaluation(made.policy(made.training(log=False)), episodes(200, 0.5, 0.2))
    assert first() == "not confirmed (one seed)"  # CFR 0.5 is not 0.89
    made.evaluation(made.policy(made.training(log=False, steps=7_000_000)), episodes(200, 0.92, 0.2))
    assert first() == "not yet measured"  # Swarm-RL was not flown
    made.evaluation(made.baseline("swarm_rl"), episodes(200, 0.85, 0.9, seed=1))
    assert first() == "confirmed (one seed)"


class Rows:
    """The rows of a store, read with pandas alone."""

    def __init__(self, root: Path) -> None:
        frames = [pd.read_parquet(path) for path in root.glob("eval/*/*/episodes.parquet")]
        self.frame = pd.concat(frames, ignore_index=True)

    def of(self, method: str, scenario: str = "mixed", columns: int = 10, balls: int = 2) -> pd.DataFrame:
        frame = self.frame
        place = (frame["scenario"] == scenario) & (frame["columns"] == columns) & (frame["balls"] == balls)
        return frame[place & (frame["method"] == method)]

    def ahead(self, ours: pd.DataFrame, others: list[pd.DataFrame], flag: str = "cfr") -> list[bool | None]:
        """Exact McNemar seed by seed against each other, the weakest counts; Holm over the others."""
        p_values, signs = [], []
        for other in others:
            tests, sides = [], set()
            for seed in sorted(ours["seed"].unique()):
                mine = ours[ours["seed"] == seed].set_index("scenario_id")[flag]
                pair = pd.concat([mine, other.set_index("scenario_id")[flag]], axis=1, join="inner", keys=["a", "b"])
                one, two = int((pair["a"] & ~pair["b"]).sum()), int((~pair["a"] & pair["b"]).sum())
                tests.append(binomtest(min(one, two), one + two).pvalue if one + two else 1.0)
                sides.add((one > two) - (one < two))
            p_values.append(max(tests) if len(sides) == 1 else 1.0)
            signs.append(sides)
        adjusted = multipletests(p_values, method="holm")[1]
        return [max(side) > 0 if p < 0.05 else None for p, side in zip(adjusted, signs, strict=True)]


def wilson(rows: pd.DataFrame, flag: str = "cfr") -> tuple[float, float]:
    low, high = proportion_confint(int(rows[flag].sum()), len(rows), method="wilson")
    return float(low), float(high)


def test_every_check_of_a_whole_store_follows_from_its_rows(root: Path, full: Evidence) -> None:
    """Rates by statsmodels, tests by scipy, Newcombe's difference written out; FM by its means."""
    raw = Rows(root)
    found = {(c.claim, c.what): verdicts.outcome(full, c) for c in claims.CHECKS}
    holds = {key: one.holds for key, one in found.items()}
    ours, swarm_rl = raw.of("main"), raw.of("swarm_rl")
    mean_fm = {name: frame.loc[frame["cfr"], "fm"].mean() for name, frame in (("ours", ours), ("rl", swarm_rl))}
    assert holds[1, "FM (m)"] is bool(mean_fm["ours"] <= 0.278)  # far from the limit: no interval decides
    assert holds[1, "FM, ratio"] is bool(mean_fm["rl"] / mean_fm["ours"] >= 3)
    assert holds[1, "CFR beside Swarm-RL's"] is (raw.ahead(ours, [swarm_rl])[0] is not False)
    for axis, end, scene in (("columns", 20, ("static", 20, 0)), ("balls", 5, ("dynamic", 0, 5))):
        names = ["swarm_rl", "rmader", "swarm_formation"]
        tests = raw.ahead(raw.of("main", *scene), [raw.of(name, *scene) for name in names])
        expected = False if False in tests else None if None in tests else True
        assert holds[2, f"CFR at {end} {axis}"] is expected
    low, high = wilson(raw.of("swarm_rl", "static", 10, 0))
    assert holds[3, "CFR, 10 columns"] is (True if low >= 0.8 else False if high < 0.8 else None)
    few, many = raw.of("swarm_rl", "dynamic", 0, 1), raw.of("swarm_rl", "dynamic", 0, 5)
    (few_low, few_high), (many_low, many_high) = wilson(few), wilson(many)
    lost = few["cfr"].mean() - many["cfr"].mean()
    ends = (
        lost - np.hypot(few["cfr"].mean() - few_low, many_high - many["cfr"].mean()),
        lost + np.hypot(few_high - few["cfr"].mean(), many["cfr"].mean() - many_low),
    )
    assert holds[3, "CFR lost, 1 to 5 balls"] is (True if ends[0] >= 0.2 else False if ends[1] < 0.2 else None)
    for arm, label in (("no_ca", "w/o CA"), ("no_sa", "w/o SA"), ("mlp", "MLP")):
        rows_of_arm = raw.of(f"{arm}-three_period")
        worst = min(("formation", "flight", "obstacle", "action"), key=lambda name: rows_of_arm[f"ok_{name}"].mean())
        low, high = wilson(rows_of_arm, f"ok_{worst}")
        assert holds[4, label] is (True if high < 0.8 else False if low >= 0.8 else None)
    arms = [raw.of(f"attention-{name}") for name in ("three_period_dynamic", "two_period", "none")]
    tests = raw.ahead(ours, arms, "sr")
    assert holds[5, "SR"] is (False if False in tests else None if None in tests else True)
    study = pd.read_parquet(next(root.glob("search/*/*/trials.parquet")))
    counted = study[(study[list(rows.WEIGHTS)] >= 0.05).all(axis=1)]
    table = np.array([counted["sr_k"], counted["sr_n"] - counted["sr_k"]])
    assert holds[6, "one SR for all (chi-squared p)"] is bool(chi2_contingency(table, correction=False).pvalue < 0.05)
    assert holds[6, "range of SR"] is bool(counted["sr"].max() - counted["sr"].min() >= 0.3)
    assert all(found[key].lacking for key in found if key[0] in (7, 8))


def test_the_table_says_every_check_with_its_limit(full: Evidence) -> None:
    table = verdicts.table(full)
    assert len(table.rows) == len(claims.CHECKS) and len(table.groups) == len(claims.CLAIMS) == 8
    limits = [row[5].plain() for row in table.rows]
    assert limits[0] == "not below 0.89 Table I" and "ahead" in limits and all(limits)
    assert "p < 0.05" in table.caption and "MAPPO" in table.caption
    assert [section.key for section in report.compose(full).sections][-2:] == ["deployment", "claims"]
