"""One sitting of a weight search: trials are claimed, run by an engine, and written down, until the study is whole.

Several sittings may share a study on PostgreSQL; a SQLite study has one at a time. A sitting that ends gives back what
it has not finished; one that is killed is missed when its leases run out, or when the next owner takes over.
"""

import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from types import FrameType
from typing import TYPE_CHECKING, Any

from formctl.console import Bar, progress, say, warn
from formctl.engines.engine import Engine, Withdrawn, WorkerLost
from formctl.search import overview
from formctl.search.ledger import LeaseLost
from formctl.search.patience import Patience
from formctl.search.study import Study, Ticket
from formctl.search.trial import TrialRequest, request, run_trial
from formctl.store.files import StoreError

if TYPE_CHECKING:
    from formctl.settings import Config
    from formctl.store import Run

ATTEMPTS = 5
"""Workers that a trial may lose in a row without getting any further; then it is the trial that kills them."""

POLL = 5.0
"""s between two looks at a study whose last trials are with other hosts."""


class Sitting:
    """What one process does for a study until the study has ``total`` trials."""

    def __init__(self, study: Study, run: "Run", config: "Config", total: int, bar: Bar) -> None:
        self.study, self.run, self.config, self.total, self.bar = study, run, config, total, bar
        self.tickets: dict[int, Ticket] = {}  # trials that are here now
        self.shares: dict[int, float] = {}  # how far each of them is, from 0 to 1
        self.tenths: dict[int, int] = {}  # of its budget, up to which its curve is on record
        self.steps: dict[int, int] = {}  # of the trials that were heard of here
        self.seen: dict[int, float] = {}  # when each lease was last renewed
        self.stuck: dict[int, tuple[int, int]] = {}  # steps at the last loss, and losses in a row there
        self.lost = 0
        self.patience = Patience()  # with the run's record
        self.pruner = pruner(config)
        self.done = total - study.missing(total)

    def work(self, engine: Engine, settled: Callable[[], None]) -> None:
        """Run trials until the study is whole; ``settled`` is called now and then.

        What is unfinished at the end, however it comes, is given back. Raises StoreError, KeyboardInterrupt.
        """
        try:
            while True:
                with closing(engine.run(run_trial, self.draw, self.hear)) as finished:  # type: ignore[type-var]
                    for item in finished:
                        self.settle(item.request, item.result, item.error)
                        if self.patience.due():
                            with self.patience.spend():
                                settled()
                if not self.study.missing(self.total):
                    return
                time.sleep(POLL)  # the rest is with other hosts, which may yet lose it
        finally:
            for ticket in list(self.tickets.values()):
                with suppress(StoreError, LeaseLost):  # what cannot be told now, the lease's age will tell
                    self.study.give_back(ticket)
            with suppress(StoreError):
                self.study.write_table()
                settled()

    def draw(self) -> TrialRequest | None:
        """The next trial to run here."""
        while (ticket := self.study.claim(self.total)) is not None:
            ours = ticket.trial in self.tickets  # still at work, but silent for so long that its lease ran out
            self.tickets[ticket.trial], self.seen[ticket.trial] = ticket, time.monotonic()
            if not ours:
                break
        if ticket is None:
            return None
        return request(self.config, self.run, ticket.trial, ticket.weights)

    def hear(self, asked: TrialRequest, note: Mapping[str, Any]) -> None:
        """A trial is further on: the progress line, ten points of its learning curve, and its lease.

        Raises Withdrawn for a trial that is pruned or was handed to somebody else.
        """
        steps, total, value = note["steps"], note["total"], note["value"]
        trial, ticket = asked.trial, self.tickets[asked.trial]
        self.steps[trial] = steps
        self.shares[trial] = steps / total
        self.bar.update(self.done + sum(self.shares.values()), f"trial {trial}: {steps:,} of {total:,} steps")
        try:
            if value is not None and 10 * steps // total > self.tenths.get(trial, 0):
                self.seen[trial], self.tenths[trial] = time.monotonic(), 10 * steps // total
                self.study.report(ticket, steps, value)
                self.pruner(self.study, ticket)
            elif time.monotonic() - self.seen[trial] > self.study.lease / 10:
                self.seen[trial] = time.monotonic()
                self.study.ledger.renew(ticket.lease)
        except LeaseLost as error:
            raise Withdrawn(str(error)) from error

    def settle(self, asked: TrialRequest, outcome: Mapping[str, Any] | None, error: Exception | None) -> None:
        """Record how a trial ended. A store that cannot be written is no failure of the trial: it is raised again."""
        ticket = self.tickets[asked.trial]
        self.shares.pop(asked.trial, None)
        self.tenths.pop(asked.trial, None)
        try:
            if isinstance(error, StoreError):
                raise error
            if isinstance(error, WorkerLost):
                self.lose(ticket, error)
            elif isinstance(error, Pruned):
                say(f"trial {asked.trial} pruned: {error}")
                self.study.prune(ticket, str(error), **self.known(asked))
            elif isinstance(error, Withdrawn):
                raise LeaseLost(str(error))
            elif error is not None or outcome is None:
                self.fail(ticket, f"{type(error).__name__}: {error}".splitlines()[0], asked)
            else:
                self.study.finish(ticket, outcome)
                told(asked, outcome)
        except LeaseLost as gone:
            warn(f"{gone}; what was done here is dropped")
        del self.tickets[asked.trial]
        self.done = self.total - self.study.missing(self.total)
        self.bar.update(self.done + sum(self.shares.values()))

    def lose(self, ticket: Ticket, error: WorkerLost) -> None:
        """A worker died: somebody else goes on with its trial, unless the trial has killed too many."""
        self.lost += 1
        steps = self.steps.get(ticket.trial, 0)
        before, count = self.stuck.get(ticket.trial, (-1, 0))
        count = count + 1 if steps <= before else 1
        self.stuck[ticket.trial] = (max(steps, before), count)
        if count >= ATTEMPTS:
            reason = f"WorkerLost: {error}; {count} workers in a row at {steps:,} steps"
            warn(f"trial {ticket.trial} failed: {reason}")
            self.study.fail(ticket, reason, seed=self.config.seed)
            return
        warn(f"trial {ticket.trial} lost its worker at {steps:,} steps ({error}); another one goes on with it")
        self.study.give_back(ticket, lost=True)

    def fail(self, ticket: Ticket, reason: str, asked: TrialRequest) -> None:
        warn(f"trial {ticket.trial} failed: {reason}")
        self.study.fail(ticket, reason, **self.known(asked))

    def known(self, asked: TrialRequest) -> dict[str, Any]:
        """What there is to say of a trial that has no outcome."""
        run = str(asked.folder.relative_to(asked.search))
        return {"seed": self.config.seed, "budget": self.config.search.steps, "run": run}


