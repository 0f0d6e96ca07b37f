"""The state machine of one drone: when it plans, what it does with the outcome, when it stops.

    turn -> execute <-> replan        turn: the first plan, after all drones of lower number
               |            |
               v            v         stop: standing still; left for renew once slower than 0.1 m/s
              stop -> renew -> lost   renew: plan afresh; when that fails the goal is given up and the drone hovers

Planning takes simulated time: an attempt is computed from what is known when it begins and its outcome is used
``latency`` later. Meanwhile the drone follows what it has.
"""

from enum import Enum
from typing import NamedTuple

import numpy as np

from baselines.planner.interface import Array, Failure, State, Trajectory, View
from baselines.planner.messages import TICK, Bus, Due
from baselines.swarm_formation.minco import Polynomial, still
from baselines.swarm_formation.planner import HOLDERS, Plan, Planner, Request, hit
from baselines.swarm_formation.reference import Target
from baselines.swarm_formation.scene import Scene

STANDING = 0.1
"""m/s, below this a drone has stopped."""
ARRIVED = 1.0
"""m, this near to the goal a trajectory is not replaced any more."""
NEAR = 0.8
"""Share of the swarm clearance below which another drone's predicted place is an emergency."""
STALE = 0.25
"""s, older messages are ignored."""
MEETING_STEP = 0.03
"""s between the samples of two trajectories that may meet."""
STOP = 1.0
"""s, each of the two pieces of an emergency stop."""

Phase = Enum("Phase", "TURN EXECUTE REPLAN STOP RENEW LOST")


class Splice(NamedTuple):
    """One trajectory until another begins."""

    before: Trajectory
    after: Polynomial

    @property
    def start(self) -> float:
        """When it starts, in s."""
        return self.before.start

    @property
    def end(self) -> float:
        """When it ends, in s."""
        return self.after.end

    def at(self, time: Array) -> State:
        """The motion at ``time`` (T,) in s: each part (T, 3)."""
        later = (time >= self.after.start)[:, None]
        parts = zip(self.before.at(time), self.after.at(time), strict=True)
        return State(*(np.where(later, new, old) for old, new in parts))


class Attempt(NamedTuple):
    """A planning attempt under way."""

    plan: Plan
    rescue: bool  # asked for by the safety check


