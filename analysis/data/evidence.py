"""What one profile's evaluations have shown: episodes grouped into cells of (method, scenario, world).

Nothing measured under one profile or budget is ever shown as another's. A policy trained under ``smoke`` stays smoke
wherever it is flown; episodes of another world (ball aim, simulator, drone, any changed setting) form cells of their
own; an episode flown twice counts once, in its latest evaluation.
"""

import hashlib
import json
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import pandas as pd

from analysis.data import methods, runs
from analysis.data.methods import Method
from analysis.data.rows import Store
from analysis.data.runs import Run
from analysis.data.text import counted, short, span
from envs.vocabulary import satisfaction

DEFAULT_PROFILE = "laptop"
"""Shown when a store is empty: what the commands use when no profile is named."""

AIMS = {"drone": "balls aimed at a drone", "box": "balls aimed at the formation's box", "mix": "mixed ball aim"}
"""Where balls are thrown, in words."""

SIMULATED = ("mixed", "static", "dynamic", "fixed4")
"""Scenes of the paper's simulations."""

_OWN_COLUMNS = ("scenario.name", "scenario.columns", "scenario.balls", "scenario.ball_aim", "drone.name", "deploy.name")
_NO_MATTER = ("eval.episodes", "eval.batch", "eval.compile", "eval.seed", "scenario.duration")
_FIRST = {"ball_aim": ("drone", "box", "mix"), "sim": ("torch", "mujoco"), "drone": ("crazyflie",)}
_PLACE = ["scenario", "columns", "balls", "ball_aim", "sim", "drone", "drones", "deploy"]


class World(NamedTuple):
    """Which world was flown in. ``settings`` is a digest of the scenario, drone and evaluation settings."""

    ball_aim: str  # drone | box | mix, "" where no ball is thrown
    sim: str
    drone: str
    drones: int
    settings: str
    deploy: str = ""  # disturbances flown with; "" in the undisturbed world, "mocap latency=0.04" for one value changed

    @property
    def standard(self) -> bool:
        """True for the paper's world: balls aimed at a drone, the torch world, three Crazyflies, no disturbances."""
        aim = self.ball_aim or "drone"
        return (aim, self.sim, self.drone, self.drones, self.deploy) == ("drone", "torch", "crazyflie", 3, "")

    def rank(self) -> tuple[tuple[int, str], ...]:
        """Sorting key: the standard world first."""

        def place(field: str, value: str) -> tuple[int, str]:
            known = ("", *_FIRST[field])
            return (known.index(value) if value in known else len(known), value)

        first = (place("ball_aim", self.ball_aim), place("sim", self.sim), place("drone", self.drone))
        return ((bool(self.deploy), self.deploy), *first, (abs(self.drones - 3), str(self.drones)))


class Where(NamedTuple):
    """A cell's place: the scenario with its numbers of obstacles, in a world."""

    scenario: str
    columns: int
    balls: int
    world: World


@dataclass(frozen=True)
class Stamp:
    """Under what a number was measured; its text goes below every table and figure."""

    profile: str
    steps: tuple[int, ...] = ()
    seeds: tuple[int, ...] = ()
    episodes: tuple[int, ...] = ()
    commits: tuple[str, ...] = ()
    unit: str = "cell"  # what the episodes are counted per

    def __str__(self) -> str:
        parts = [f"profile {self.profile}"]
        if self.steps:
            parts.append(f"trained {span(list(dict.fromkeys(map(short, self.steps))))} steps")
        if self.seeds:
            parts.append(f"one seed ({self.seeds[0]})" if len(self.seeds) == 1 else f"seeds {_list(self.seeds)}")
        if self.episodes:
            what = "episode" if self.episodes == (1,) else "episodes"
            parts.append(f"{span([f'{episodes:,}' for episodes in self.episodes])} {what} per {self.unit}")
        if self.commits:
            shown = self.commits if len(self.commits) <= 3 else (*self.commits[:3], f"+{len(self.commits) - 3}")
            parts.append("commit " + ", ".join(shown))
        return " · ".join(parts)

    @classmethod
    def of(cls, profile: str, runs: Iterable[Run], **counts: object) -> "Stamp":
        """The stamp of what these runs have trained or flown."""
        runs = list(runs)
        learnt = [run.method for run in runs if run.method is not None and run.method.learnt]
        steps = {facts.steps for facts in learnt if facts.steps is not None}
        known = {"steps": tuple(sorted(steps)), "seeds": tuple(sorted({facts.seed for facts in learnt}))}
        commits = tuple(dict.fromkeys(run.commit for run in runs))
        return cls(profile, commits=commits, **(known | counts))  # type: ignore[arg-type]


