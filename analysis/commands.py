"""What to type to measure what is missing: the one place where the report's commands are spelled."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from analysis.evidence import Evidence
from analysis.methods import Method

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = (5, 10, 15, 20)
"""Columns sweep (paper, Sec. VI-A2)."""
BALLS = (1, 2, 3, 4, 5)
"""Balls sweep (paper, Sec. VI-A2)."""


def everything(profile: str) -> str:
    """The whole pipeline."""
    return f"formctl reproduce profile={profile}"


def survey(profile: str) -> str:
    """Every flight of the report that stored policies and baselines have not flown yet."""
    return f"formctl reproduce survey=paper profile={profile}"


def search(profile: str) -> str:
    """Stage 1: random reward weights."""
    return f"formctl search profile={profile}"


def train(profile: str, encoder: str = "attention", curriculum: str = "three_period") -> str:
    """Stage 2 training of one arm."""
    return f"formctl train {_arm(encoder, curriculum)} profile={profile}"


def train_and_fly(evidence: Evidence, encoder: str, curriculum: str, scenario: str = "mixed") -> str:
    """Train one arm and fly it; only the flight when the store has such a training."""
    for run in reversed(evidence.store.runs):
        facts = run.method
        done = run.kind == "train" and run.status == "done" and run.profile == evidence.profile and facts is not None
        if done and facts is not None and (facts.encoder, facts.curriculum) == (encoder, curriculum):
            return _eval(f"--policy {run.id}", [f"scenario={scenario}"], evidence.profile)
    name = f"{encoder}-{curriculum}"
    flight = _eval(f"--policy {name}", [f"scenario={scenario}"], evidence.profile)
    return f"{train(evidence.profile, encoder, curriculum)} name={name} && {flight}"


def train_and_deploy(evidence: Evidence) -> str:
    """Train a policy for real flights and fly it over simulated motion capture and radio."""
    profile = f"profile={evidence.profile}"
    return f"formctl train experiment=sim_to_real name=real {profile} && formctl deploy --policy real {profile}"


def fly(evidence: Evidence, method: Method, words: Sequence[str], sweep: bool = False) -> str:
    """Evaluate a method that the store knows."""
    if method.facts.kind == "policy":
        who = f"--policy {method.facts.run or method.facts.name}"
    else:
        who = f"--baseline {method.facts.name}"
    return _eval(who, words, evidence.profile, sweep)


def fly_baseline(evidence: Evidence, name: str, words: Sequence[str], sweep: bool = False) -> str:
    """Evaluate a baseline by name; empty where this version has no such baseline."""
    if evidence.baselines is not None and name not in evidence.baselines:
        return ""
    return _eval(f"--baseline {name}", words, evidence.profile, sweep)


def more(evidence: Evidence, words: Sequence[str], *flown: "tuple[Method, pd.DataFrame]") -> str:
    """More episodes where few leave a comparison open: what the method with most has; of equal numbers ten times."""
    counts = [len(rows) // rows["train_seed"].nunique() for _, rows in flown]
    wanted = max(counts) if len(set(counts)) > 1 else 10 * counts[0]
    behind = [method for (method, _), count in zip(flown, counts, strict=True) if count < wanted]
    return " && ".join(fly(evidence, method, [*words, f"eval.episodes={wanted}"]) for method in behind)


def carry_over(profile: str, study: str) -> str:
    """Train the full method with the best weights of a study, and fly it in the main scene."""
    flight = _eval("--policy carried", ["scenario=mixed"], profile)
    return f"{train(profile)} weights=@{study}/best name=carried && {flight}"


def columns_sweep() -> list[str]:
    """Scenario and grid of the columns sweep."""
    return ["scenario=static", "--grid columns=" + ",".join(map(str, COLUMNS))]


def balls_sweep() -> list[str]:
    """Scenario and grid of the balls sweep."""
    return ["scenario=dynamic", "--grid balls=" + ",".join(map(str, BALLS))]


def _eval(who: str, words: Sequence[str], profile: str, sweep: bool = False) -> str:
    return " ".join(["formctl eval", *(["-m"] if sweep else []), who, *words, f"profile={profile}"])


def _arm(encoder: str, curriculum: str) -> str:
    changed = [f"curriculum={curriculum}"]
    if encoder != "attention":
        changed.append(f"encoder={encoder}")
    return " ".join(changed)
