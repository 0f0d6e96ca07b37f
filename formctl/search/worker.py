"""What one process does for a study: trials are claimed, run by an engine, and recorded, until the study is whole.

Several processes may work for a study on PostgreSQL; a SQLite study has one at a time. A worker that ends gives back
what it has not finished; one that is killed is missed when its leases run out, or when the next owner takes over.
"""

import time
from collections.abc import Callable, Mapping
from contextlib import closing, suppress
from typing import Any

from optuna import pruners

from formctl.console import Bar, progress, say, warn
from formctl.engines.engine import Engine, Withdrawn, WorkerLost
from formctl.interrupts import handled, interrupt
from formctl.search.leases import LeaseLost, Ticket
from formctl.search.study import WeightStudy
from formctl.search.throttle import Throttle
from formctl.search.trial import TrialRequest, run_trial
from formctl.settings import Config
from formctl.store.files import StoreError

ATTEMPTS = 5
"""Workers that a trial may lose in a row without getting any further; then it is the trial that kills them."""

POLL = 5.0
"""s between two looks at a study whose last trials are with other hosts."""

MakeRequest = Callable[[Ticket], TrialRequest]


class StudyWorker:
    """Works for a study until it has ``total`` trials."""

    def __init__(self, study: WeightStudy, config: Config, total: int, ask: MakeRequest, bar: Bar) -> None:
        self.study, self.config, self.total, self.ask, self.bar = study, config, total, ask, bar
        self.tickets: dict[int, Ticket] = {}  # trials that are here now
        self.shares: dict[int, float] = {}  # how far each of them is, from 0 to 1
        self.tenths: dict[int, int] = {}  # of its budget, up to which its curve is on record
        self.steps: dict[int, int] = {}  # of the trials that were heard of here
        self.seen: dict[int, float] = {}  # when each lease was last renewed
        self.stuck: dict[int, tuple[int, int]] = {}  # steps at the last loss, and losses in a row there
        self.throttle = Throttle()  # of the run's record
        self.pruner = pruner(config)
        self.cold = config.train.compile  # nothing has trained here yet: one trial compiles for all
        self.done = total - study.missing(total)

    def work(self, engine: Engine, on_recorded: Callable[[], None]) -> None:
        """Run trials until the study is whole; ``on_recorded`` is called now and then.

        What is unfinished at the end, however it comes, is given back. Raises StoreError, KeyboardInterrupt.
        """
        try:
            while True:
                with closing(engine.run(run_trial, self.draw, self.hear)) as finished:  # type: ignore[type-var]
                    for item in finished:
                        self.settle(item.request, item.result, item.error)
                        if self.throttle.due():
                            with self.throttle.turn():
                                on_recorded()
                if not self.study.missing(self.total):
                    return
                time.sleep(POLL)  # the rest is with other hosts, which may yet lose it
        finally:
            for ticket in list(self.tickets.values()):
                with suppress(StoreError, LeaseLost):  # what cannot be told now, the lease's age will tell
                    self.study.give_back(ticket)
            with suppress(StoreError):
                self.study.write_table()
                on_recorded()

    def draw(self) -> TrialRequest | None:
        """The next trial to run here; none beside one that still compiles what all will use."""
        if self.cold and self.tickets:
            return None
        while (ticket := self.study.claim(self.total)) is not None:
            ours = ticket.trial in self.tickets  # still at work, but silent for so long that its lease ran out
            self.tickets[ticket.trial], self.seen[ticket.trial] = ticket, time.monotonic()
            if not ours:
                break
        if ticket is None:
            return None
        asked = self.ask(ticket)
        if self.cold and self.config.engine.workers > 1:
            say(f"{asked.label} begins alone: what it compiles, if this machine has not yet, serves all")
        return asked

    def hear(self, asked: TrialRequest, note: Mapping[str, Any]) -> None:
        """A trial is further on: the progress line, ten points of its learning curve, and its lease.

        Raises Withdrawn for a trial that is pruned or was handed to somebody else.
        """
        steps, total, value = note["steps"], note["total"], note["value"]
        trial, ticket = asked.trial, self.tickets[asked.trial]
        self.cold = self.cold and not steps
        self.steps[trial], self.shares[trial] = steps, steps / total
        if steps:
            self.bar.update(self.done + sum(self.shares.values()), f"{asked.label}: {steps:,} of {total:,} steps")
        try:
            if value is not None and 10 * steps // total > self.tenths.get(trial, 0):
                self.seen[trial], self.tenths[trial] = time.monotonic(), 10 * steps // total
                self.study.report(ticket, steps, value)
                if self.pruner and (reason := self.study.prune_reason(ticket, self.pruner)):
                    raise Pruned(reason)
            elif time.monotonic() - self.seen[trial] > self.study.lease / 10:
                self.seen[trial] = time.monotonic()
                self.study.report(ticket, steps, None)
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
                self.lose(ticket, error, asked)
            elif isinstance(error, Pruned):
                say(f"{asked.label} pruned: {error}")
                self.study.prune(ticket, str(error), **self.known(asked))
            elif isinstance(error, Withdrawn):
                raise LeaseLost(str(error))
            elif error is not None or outcome is None:
                self.fail(ticket, f"{type(error).__name__}: {error}".splitlines()[0], asked)
            else:
                self.study.finish(ticket, outcome)
                rate = f"SR {outcome['sr']:.3f} ({outcome['sr_k']} of {outcome['sr_n']})"
                say(f"{asked.label}: {rate} with {asked.weights}")
        except LeaseLost as gone:
            warn(f"{gone}; what was done here is dropped")
        del self.tickets[asked.trial]
        self.done = self.total - self.study.missing(self.total)
        self.bar.update(self.done + sum(self.shares.values()))

    def lose(self, ticket: Ticket, error: WorkerLost, asked: TrialRequest) -> None:
        """A worker died: somebody else goes on with its trial, unless the trial has killed too many."""
        steps = self.steps.get(ticket.trial, 0)
        before, count = self.stuck.get(ticket.trial, (-1, 0))
        count = count + 1 if steps <= before else 1
        self.stuck[ticket.trial] = (max(steps, before), count)
        if count >= ATTEMPTS:
            self.fail(ticket, f"WorkerLost: {error}; {count} workers in a row at {steps:,} steps", asked)
            return
        warn(f"{asked.label} lost its worker at {steps:,} steps ({error}); another one goes on with it")
        self.study.give_back(ticket, lost=True)

    def fail(self, ticket: Ticket, reason: str, asked: TrialRequest) -> None:
        """Record a trial that cannot be finished."""
        warn(f"{asked.label} failed: {reason}")
        self.study.fail(ticket, reason, **self.known(asked))

    def known(self, asked: TrialRequest) -> dict[str, Any]:
        """What there is to say of a trial that has no outcome."""
        return {"seed": asked.settings["seed"], "budget": asked.settings["train"]["steps"], "run": asked.folder}