@dataclass(frozen=True)
class Evidence:
    """One profile's cells. ``notes`` says, one line each, what was left out."""

    store: Store
    profile: str
    methods: Mapping[str, Method]  # in the order of tables and legends
    cells: Mapping[tuple[str, Where], pd.DataFrame]
    worlds: Mapping[str, Mapping[str, str]]  # digest of a world's settings -> the settings
    runs: tuple[Run, ...]
    flown: Mapping[str, str]  # evaluation run -> key of the method that flew
    notes: tuple[str, ...]

    @cached_property
    def names(self) -> dict[str, str]:
        """Short, unique name of every method."""
        return methods.labels(self.methods.values())

    @cached_property
    def shown(self) -> tuple[Method, ...]:
        """Methods that stand for themselves, in their order, agents that avoid nothing last.

        Arms of an ablation have tables of their own, unless there is no full method that they are an arm of.
        A policy of another task (free flight) does not belong where it has not been flown.
        """
        full = [method for method in self.methods.values() if method.recipe and method.scene == "mixed"]
        here = {key for key, where in self.cells if where.scenario != "free"}
        own = [
            m
            for m in self.methods.values()
            if not (m.role == "arm" and any(methods.alike(m, other) for other in full))
            and (m.scene != "free" or m.key in here)
        ]
        return tuple(sorted(own, key=lambda method: method.role == "sanity"))

    @cached_property
    def expected(self) -> tuple[Method, ...]:
        """Those of ``shown`` that belong in the simulated scenes: no policy of another task, unless it flew there."""
        here = {key for key, where in self.cells if where.scenario in SIMULATED}
        return tuple(method for method in self.shown if method.scene == "mixed" or method.key in here)

    def rows(self, method: Method, where: Where) -> pd.DataFrame | None:
        """Episodes of one cell; None when nobody measured it."""
        return self.cells.get((method.key, where))

    def flew(self, where: Where) -> dict[Method, pd.DataFrame]:
        """The methods that stand for themselves and flew in a place, with their episodes."""
        return {method: self.cells[method.key, where] for method in self.shown if (method.key, where) in self.cells}

    def places(self, scenario: str, columns: int | None = None, balls: int | None = None) -> list[Where]:
        """Measured places of a scenario, optionally of given obstacle numbers; the paper's world first."""
        size: Counter[Where] = Counter()
        for (_, where), rows in self.cells.items():
            asked = (columns is None or where.columns == columns) and (balls is None or where.balls == balls)
            if where.scenario == scenario and asked:
                size[where] += len(rows)
        return sorted(size, key=lambda w: (w.world.rank(), -size[w], w.world.settings, w.columns, w.balls))

    def stamp(self, cells: Iterable[tuple[str, Where]]) -> Stamp:
        """Stamp of a table or figure made of these cells."""
        used = [self.cells[cell] for cell in cells if cell in self.cells]
        flights = sorted({str(run) for rows in used for run in rows["eval_run"].unique()})
        episodes = tuple(sorted({len(rows) for rows in used}))
        return Stamp.of(self.profile, map(self.store.run, flights), episodes=episodes)

    def satisfaction(self, cells: Iterable[tuple[str, Where]]) -> str:
        """What counts in SR, in words, by the settings these cells were flown with; empty where none tell."""
        found = dict.fromkeys(
            satisfaction(thresholds)
            for cell in cells
            if cell in self.cells
            for run in self.cells[cell]["eval_run"].unique()
            if "speed_threshold" in (thresholds := self.store.run(str(run)).config.get("eval", {}))
        )
        return f"{'; or '.join(found)}." if found else ""

    def physics_step(self, world: World) -> float | None:
        """The simulator's step in s; None where the settings do not tell."""
        settings = self.worlds.get(world.settings, {})
        period, substeps = settings.get("drone.control_period"), settings.get("drone.substeps")
        return float(period) / float(substeps) if period and substeps else None