class Drone:
    """One drone's state machine; ``tick`` is called at every control period."""

    def __init__(self, number: int, place: Array, planner: Planner, bus: Bus, failures: list[Failure]) -> None:
        self.number, self.planner, self.bus, self.failures = number, planner, bus, failures
        self.phase = Phase.TURN
        self.path: Trajectory = still(0.0, place, STOP)  # followed
        self.plan: Polynomial | None = None  # the last accepted trajectory
        self.accepted: list[Polynomial] = []
        self.replans = 0  # attempts begun
        self.peers: dict[int, Polynomial] = {}
        self._target: Target | None = None
        self._failed = False
        self._tries = 0
        self._next_watch = 0.0
        self._due: Due[Attempt] = Due()

    def tick(self, view: View, scene: Scene) -> Trajectory:
        """Hear, finish, watch, decide; the trajectory to follow."""
        now = view.time
        self._hear(now)
        for attempt in self._due.take(now):
            self._finish(attempt, view, scene)
        if isinstance(self.path, Splice) and now >= self.path.after.start:
            self.path = self.path.after
        if not len(self._due) and self._next_watch <= now + TICK:
            self._next_watch = now + self.planner.spec.machine.watch
            self._watch(view, scene)
        if not len(self._due):
            self._decide(view, scene)
        return self.path

    def _hear(self, now: float) -> None:
        """Take in the others' trajectories; replan when one comes too near."""
        for message in self.bus.receive(now, self.number):
            if now - message.sent > STALE:
                continue
            self.peers[message.sender] = message.content
            if self.phase is Phase.EXECUTE and self._meets(message.content, now):
                self.phase = Phase.REPLAN

    def _meets(self, other: Polynomial, now: float) -> bool:
        """Whether the own trajectory's first two thirds come nearer than the swarm clearance to another's."""
        assert self.plan is not None
        end = self.plan.start + (self.plan.end - self.plan.start) * 2 / 3
        times = np.arange(max(now, other.start), min(end, other.end), MEETING_STEP)
        gaps = np.linalg.norm(self.plan.at(times).position - other.at(times).position, axis=-1)
        return bool((gaps < self.planner.spec.cost.swarm_clearance).any())

    def _watch(self, view: View, scene: Scene) -> None:
        """The safety check: on a hit ahead, or another drone too near, try one recovery plan."""
        if self.phase in (Phase.EXECUTE, Phase.REPLAN) and self._danger(view.time, scene)[1]:
            self._attempt(view, scene, fresh=True, formation=False, rescue=True)

    def _danger(self, now: float, scene: Scene) -> tuple[float, str]:
        """Seconds until the current trajectory hits, and what; (inf, "") when all is well."""
        assert self.plan is not None
        when, holder = hit(self.plan, scene, now)
        here = self.path.at(np.array([now])).position[0]
        for peer in self.peers.values():
            if (
                now <= peer.end
                and np.linalg.norm(_place(peer, now) - here) < NEAR * self.planner.spec.cost.swarm_clearance
            ):
                return 0.0, "drone"
        return when - now, HOLDERS[holder]

    def _decide(self, view: View, scene: Scene) -> None:
        """Begin an attempt if the phase asks for one."""
        now = view.time
        if self.phase is Phase.TURN:
            if all(drone in self.peers for drone in range(self.number)):
                self._attempt(view, scene, fresh=True, formation=True)
        elif self.phase is Phase.EXECUTE:
            assert self.plan is not None and self._target is not None
            old = now - self.plan.start > self.planner.spec.machine.period + TICK
            home = self._target.final and np.linalg.norm(view.position[self.number] - self._target.position) <= ARRIVED
            if old and not home:
                self._attempt(view, scene, fresh=False, formation=True)
        elif self.phase is Phase.REPLAN:
            self._attempt(view, scene, fresh=self._failed, formation=not self._failed)
        elif self.phase is Phase.STOP:
            if np.linalg.norm(view.velocity[self.number]) < STANDING:
                self.phase, self._tries = Phase.RENEW, 0
        elif self.phase is Phase.RENEW:
            self._attempt(view, scene, fresh=True, formation=False)

    def _attempt(self, view: View, scene: Scene, fresh: bool, formation: bool, rescue: bool = False) -> None:
        """Plan with what is known now; the outcome is due after the latency."""
        machine = self.planner.spec.machine
        start = view.time + machine.lead
        motion = self.path.at(np.array([start]))
        head = np.concatenate((motion.position, motion.velocity, motion.acceleration))
        previous = None if fresh or self.plan is None or self._target is None else (self.plan, self._target)
        request = Request(self.number, start, head, previous, dict(self.peers), formation)
        self.replans += 1
        self._due.put(view.time + machine.latency, Attempt(self.planner.plan(request, scene), rescue))

    def _finish(self, attempt: Attempt, view: View, scene: Scene) -> None:
        """Follow and broadcast a plan, or take the failed attempt's consequence."""
        plan, now = attempt.plan, view.time
        if plan.trajectory is not None:
            self.path = Splice(self.path, plan.trajectory)
            self.plan, self._target, self._failed, self.phase = plan.trajectory, plan.target, False, Phase.EXECUTE
            self.accepted.append(plan.trajectory)
            self.bus.send(now, self.number, plan.trajectory)
            return
        self.failures.append(Failure(now, self.number, plan.reason))
        self._failed = True
        if self.phase is Phase.RENEW:
            self._tries += 1
            if self._tries >= self.planner.spec.machine.attempts:
                self._lose(now)
        elif self.phase is not Phase.TURN:
            left, what = self._danger(now, scene) if attempt.rescue else (np.inf, "")
            if left < self.planner.spec.machine.emergency:
                self._stop(view, what)
            else:
                self.phase = Phase.REPLAN

    def _stop(self, view: View, what: str) -> None:
        """Stand still here and now."""
        self.plan = still(view.time, view.position[self.number], STOP)
        self.path, self.phase = self.plan, Phase.STOP
        self.bus.send(view.time, self.number, self.plan)
        self.failures.append(Failure(view.time, self.number, f"emergency stop before a {what}"))

    def _lose(self, now: float) -> None:
        self.phase = Phase.LOST
        self.failures.append(Failure(now, self.number, "goal given up"))


def _place(trajectory: Polynomial, now: float) -> Array:
    return trajectory.at(np.array([now])).position[0]
