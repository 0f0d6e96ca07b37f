"""Methods on stored scenarios: every episode becomes one row, shared between processes, the same whoever flew it."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from analysis.data.runs import weakest
from envs.vocabulary import METRIC_VERSION
from formctl.engines import workers
from formctl.errors import RunFailed
from formctl.evaluation.flight import Columns, EpisodeWorker, group_size, rows_of
from formctl.evaluation.journal import EpisodeJournal, groups, table
from formctl.evaluation.recorder import Recorder, record_episode
from formctl.evaluation.scenes import EvaluationScene, batches, concatenate, locate, stack

if TYPE_CHECKING:
    from analysis.recordings import Recording
    from formctl.evaluation.methods import Method
    from formctl.evaluation.selection import TopRecordings
    from formctl.settings import Config

OnProgress = Callable[[int], None]
"""Called with the number of episodes that are done."""


def check(config: "Config", methods: Sequence["Method"], scenes: Sequence[EvaluationScene]) -> None:
    """Raise ValueError, before anything is flown, where a method cannot fly one of the scenes."""
    for method in methods:
        for scene in scenes:
            EpisodeWorker.of(method, scene.world, config).check()


def evaluate(
    method: "Method",
    scenes: Sequence[EvaluationScene],
    config: "Config",
    on_progress: OnProgress = lambda done: None,
    recordings: "TopRecordings | None" = None,
    *,
    jobs: int = 1,
    journal: Path | None = None,
) -> pd.DataFrame:
    """Fly every episode of every scene and return their rows, scene by scene in the banks' order.

    The scenes may differ in their numbers of columns and balls only: a batched method flies them side by side, which is
    several times faster. ``jobs`` worker processes share its batches, and the episodes of any other method; those are
    kept in the file ``journal`` until the caller has stored the rows. ``recordings`` is offered what was flown. The
    same call gives the same rows, whatever ``jobs`` is and however often it was interrupted. Recorded flights and
    deployments are never compiled (``eval.compile``).
    Raises ValueError where the method does not fit the world, RunFailed when a worker process dies.
    """
    worker = EpisodeWorker.of(method, scenes[0].world, config)
    if not worker.batched:
        rows = _one_by_one(worker, scenes, jobs, EpisodeJournal(journal), on_progress)
        if recordings is not None:  # flown in other processes: those that are wanted are flown once more
            columns: Columns = {str(name): column.to_numpy() for name, column in rows.items()}
            recordings.offer(
                columns, 0, lambda number, row: record_episode(method, *locate(scenes, number), config).recording
            )
    elif recordings is None:
        compiled = EpisodeWorker.of(method, scenes[0].world, config, compiled=config.eval.compile)
        rows = _in_batches(compiled, scenes, jobs, on_progress)
    else:
        rows = _recorded(worker, method, scenes, config, on_progress, recordings)
    names = pd.concat([identity(method, scene, worker.env.drones, config) for scene in scenes], ignore_index=True)
    return pd.concat([names, rows], axis=1)


def _in_batches(
    worker: EpisodeWorker, scenes: Sequence[EvaluationScene], jobs: int, on_progress: OnProgress
) -> pd.DataFrame:
    """Rows of whole batches, flown by ``jobs`` processes, or by this one where one is enough."""
    chunks = list(batches(stack(scenes), worker.rules.batch))
    here = ((index, worker(chunk)) for index, chunk in enumerate(chunks))
    tables: dict[int, pd.DataFrame] = {}
    for index, columns in workers.share(worker, chunks, jobs) if min(jobs, len(chunks)) > 1 else here:
        tables[index] = pd.DataFrame(columns)
        on_progress(sum(map(len, tables.values())))
    return pd.concat([tables[index] for index in range(len(chunks))], ignore_index=True)


def _one_by_one(
    worker: EpisodeWorker,
    scenes: Sequence[EvaluationScene],
    jobs: int,
    journal: EpisodeJournal,
    on_progress: OnProgress,
) -> pd.DataFrame:
    """Rows of episodes that each have an agent of their own; those in the journal are not flown again."""
    episodes = [episode for scene in scenes for episode in batches(scene.bank.scenarios, 1)]
    rows: dict[int, dict[str, Any]] = {n: row for n, row in journal.read().items() if n < len(episodes)}
    on_progress(len(rows))
    missing = [number for number in range(len(episodes)) if number not in rows]
    chosen = list(groups(episodes, missing, group_size(worker.agent, len(episodes), jobs)))
    requests = [concatenate([episodes[number] for number in group]) for group in chosen]
    fresh = replace(worker)  # without the agent and the world that were made here: they are not sent to processes
    try:
        for index, columns in workers.share(fresh, requests, jobs):
            for number, row in zip(chosen[index], rows_of(columns), strict=True):
                rows[number] = journal.add(number, row)
            on_progress(len(rows))
    except workers.WorkerLost as lost:
        stored = f"{len(rows)} of {len(episodes)} episodes are kept: the same command again goes on from there"
        raise RunFailed(f"{lost}; {stored if journal.path else 'no episode was kept'}") from lost
    return table([rows[number] for number in range(len(episodes))])


def _recorded(
    worker: EpisodeWorker,
    method: "Method",
    scenes: Sequence[EvaluationScene],
    config: "Config",
    on_progress: OnProgress,
    recordings: "TopRecordings",
) -> pd.DataFrame:
    """Rows of whole batches, flown in this process; ``recordings`` is offered each of them."""
    tables: list[pd.DataFrame] = []
    done = 0
    for chunk in batches(stack(scenes), config.eval.batch):
        recorder = Recorder(recordings.places(done, len(chunk.id)))
        columns = worker.fly(chunk, recorder.observe)
        recordings.offer(columns, done, partial(_recording, recorder, method, scenes, config, done))
        tables.append(pd.DataFrame(columns))
        done += len(chunk.id)
        on_progress(done)
    return pd.concat(tables, ignore_index=True)


def _recording(
    recorder: Recorder,
    method: "Method",
    scenes: Sequence[EvaluationScene],
    config: "Config",
    first: int,
    place: int,
    row: dict[str, Any],
) -> "Recording":
    """The recording of the episode at ``place`` of a batch whose first episode is row ``first``."""
    return recorder.recording(place, method, *locate(scenes, first + place), row, config)


def identity(method: "Method", scene: EvaluationScene, drones: int, config: "Config") -> pd.DataFrame:
    """The identity columns of a scene's rows."""
    scenario = scene.world.scenario
    values = {
        "method": method.name,
        "seed": int(method.facts["seed"]),
        "run": str(method.facts["run"]),
        "profile": weakest([method.profile, config.profile]) if method.profile else config.profile,
        "scenario": scenario.name,
        "columns": scenario.columns,
        "balls": scenario.balls,
        "ball_aim": scenario.ball_aim,
        "drones": drones,
        "sim": config.sim,
        "drone": scene.world.drone.name,
        "deploy": config.deploy.name if config.deploy else "",
        "message_period": scenario.messages.period,
        "message_delay": sum(scenario.messages.delay) / 2,
        "message_loss": sum(scenario.messages.loss) / 2,
        "bank": scene.bank.sha256,
        "scenario_id": scene.bank.scenarios.id.numpy(),
        "metric_version": METRIC_VERSION,
    }
    return pd.DataFrame(values)