def choose_profile(store: Store) -> str:
    """The most serious profile with an evaluated policy; without any, the most serious with whatever was measured."""
    evaluated = [store.run(id) for id in store.tables]
    policies = [run for run in evaluated if run.method and run.method.kind == "policy"]
    for candidates in (policies, evaluated):
        if candidates:
            return max(sorted({store.profile_of(run) for run in candidates}), key=runs.seriousness)
    return next(iter(store.profiles()), DEFAULT_PROFILE)


def gather(store: Store, profile: str | None = None, metric_version: int | None = None) -> Evidence:
    """Group a store's episodes under one profile (default: ``choose_profile``) into cells.

    ``metric_version``: of the rows that count, others are left out; None means the version of most rows.
    """
    profile = profile or choose_profile(store)
    notes: list[str] = []
    flown: dict[str, Method] = {}
    for id in store.tables:
        run = store.run(id)
        if run.method is None:
            notes.append(f"{run.folder}/run.json names no method: its episodes are left out")
        elif store.profile_of(run) == profile:
            flown[id] = methods.identify(run.method, run, _training(store, run), store.winners)
    known = {method.key: method for method in sorted(flown.values(), key=methods.order)}
    flights = tuple(store.run(id) for id in flown)
    if not flown:
        return Evidence(store, profile, {}, {}, {}, (), {}, tuple(notes))
    settings = {run.id: _world_settings(run) for run in flights}
    digests = {id: _digest(values) for id, values in settings.items()}
    frame = _labelled(store, flown, digests)
    frame = _without_repeats(_of_version(store, frame, metric_version, notes), notes)
    worlds = {digests[id]: values for id, values in settings.items()}
    keys = {id: method.key for id, method in flown.items()}
    return Evidence(store, profile, known, _cells(frame), worlds, flights, keys, tuple(notes))


def world_label(evidence: Evidence, world: World, standard: World | None = None) -> str:
    """A world in words; with a standard to compare with, its changed settings are named."""
    return ", ".join(world_words(evidence, world, standard))


def world_words(evidence: Evidence, world: World, standard: World | None = None) -> tuple[str, ...]:
    """What ``world_label`` joins, for tables that say once what all of their worlds share."""
    step = evidence.physics_step(world)
    pace = f" at {1000 * step:g} ms" if step else ""
    disturbed = f"deployment {world.deploy}" if world.deploy else ""
    parts = [AIMS.get(world.ball_aim, world.ball_aim), f"{world.sim} world{pace}", world.drone, disturbed]
    if world.drones != 3:
        parts.append(f"{world.drones} drones")
    if standard is not None and standard.settings != world.settings and standard.drone == world.drone:
        known, own = (evidence.worlds.get(w.settings, {}) for w in (standard, world))
        changed = [f"{key} = {value}" for key, value in own.items() if known.get(key) != value]
        parts.append("; ".join(changed[:3]) or "settings not recorded")
    return tuple(filter(None, parts))


def _training(store: Store, run: Run) -> Run | None:
    origin = store.by_id.get(run.method.run if run.method else "")
    return origin if origin is not None and origin.kind == "train" else None


def _world_settings(run: Run) -> dict[str, str]:
    groups = ("scenario", "drone", "eval", *(["deploy"] if run.config.get("deploy") else []))
    return methods.flatten(run.config, groups, without=(*_OWN_COLUMNS, *_NO_MATTER))


def _digest(settings: Mapping[str, str]) -> str:
    return hashlib.sha256(json.dumps(sorted(settings.items())).encode()).hexdigest()[:12] if settings else ""


