"""Trackers: where the numbers of a training go beside ``metrics.jsonl``, which is always written (``conf/logger/``).

TensorBoard, Weights & Biases, MLflow and Trackio stand behind one protocol. All of them write to files of the store;
none needs an account, and nothing leaves the machine unless ``logger.online=true`` asks for it.
"""

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Protocol

from formctl.extras import require
from formctl.settings.schema import LoggerSpec
from formctl.store import LiveRun
from formctl.store.files import disk_errors


class Tracker(Protocol):
    """One run in a tracker."""

    def log(self, numbers: Mapping[str, float], steps: int) -> None:
        """Numbers of the moment at which ``steps`` environment steps were done."""
        ...

    def close(self) -> None:
        """Everything is written."""
        ...


@contextmanager
def opened(live: LiveRun, spec: LoggerSpec | None, steps: int) -> Iterator[Callable[[dict[str, Any]], None]]:
    """Yield a function that writes one row to ``metrics.jsonl`` and to the trackers that ``spec`` names.

    ``steps`` were done before: what TensorBoard was told past them is taken back. Raises ConfigError for a tracker that
    is not installed.
    """
    with ExitStack() as stack:
        stack.enter_context(disk_errors(live.path))
        used = [] if spec is None else [TRACKERS[name](live, spec, steps) for name in names(spec)]
        for tracker in used:
            stack.callback(tracker.close)

        def track(row: dict[str, Any]) -> None:
            live.log(row)
            numbers = {key: float(value) for key, value in row.items() if isinstance(value, int | float)}
            del numbers["steps"]
            for tracker in used:
                tracker.log(numbers, row["steps"])

        yield track


def names(spec: LoggerSpec) -> list[str]:
    """The trackers of a logger."""
    return [*(["tensorboard"] if spec.tensorboard else []), *([spec.tracker] if spec.tracker else [])]


def check(spec: LoggerSpec) -> None:
    """Raise ConfigError, before anything is trained, for a tracker that is not installed."""
    if spec.tracker:
        require(spec.tracker, spec.tracker)


class TensorBoard:
    """Event files in the run's folder ``tensorboard/``."""

    def __init__(self, live: LiveRun, spec: LoggerSpec, steps: int) -> None:
        from torch.utils.tensorboard import SummaryWriter

        self.writer = SummaryWriter(str(live.path / "tensorboard"), purge_step=steps or None)

    def log(self, numbers: Mapping[str, float], steps: int) -> None:
        for key, value in numbers.items():
            self.writer.add_scalar(key, value, steps)

    def close(self) -> None:
        self.writer.close()


class WandB:
    """A Weights & Biases run named like ours; offline in the run's folder unless ``logger.online``.

    ``wandb sync RUN/wandb/offline-*`` sends it later. A training that goes on is the same run.
    """

    def __init__(self, live: LiveRun, spec: LoggerSpec, steps: int) -> None:
        import wandb

        self.run = wandb.init(
            project=spec.project,
            name=f"{live.record['name']}/{live.id}",
            id=live.id,
            resume="allow",
            dir=str(live.path),
            config=dict(live.config),
            mode="online" if spec.online else "offline",
            settings=wandb.Settings(silent=True, console="off", x_disable_stats=True),
        )

    def log(self, numbers: Mapping[str, float], steps: int) -> None:
        self.run.log(dict(numbers), step=steps)

    def close(self) -> None:
        self.run.finish()


class MLflow:
    """An MLflow run in ``mlflow.db`` of the store, or on the server of ``MLFLOW_TRACKING_URI`` with ``logger.online``.

    ``mlflow ui --backend-store-uri sqlite:///runs/mlflow.db`` shows the store's. What goes on is the same run.
    """

    def __init__(self, live: LiveRun, spec: LoggerSpec, steps: int) -> None:
        from mlflow import MlflowClient
        from mlflow.entities import Metric

        self._metric = Metric
        local = f"sqlite:///{_store(live).resolve() / 'mlflow.db'}"
        uri = os.environ.get("MLFLOW_TRACKING_URI", local) if spec.online else local
        self.client = MlflowClient(tracking_uri=uri)
        known = self.client.get_experiment_by_name(spec.project)
        experiment = known.experiment_id if known else self.client.create_experiment(spec.project)
        found = self.client.search_runs([experiment], f"tags.formctl = '{live.id}'")
        tags = {"formctl": live.id}
        run = found[0] if found else self.client.create_run(experiment, run_name=live.record["name"], tags=tags)
        self.id = run.info.run_id

    def log(self, numbers: Mapping[str, float], steps: int) -> None:
        from time import time

        now = int(1000 * time())
        self.client.log_batch(self.id, [self._metric(key, value, now, steps) for key, value in numbers.items()])

    def close(self) -> None:
        self.client.set_terminated(self.id)


class Trackio:
    """A Trackio run in ``trackio/`` of the store; ``TRACKIO_DIR=runs/trackio trackio show`` is its page.

    With ``logger.online`` the Space that ``TRACKIO_SPACE_ID`` names gets it too. What goes on is the same run.
    """

    def __init__(self, live: LiveRun, spec: LoggerSpec, steps: int) -> None:
        os.environ.setdefault("TRACKIO_DIR", str(_store(live).resolve() / "trackio"))  # read when it is imported
        import trackio

        space = os.environ.get("TRACKIO_SPACE_ID") if spec.online else None
        settings: dict[str, Any] = {"embed": False, "auto_log_cpu": False, "auto_log_gpu": False}
        self.run = trackio.init(spec.project, name=live.id, space_id=space, resume="allow", **settings)

    def log(self, numbers: Mapping[str, float], steps: int) -> None:
        self.run.log(dict(numbers), step=steps)

    def close(self) -> None:
        self.run.finish()


TRACKERS: dict[str, Callable[[LiveRun, LoggerSpec, int], Tracker]] = {
    "tensorboard": TensorBoard,
    "wandb": WandB,
    "mlflow": MLflow,
    "trackio": Trackio,
}


def _store(live: LiveRun) -> Path:
    """The store of a run: three folders up."""
    return live.path.parents[2]
