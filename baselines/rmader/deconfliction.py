"""What a drone knows of the others, and how it comes to commit a plan (R-MADER, Sec. III).

A replan passes through three phases: thinking (search and back end, simulated latency), checking (the proposal is
published as tentative and held against everything that arrives for the length of the delay check), then commitment. A
conflict discards the proposal and the committed plan, which ends at rest, flies on. No two drones commit conflicting
plans as long as messages take no longer than the delay check.
"""

from typing import NamedTuple

from baselines.planner.interface import Failure, Parabola
from baselines.planner.messages import TICK, Bus
from baselines.rmader.bspline import Plan
from baselines.rmader.planner import NoPlan, Planner, Proposal
from baselines.rmader.spec import ClockSpec


class News(NamedTuple):
    """A message of one drone to the others."""

    plan: Plan
    committed: bool


class Store:
    """The plans of the other drones: a committed one replaces all of its sender's, a tentative one is added."""

    def __init__(self) -> None:
        self._plans: dict[int, list[Plan]] = {}

    def add(self, sender: int, news: News) -> None:
        """Take in a message."""
        kept = [] if news.committed else self._plans.get(sender, [])
        self._plans[sender] = [*kept, news.plan]

    def plans(self) -> list[Plan]:
        """All of them, by sender."""
        return [plan for sender in sorted(self._plans) for plan in self._plans[sender]]


class Pilot:
    """One drone: its committed plan, what it knows, and the replan it is in the middle of."""

    def __init__(self, planner: Planner, plan: Plan, bus: Bus, clock: ClockSpec) -> None:
        self.planner, self.plan, self.clock, self.bus = planner, plan, clock, bus
        self.failures: list[Failure] = []
        self.replans = 0  # begun so far
        self.store = Store()
        self._balls: dict[int, Parabola] = {}
        self._proposal: Proposal | None = None
        self._checking = False
        self._plans: list[Plan] = []  # what arrived and the proposal has not been held against
        self._throws: list[Parabola] = []  # likewise
        self._tests: list[float] = []  # s, still to come
        self._next = plan.start + planner.drone * clock.stagger  # s, of the next phase
        self._lead = clock.first_lead
        self._began = plan.start
        self._reason = ""
        self._told = -clock.republish

    def see(self, balls: tuple[Parabola, ...], now: float) -> None:
        """Balls in sight; one that has been seen is remembered until it lands."""
        self._throws += [ball for ball in balls if ball.ball not in self._balls]
        known = {**self._balls, **{ball.ball: ball for ball in balls}}
        self._balls = {number: ball for number, ball in known.items() if ball.landing > now}

    def tick(self, now: float) -> None:
        """Receive what has arrived, then do what is due at ``now`` (s)."""
        for message in self.bus.receive(now, self.planner.drone):
            self.store.add(message.sender, message.content)
            self._plans.append(message.content.plan)
        if self._checking:
            self._check(now)
        elif now >= self._next - TICK:
            if self._proposal is None:
                self._think(now)
            else:
                self._propose(now)
        if now >= self.plan.end and now >= self._told + self.clock.republish - TICK:
            self._publish(now, self.plan, committed=True)

    def _think(self, now: float) -> None:
        """Search for a plan with what is known now; it will be there after the latency."""
        destination = self.planner.goals.destination(self.planner.drone)
        if abs(self.plan.goal - destination).max() < self.planner.spec.goal.radius:
            return
        self._began, self._plans, self._throws = now, [], []
        self.replans += 1
        try:
            start = now + self._lead
            self._proposal = self.planner.propose(self.plan, start, self.store.plans(), list(self._balls.values()))
        except NoPlan as error:
            self._fail(now, str(error))
            self._next = now + self.clock.latency
        else:
            self._next = now + self.clock.latency

    def _propose(self, now: float) -> None:
        """Publish the proposal as tentative and begin its delay check."""
        assert self._proposal is not None
        self._publish(now, self.plan.spliced(self._proposal.plan, now), committed=False)
        count = self.clock.checks
        self._tests = [now + self.clock.delay_check * (i + 1) / count for i in range(count)]
        self._checking = True
        self._check(now)

    def _check(self, now: float) -> None:
        """Hold the proposal against what has arrived, when a test is due; commit it after the last one.

        What was known when it was searched for, and what an earlier test has seen, cannot be in conflict with it.
        """
        assert self._proposal is not None
        due = [time for time in self._tests if time <= now + TICK]
        self._tests = self._tests[len(due) :]
        if not due:
            return
        if self.planner.conflicts(self._proposal, self._plans, self._throws):
            self._fail(now, "delay check: conflict with what arrived")
            self._done(now)
            return
        self._plans, self._throws = [], []
        if self._tests:
            return
        if now > self._proposal.start:
            self._fail(now, "too late: the plan should have begun")
        else:
            self.plan = self.plan.spliced(self._proposal.plan, now)
            self._publish(now, self.plan, committed=True)
            self._reason = ""
        self._done(now)

    def _done(self, now: float) -> None:
        """Ready for the next replan, which starts as far ahead as this one took."""
        low, high = self.clock.lead_range
        self._lead = min(max(self.clock.lead_factor * (now - self._began), low), high)
        self._proposal, self._checking, self._tests, self._next = None, False, [], now + self.clock.tick

    def _publish(self, now: float, plan: Plan, committed: bool) -> None:
        self.bus.send(now, self.planner.drone, News(plan, committed))
        self._told = now

    def _fail(self, now: float, reason: str) -> None:
        """Record a failure, once until a plan has been committed or the reason has changed."""
        if reason != self._reason:
            self.failures.append(Failure(now, self.planner.drone, reason))
        self._reason = reason
