"""What to type to measure what is missing: the one place where the report's commands are spelled."""

import shlex
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from analysis.evidence import Evidence
from analysis.methods import Method

if TYPE_CHECKING:
    import pandas as pd

DEFAULT_STORE = Path("runs")
"""Where commands look and write without being told."""
COLUMNS = (5, 10, 15, 20)
"""Columns sweep (paper, Sec. VI-A2)."""
BALLS = (1, 2, 3, 4, 5)
"""Balls sweep (paper, Sec. VI-A2)."""


def everything(evidence: Evidence) -> str:
    """The whole pipeline."""
    return f"formctl reproduce {_here(evidence)}"


def survey(evidence: Evidence) -> str:
    """Every flight of the report that stored policies and baselines have not flown yet."""
    return f"formctl reproduce survey=paper {_here(evidence)}"


def search(evidence: Evidence) -> str:
    """Stage 1: random reward weights."""
    return f"formctl search {_here(evidence)}"


def train(evidence: Evidence, encoder: str = "attention", curriculum: str = "three_period") -> str:
    """Stage 2 training of one arm."""
    return f"formctl train {_arm(encoder, curriculum)} {_here(evidence)}"


def train_as_published(evidence: Evidence, learnt: Method) -> str:
    """Train a learnt baseline for as long as its authors did."""
    facts = learnt.facts
    return f"formctl train experiment={facts.name} train.steps={facts.published_steps} {_here(evidence)}"


def train_and_fly(evidence: Evidence, encoder: str, curriculum: str, scenario: str = "mixed") -> str:
    """Train one arm and fly it; only the flight when the store has such a training."""
    for run in reversed(evidence.store.runs):
        facts = run.method
        done = run.kind == "train" and run.status == "done" and run.profile == evidence.profile and facts is not None
        if done and facts is not None and (facts.encoder, facts.curriculum) == (encoder, curriculum):
            return _eval(evidence, f"--policy {run.id}", [f"scenario={scenario}"])
    name = f"{encoder}-{curriculum}"
    flight = _eval(evidence, f"--policy {name}", [f"scenario={scenario}"])
    return f"{train(evidence, encoder, curriculum)} name={name} && {flight}"


def train_and_deploy(evidence: Evidence) -> str:
    """Train a policy for real flights and fly it over simulated motion capture and radio."""
    here = _here(evidence)
    return f"formctl train experiment=sim_to_real name=real {here} && formctl deploy --policy real {here}"


def deploy(evidence: Evidence, method: Method) -> str:
    """Fly a method that the store knows over simulated motion capture and radio."""
    return f"formctl deploy {_who(evidence, method)} {_here(evidence)}"


def deploy_baseline(evidence: Evidence, name: str) -> str:
    """Deploy a baseline by name; empty where this version has no such baseline."""
    return f"formctl deploy --baseline {name} {_here(evidence)}" if _known(evidence, name) else ""


def fly(evidence: Evidence, method: Method, words: Sequence[str], sweep: bool = False) -> str:
    """Evaluate a method that the store knows."""
    return _eval(evidence, _who(evidence, method), words, sweep)


def fly_baseline(evidence: Evidence, name: str, words: Sequence[str], sweep: bool = False) -> str:
    """Evaluate a baseline by name; empty where this version has no such baseline."""
    return _eval(evidence, f"--baseline {name}", words, sweep) if _known(evidence, name) else ""


def more(evidence: Evidence, words: Sequence[str], *flown: "tuple[Method, pd.DataFrame]") -> str:
    """More episodes where few leave a comparison open: what the method with most has; of equal numbers ten times."""
    counts = [len(rows) // rows["train_seed"].nunique() for _, rows in flown]
    wanted = max(counts) if len(set(counts)) > 1 else 10 * counts[0]
    behind = [method for (method, _), count in zip(flown, counts, strict=True) if count < wanted]
    return " && ".join(fly(evidence, method, [*words, f"eval.episodes={wanted}"]) for method in behind)


def carry_over(evidence: Evidence, study: str) -> str:
    """Train the full method with the best weights of a study, and fly it in the main scene."""
    flight = _eval(evidence, "--policy carried", ["scenario=mixed"])
    return f"{train(evidence)} weights=@{study}/best name=carried && {flight}"


def columns_sweep() -> list[str]:
    """Scenario and grid of the columns sweep."""
    return ["scenario=static", "--grid columns=" + ",".join(map(str, COLUMNS))]


def balls_sweep() -> list[str]:
    """Scenario and grid of the balls sweep."""
    return ["scenario=dynamic", "--grid balls=" + ",".join(map(str, BALLS))]


def _eval(evidence: Evidence, who: str, words: Sequence[str], sweep: bool = False) -> str:
    return " ".join(["formctl eval", *(["-m"] if sweep else []), who, *words, _here(evidence)])


def _here(evidence: Evidence) -> str:
    """Profile and, where it is not the default one, store: without them a command looks and writes elsewhere."""
    root = evidence.store.root
    elsewhere = [] if root == DEFAULT_STORE else [shlex.quote(f"runs={root}")]
    return " ".join([f"profile={evidence.profile}", *elsewhere])


def report(evidence: Evidence, profile: str) -> str:
    """Another profile's report of the same store."""
    root = evidence.store.root
    elsewhere = "" if root == DEFAULT_STORE else f" --runs {shlex.quote(str(root))}"
    return f"formctl report --profile {profile}{elsewhere}"


def _known(evidence: Evidence, baseline: str) -> bool:
    return evidence.baselines is None or baseline in evidence.baselines


def _who(evidence: Evidence, method: Method) -> str:
    if method.facts.kind != "policy":
        return f"--baseline {method.facts.name}"
    if any(run.id == method.facts.run and run.kind == "train" and not run.trial for run in evidence.store.runs):
        return f"--policy {method.facts.run}"
    return f"--policy {shlex.quote(_called(evidence, method) or method.facts.name)}"


def _called(evidence: Evidence, method: Method) -> str:
    """What the latest ``--policy`` that flew a method called it; empty where the records do not tell.

    A call with several policies tells where all others of it bear their own names.
    """
    for run in reversed(evidence.runs):
        if evidence.flown[run.id] != method.key:
            continue
        words = [str(word) for word in run.raw.get("argv") or ()]
        together = [other for other in evidence.runs if other.raw.get("argv") == run.raw.get("argv")]
        others = [other.method for other in together if evidence.flown[other.id] != method.key]
        taken = {text for facts in others if facts is not None for text in (facts.name, facts.run)}
        named = [after for word, after in pairwise(words) if word == "--policy"]
        named += [word.removeprefix("--policy=") for word in words if word.startswith("--policy=")]
        left = list(dict.fromkeys(name for name in named if name not in taken))
        if len(left) == 1:
            return left[0]
    return ""


def _arm(encoder: str, curriculum: str) -> str:
    changed = [f"curriculum={curriculum}"]
    if encoder != "attention":
        changed.append(f"encoder={encoder}")
    return " ".join(changed)
