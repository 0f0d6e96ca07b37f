"""A survey: which methods fly which scenes, how often (``conf/survey``), and which of those cells the store lacks.

A cell is one method in one scene. It is there already when a finished evaluation of the store flew that method through
that very bank under the same rules, whoever started it; so a survey goes on where it stopped, and rows that were flown
by hand count.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from analysis.data.methods import identify
from analysis.data.runs import read_run
from envs.bank import Bank
from envs.vocabulary import METRIC_VERSION
from formctl import store
from formctl.errors import ConfigError
from formctl.evaluation import methods, migrations
from formctl.evaluation.disturbances import disturbed, read_values
from formctl.evaluation.evaluate import check
from formctl.evaluation.methods import Method
from formctl.evaluation.scenes import EvaluationScene
from formctl.settings import Config, build, choices, compose, expand_sweep, restore
from formctl.store import Run
from formctl.store.compare import fingerprint
from formctl.store.files import StoreError

if TYPE_CHECKING:
    from formctl.settings.schema import PartSpec


POLICIES, NEWEST, ARMS, FLIGHT = "policies", "newest", "arms", "flight"
"""The groups of trained policies: all, of those that differ in their seed only the newest, arms of the ablations
(which are in neither), and those trained for real flights. All other groups are listed in the survey."""

NO_MATTER = ("episodes", "batch", "compile", "seed")
"""Keys of ``eval`` that the bank says better, or that change no more than rounding."""


@dataclass(frozen=True)
class SuiteCell:
    """One method in one scene, with the settings it is flown under."""

    part: str
    method: Method
    config: Config
    scene: EvaluationScene
    record: str | None

    @property
    def key(self) -> str:
        """Equal for cells whose rows are the same."""
        facts, own = self.method.facts, self.method.settings
        return key(self.config.tree, facts, own, self.scene.bank.sha256, self.record is not None)


@dataclass(frozen=True)
class SuitePlan:
    """Every cell of a survey in its order, those that the store has, and what cannot be flown, one line each."""

    cells: tuple[SuiteCell, ...]
    stored: Mapping[str, Run]  # cell key -> the run with its rows
    left_out: tuple[str, ...]

    @property
    def missing(self) -> tuple[SuiteCell, ...]:
        """Cells that have to be flown."""
        return tuple(cell for cell in self.cells if cell.key not in self.stored)

    def rows(self) -> list[tuple[str, ...]]:
        """Part, method, scenes, episodes, and how many of the scenes are there: one line per part and method."""
        together: dict[tuple[str, str, str], list[SuiteCell]] = {}
        for cell in self.cells:
            together.setdefault((cell.part, cell.method.name, _origin(cell.method)), []).append(cell)
        lines: list[tuple[str, ...]] = []
        for (part, name, origin), cells in together.items():
            stored = sum(cell.key in self.stored for cell in cells)
            episodes = f"{len(cells)} x {len(cells[0].scene.bank):,}"
            lines.append((part, f"{name} {origin}".strip(), episodes, f"{stored} of {len(cells)}"))
        return lines


def plan(config: Config, words: Sequence[str]) -> SuitePlan:
    """The survey of ``config``; ``words`` are the overrides it was composed from. Raises ConfigError for a bad part."""
    assert config.survey is not None
    left_out: list[str] = []
    groups = policies(config, left_out)
    groups |= {name: _baselines(names, left_out) for name, names in config.survey.groups.items()}
    stored = stored_cells(config)
    cells: dict[str, SuiteCell] = {}
    refusals: dict[tuple[str, int, str], str] = {}
    for name, part in config.survey.parts.items():
        _check(name, part, groups)
        for cell in _part(config, words, name, part, groups):
            asked = (name, id(cell.method), cell.config.sim)  # scenes of a part differ in their obstacles only
            if cell.key not in stored and asked not in refusals:
                refusals[asked] = _refusal(cell)
                if refusals[asked]:
                    left_out.append(f"{cell.method.name} cannot fly part {name}: {refusals[asked]}")
            if not refusals.get(asked):
                cells.setdefault(cell.key, cell)
    return SuitePlan(tuple(cells.values()), stored, tuple(dict.fromkeys(left_out)))


def policies(config: Config, left_out: list[str]) -> dict[str, list[Method]]:
    """The groups of policies: of the store's finished trainings under this profile, the oldest first; the shipped ones
    without any.

    What a baseline flies (Swarm-RL was trained here too) is not among them.
    """

    assert config.survey is not None
    groups: dict[str, list[Method]] = {POLICIES: [], ARMS: [], FLIGHT: []}
    newest: dict[str, Method] = {}
    for run in reversed(store.scan(config.runs, kind="train", status="done", profile=config.profile)):
        experiment = str(run.record["method"].get("experiment"))
        if not (run.path / "policy.pt").is_file() or {run.name, experiment} & set(choices("baseline")):
            continue
        if str(run.config["scenario"]["name"]).startswith("real"):
            groups[FLIGHT].append(methods.policy(str(run.path / "policy.pt"), config.runs))
        elif run.config["scenario"]["name"] == config.survey.trained_on:
            training = read_run(run.path)
            assert training.method is not None
            trained = identify(training.method, training, training)
            group = ARMS if trained.role == "arm" else POLICIES
            groups[group].append(methods.policy(str(run.path / "policy.pt"), config.runs))
            if group == POLICIES:
                newest[trained.key] = groups[group][-1]
    if not any(groups.values()):
        left_out.append(f"{config.runs} has no finished training of profile {config.profile}: shipped policies fly")
        for name, path in methods.shipped().items():
            if name not in choices("baseline"):
                policy = methods.policy(str(path), config.runs)
                groups[FLIGHT if policy.facts.get("experiment") == "sim_to_real" else POLICIES].append(policy)
    return groups | {NEWEST: list(newest.values()) or groups[POLICIES]}


def stored_cells(config: Config) -> dict[str, Run]:
    """Cells that finished evaluations of the store hold: key -> run, the newest of each."""

    found: dict[str, Run] = {}
    for run in store.scan(config.runs, kind="eval", status="done", profile=config.profile):
        if not _current(run.path / "episodes.parquet"):
            continue
        record = run.record
        try:
            tree = migrations.complete(read_run(run.path).config)
        except StoreError:
            continue  # nobody knows what it was flown with
        for bank in record.get("banks") or [record["bank"]]:
            for recorded in {False, bool(record.get("recordings"))}:
                found.setdefault(key(tree, record["method"], tree.get("baseline"), bank["sha256"], recorded), run)
    return found


def key(
    tree: Mapping[str, Any],
    facts: Mapping[str, Any],
    baseline: Mapping[str, Any] | None,
    bank: str,
    recorded: bool,
) -> str:
    """Digest of everything that the rows of a cell depend on, but for the program itself."""

    if facts["kind"] == "policy":
        who = {name: facts.get(name) for name in ("name", "run", "seed", "steps")}
    else:
        who = {"name": facts["name"]} | {k: v for k, v in (baseline or {}).items() if k != "deviations"}
    rules = {name: value for name, value in tree["eval"].items() if name not in NO_MATTER}
    world = {name: tree.get(name) for name in ("drone", "sim", "deploy")}
    return fingerprint({"who": who, "eval": rules, **world, "bank": bank, "recorded": recorded})


def _check(name: str, part: "PartSpec", groups: Mapping[str, Any]) -> None:

    if unknown := [group for group in part.episodes if group not in groups]:
        known = ", ".join(groups)
        raise ConfigError(f"survey.parts.{name}.episodes: there is no group {unknown[0]!r}; the groups are {known}")


def _part(
    config: Config, words: Sequence[str], name: str, part: "PartSpec", groups: Mapping[str, list[Method]]
) -> Iterator[SuiteCell]:
    """The cells of a part, method by method."""

    assert config.survey is not None
    if not part.words or not any(groups[group] for group in part.episodes):
        return
    kept = [word for word in words if not word.startswith(("survey", "name="))]
    named = f"name={config.survey.name}-{name}"
    composed = [compose([*kept, named, *combination]) for combination in expand_sweep(part.overrides)]
    worlds = [varied for base in composed for varied in disturbed(base, read_values(part.option("vary")))]
    for group, episodes in part.episodes.items():
        for method in groups[group]:
            for world in worlds:
                yield _cell(name, method, world, min(episodes, config.eval.episodes), part.record)


def _cell(part: str, method: Method, config: Config, episodes: int, record: str | None) -> SuiteCell:
    """A cell; a policy sees what it was trained to see."""

    own = method.settings_of(restore(config.tree | {"eval": config.tree["eval"] | {"episodes": episodes}}))
    return SuiteCell(part, method, own, EvaluationScene(build.world(own), _bank(own, episodes)), record)


_banks: dict[tuple[str, int, int], Any] = {}


def _bank(config: Config, episodes: int) -> Any:
    """The scenario's bank; drawn once for all methods."""

    own = (repr(config.scenario), episodes, config.eval.seed)
    if own not in _banks:
        _banks[own] = Bank.create(config.scenario, episodes, config.eval.seed)
    return _banks[own]


def _baselines(names: Sequence[str], left_out: list[str]) -> list[Method]:

    known = choices("baseline")
    left_out += [f"there is no baseline {name!r} here" for name in names if name not in known]
    return [methods.baseline(name) for name in names if name in known]


def _refusal(cell: SuiteCell) -> str:
    """Why a method cannot fly a scene; empty where it can."""

    try:
        check(cell.config, [cell.method], [cell.scene])
    except ValueError as error:
        return str(error)
    return ""


def _current(path: Path) -> bool:
    """Whether rows are there and of this metric version."""

    try:
        versions = pd.read_parquet(path, columns=["metric_version"])["metric_version"]
    except (OSError, ValueError, KeyError):
        return False
    return bool((versions == METRIC_VERSION).all())


def _origin(method: Method) -> str:
    """What tells policies of one name apart."""
    return f"seed {method.facts['seed']} ({method.facts['run'] or 'no run'})" if method.trained is not None else ""