class Pruned(Withdrawn):
    """A trial that is clearly worse than the others at the same point."""


def pruner(config: Config) -> pruners.BasePruner | None:
    """Optuna's pruner that ``search.pruner`` names."""
    steps = config.search.steps
    if config.search.pruner == "median":
        return pruners.MedianPruner(n_startup_trials=5, n_warmup_steps=steps // 4)
    if config.search.pruner == "hyperband":
        return pruners.HyperbandPruner(min_resource=max(1, steps // 9), max_resource=steps)
    return None


def work(
    study: WeightStudy,
    config: Config,
    total: int,
    ask: MakeRequest,
    *,
    label: str,
    on_recorded: Callable[[], None] = lambda: None,
) -> None:
    """Bring the study to its total with the configured engine."""
    done = total - study.missing(total)
    with progress(label, total, "trials", start=done) as bar:
        worker = StudyWorker(study, config, total, ask, bar)
        try:
            with handled(interrupt):
                worker.work(config.engine.build(silence=study.lease), on_recorded)
        except KeyboardInterrupt as stop:
            raise KeyboardInterrupt(f"{stop or 'interrupted'}; the same command again goes on from there") from stop
    if lost := study.leases.losses():
        say(f"workers lost in the middle of a trial, over the whole study: {lost}; their trials went on elsewhere")