def _labelled(store: Store, flown: Mapping[str, Method], worlds: Mapping[str, str]) -> pd.DataFrame:
    """Episodes of the chosen runs with the method's key, training seed, world and draw."""
    frame = store.episodes
    frame = frame[frame["eval_run"].isin(list(flown))].copy()
    run_of = frame["eval_run"].astype(str)
    frame["method_key"] = run_of.map({id: method.key for id, method in flown.items()}).astype("category")
    seeds = {id: method.facts.seed if method.policy else 0 for id, method in flown.items()}
    frame["train_seed"] = run_of.map(seeds).astype("int64")
    frame["world"] = run_of.map(dict(worlds)).astype("category")
    frame["ball_aim"] = frame["ball_aim"].astype("string").fillna("").where(frame["balls"] > 0, "").astype("category")
    if "deploy" not in frame:
        frame["deploy"] = ""
    frame["deploy"] = frame["deploy"].astype("string").fillna("").astype("category")
    frame["draw"] = _draws(store, frame)
    return frame


def _of_version(store: Store, frame: pd.DataFrame, wanted: int | None, notes: list[str]) -> pd.DataFrame:
    """Episodes of one metric version, the wanted or else the most frequent one, the newer of two; notes name others."""
    version = frame["metric_version"].astype(str)
    sizes = version.value_counts()
    counts = str(wanted) if wanted is not None else max(sizes.index, key=lambda text: (sizes[text], len(text), text))
    for other in sorted(set(sizes.index) - {counts}):
        flights = frame.loc[version == other, "eval_run"].unique()
        files = [str(store.run(str(run)).folder / "episodes.parquet") for run in flights]
        named = ", ".join(files[:3]) + (f", +{len(files) - 3}" if len(files) > 3 else "")
        were = "is" if sizes[other] == 1 else "are"
        notes.append(
            f"{counted(int(sizes[other]), 'episode')} of metric version {other} {were} left out, {counts} counts: "
            f"{named}; fly them again, or report with the formctl that flew them"
        )
    return frame[version == counts]


def _without_repeats(frame: pd.DataFrame, notes: list[str]) -> pd.DataFrame:
    """Every episode once, in its latest evaluation."""
    identity = ["method_key", "train_seed", "world", "draw", "scenario_id", *_PLACE]
    repeated = frame.duplicated(identity, keep="last")
    if count := int(repeated.sum()):
        were = "episode was" if count == 1 else "episodes were"
        notes.append(f"{count:,} {were} flown again later: only the latest evaluation counts")
    return frame[~repeated]


def _draws(store: Store, frame: pd.DataFrame) -> pd.Series:
    """What an episode was drawn from: the seed of its bank, or the bank itself where no seed is on record.

    Episode k of a seed is the same whatever the number of episodes drawn with it, so within a cell banks of one seed
    share their first episodes: planners that fly a hundred meet a policy's first hundred of a thousand.
    """
    banks = [(run.id, bank) for run in store.runs if run.kind == "eval" for bank in run.banks if "seed" in bank]
    seeds = {(id, str(bank["sha256"])): f"seed {bank['seed']}" for id, bank in banks}
    named = frame[["eval_run", "bank"]].astype(str)
    pairs = named.drop_duplicates()
    texts = [seeds.get((run, bank), bank) for run, bank in zip(pairs["eval_run"], pairs["bank"], strict=True)]
    drawn = named.merge(pairs.assign(draw=texts), on=["eval_run", "bank"], how="left")["draw"]
    return drawn.set_axis(frame.index).astype("category")


def _cells(frame: pd.DataFrame) -> dict[tuple[str, Where], pd.DataFrame]:
    cells = {}
    for key, rows in frame.groupby(["method_key", *_PLACE, "world"], observed=True, dropna=False, sort=True):
        method, scenario, columns, balls, aim, sim, drone, drones, deploy, settings = map(str, key)
        world = World(aim, sim, drone, int(drones), settings, deploy)
        cells[method, Where(scenario, int(columns), int(balls), world)] = rows
    return cells


def _list(numbers: tuple[int, ...]) -> str:
    if len(numbers) > 2 and numbers == tuple(range(numbers[0], numbers[-1] + 1)):
        return f"{numbers[0]}–{numbers[-1]}"
    return ", ".join(map(str, numbers))