class Pruned(Withdrawn):
    """A trial that is clearly worse than the others at the same point."""


def pruner(config: "Config") -> Callable[[Study, Ticket], None]:
    """A function that raises Pruned where ``search.pruner`` gives a trial up."""
    import optuna

    kind, steps = config.search.pruner, config.search.steps
    if kind == "none":
        return lambda study, ticket: None
    made: optuna.pruners.BasePruner = (
        optuna.pruners.MedianPruner(n_startup_trials=5, n_warmup_steps=steps // 4)
        if kind == "median"
        else optuna.pruners.HyperbandPruner(min_resource=max(1, steps // 9), max_resource=steps)
    )

    def judge(study: Study, ticket: Ticket) -> None:
        seen = study.optuna()
        if made.prune(seen, next(t for t in seen.get_trials(deepcopy=False) if t._trial_id == ticket.lease.trial_id)):
            raise Pruned(f"{kind} pruner, after {max(seen.trials[ticket.trial].intermediate_values):,} steps")

    return judge


def work(study: Study, run: "Run", config: "Config", total: int, settled: Callable[[], None]) -> None:
    """Bring the study to its total with the configured engine."""
    done = total - study.missing(total)
    with progress(f"search {run.path.parent.name}", total, "trials", start=done) as bar:
        sitting = Sitting(study, run, config, total, bar)
        try:
            with terminable():
                sitting.work(config.engine.build(silence=study.lease), settled)
        except KeyboardInterrupt as stop:
            raise KeyboardInterrupt(f"{stop or 'interrupted'}; the same command again goes on from there") from stop
    if lost := overview.losses(study.ledger):
        say(f"workers lost in the middle of a trial, over the whole study: {lost}; their trials went on elsewhere")


@contextmanager
def terminable() -> Iterator[None]:
    """SIGTERM, which batch systems send before their limit, stops like Ctrl-C: workers save, trials are given back."""

    def stop(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt("asked to stop")

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def told(asked: TrialRequest, outcome: Mapping[str, Any]) -> None:
    """Say how a trial came out."""
    w = asked.settings["weights"]
    vector = ", ".join(f"{key} {w[key]:.2f}" for key in ("formation", "flight", "obstacle", "action"))
    say(f"trial {asked.trial}: SR {outcome['sr']:.3f} ({outcome['sr_k']} of {outcome['sr_n']}) with {vector}")
