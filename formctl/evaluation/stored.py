"""From ``RUN:EPISODE`` back to the very scene, method and row: an evaluation's episode flown once more."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from envs.bank import Bank
from formctl import store
from formctl.evaluation import methods, migrations
from formctl.evaluation.rows import read_rows
from formctl.evaluation.scenes import EvaluationScene
from formctl.settings import build, choices, restore
from formctl.store.files import StoreError

if TYPE_CHECKING:
    from formctl.evaluation.methods import Method
    from formctl.settings import Config

EQUAL = ("failure", "cfr", "fm", "first_contact_time", "contact_drone", "min_column", "min_ball", "min_drone")
"""Columns in which a replay must equal the evaluation's row."""

CLOSE = 1e-3
"""m and s by which other arithmetic (another machine, a batch of another size, compiled) may differ; flags and reasons
have to be equal."""


@dataclass(frozen=True)
class StoredEpisode:
    """An episode of an evaluation run, ready to be flown again."""

    run: store.Run
    number: int  # place among the run's rows
    config: "Config"
    scene: EvaluationScene
    episode: int  # place in the scene's bank
    row: dict[str, Any]
    method: "Method"


def find(text: str, root: Path, policy: str | None = None, also: str = "") -> StoredEpisode:
    """The episode that ``RUN:EPISODE`` names: EPISODE is the number of a row, from 0. Raises ValueError, one line.

    ``policy`` is where to look for the one that flew; ``also`` says what else the caller would have taken.
    """
    name, colon, digits = text.rpartition(":")
    if not colon or not name or not digits.isdigit():
        raise StoreError(f"cannot read '{text}': write RUN:EPISODE, for example main:7{also}")
    run = store.resolve(name, root, kind="eval", holding="episodes.parquet")
    if run.kind != "eval":
        raise StoreError(f"{run.path} is a {run.kind} run: only episodes of an evaluation can be flown again")
    rows = read_rows(run.path / "episodes.parquet")
    number = int(digits)
    if number >= len(rows):
        raise StoreError(f"{run.path} has no episode {number}: its episodes are 0 to {len(rows) - 1}")
    config = config_of(run)
    scene, episode = scene_of(run, config, number)
    row = {str(key): value for key, value in rows.iloc[number].items()}
    return StoredEpisode(run, number, config, scene, episode, row, method_of(run, root, policy))


def config_of(run: store.Run) -> "Config":
    """What the evaluation was flown with; that of an earlier version with today's keys. Raises StoreError."""
    tree = {key: value for key, value in run.config.items() if key != "baseline"}
    return restore(migrations.complete(tree, run.path / "config.yaml"))


def scene_of(run: store.Run, config: "Config", number: int) -> tuple[EvaluationScene, int]:
    """The scene of a row, its bank drawn again, and the row's place in that bank. Raises StoreError."""
    before = 0
    for bank in run.record.get("banks") or [run.record["bank"]]:
        if number < before + bank["episodes"]:
            counts = {key: bank[key] for key in ("columns", "balls") if key in bank}
            varied = restore(config.tree | {"scenario": config.tree["scenario"] | counts})
            drawn = Bank.create(varied.scenario, bank["episodes"], bank["seed"])
            if drawn.sha256 != bank["sha256"]:
                raise StoreError(
                    f"the bank of {run.path} cannot be drawn again ({drawn.sha256[:12]} is not {bank['sha256'][:12]}):"
                    " it comes from another version; evaluate once more"
                )
            return EvaluationScene(build.world(varied), drawn), number - before
        before += bank["episodes"]
    raise StoreError(f"{run.path}/run.json names {before} episodes in its banks: row {number} is not among them")


def method_of(run: store.Run, root: Path, policy: str | None) -> "Method":
    """Who flew: the baseline with its settings, or the policy.

    A policy is looked for in the run's own store, in ``root`` and among those that ship with formctl, unless ``policy``
    says where it is. Raises StoreError where it is nowhere, and for a ``policy`` that did not fly the run.
    """
    facts = run.record["method"]
    if facts["kind"] == "baseline":
        if policy is not None:
            raise StoreError(f"{run.path} was flown by the baseline {facts['name']}: leave --policy {policy} out")
        return methods.stored_baseline(facts, run.config.get("baseline") or {})
    if policy is not None:
        given = methods.policy(policy, root)
        if facts["run"] and given.facts["run"] not in ("", facts["run"]):
            raise StoreError(
                f"--policy {policy} comes from training run {given.facts['run']}, but {run.path} was flown by"
                f" {facts['name']} of training run {facts['run']}"
            )
        return given
    for folder in dict.fromkeys((run.path.parents[2], root)):
        for training in store.scan(folder, kind="train") if facts["run"] else ():
            if training.path.name == facts["run"] and (training.path / "policy.pt").is_file():
                return methods.policy(str(training.path / "policy.pt"), root)
    for path in methods.shipped().values() if facts["run"] else ():
        known = methods.policy(str(path), root)
        if all(known.facts[key] == facts[key] for key in ("run", "seed", "steps")):
            return known
    raise StoreError(
        f"the policy of {run.path} (training run {facts['run'] or 'unknown'}) is not in {root}/ and does not ship with"
        " formctl: give --policy RUN, FILE or NAME"
    )


def opponent(text: str, root: Path) -> "Method":
    """Who ``--vs`` means: a baseline's name, else a trained policy. Raises ValueError, one line."""
    names = choices("baseline")
    if text in names:
        return methods.baseline(text)
    try:
        return methods.policy(text, root)
    except StoreError as error:
        raise StoreError(f"{error}; baselines: {', '.join(names)}") from None


def differences(replayed: dict[str, Any], row: dict[str, Any]) -> list[str]:
    """The columns of EQUAL in which a replay is not the evaluation's row, by more than rounding."""

    def same(ours: Any, theirs: Any) -> bool:
        both = pd.isna(ours) and pd.isna(theirs)
        return both or (abs(ours - theirs) <= CLOSE if isinstance(ours, float) else ours == theirs)

    return [key for key in EQUAL if not same(replayed[key], row[key])]
