"""What a fleet is told: the task from the scenario, and a view of the world at every control period.

Balls are seen, not announced: a ball becomes known after two frames in which it was in the air and within the sensing
range of any drone, as the parabola through both (paper, Sec. VI: adaptation of the planners to thrown balls).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.planner.interface import Array, Links, Parabola, Task, View
from envs import obstacles
from envs.dynamics import GRAVITY
from envs.formation import FormationEnv
from envs.spec import FAR, Scenarios, ScenarioSpec, State

TICK = 1e-9
"""s; times closer than this are the same."""


def fit(ball: int, times: tuple[float, float], frames: tuple[Array, Array], ground: float = 0.0) -> Parabola:
    """The parabola through two positions (3,) in m at two ``times`` in s, until its height is ``ground`` in m.

    v1 = (p2 - p1) / d + g d / 2 up, with d the time between the frames; a ball below ``ground`` lands at once.
    """
    spacing = times[1] - times[0]
    if spacing <= 0:
        raise ValueError(f"two frames {spacing} s apart tell no velocity: the second has to be later")
    first, second = frames
    velocity = (second - first) / spacing
    velocity[2] += 0.5 * GRAVITY * spacing
    height = max(first[2] - ground, 0.0)
    landing = times[0] + (velocity[2] + np.sqrt(velocity[2] ** 2 + 2 * GRAVITY * height)) / GRAVITY
    return Parabola(ball, times[0], first, velocity, float(landing))


def position(ball: Parabola, time: Array) -> Array:
    """Where the ball is (T, 3) in m at ``time`` (T,) in s: on its parabola, also before its frames, until it lands."""
    aloft = np.minimum(np.asarray(time, dtype=float), ball.landing) - ball.time
    path = ball.origin + ball.velocity * aloft[..., None]
    path[..., 2] -= 0.5 * GRAVITY * aloft**2
    return path


def task(env: FormationEnv, scenarios: Scenarios) -> Task:
    """The task of a single episode; absent columns are left out."""
    scenario = env.world.scenario
    columns = scenarios.columns[0].double().numpy()
    radius = scenario.hit_radius
    return Task(
        offsets=env.slots.double().numpy(),
        velocity=np.array(scenario.velocity, dtype=float),
        height=scenario.height,
        goal=scenario.goal,
        columns=columns[(np.abs(columns) < FAR / 2).all(-1)],
        column_radius=radius,
        ball_radius=radius,
        drone_radius=radius,
        altitude=scenario.altitude,
        corridor=scenario.corridor,
        period=env.dt,
        links=Links(scenario.messages.period, scenarios.delays[0].double().numpy())
        if scenario.messages.window
        else None,
    )


class Glance(NamedTuple):
    """What is to be seen of one episode at one control period."""

    time: float  # s since the start of the episode
    position: Array  # (N, 3) m
    velocity: Array  # (N, 3) m/s
    ball: Array  # (M, 3) m
    flying: NDArray[np.bool_]  # (M,) whether the ball is in the air


def glances(state: State, period: float) -> list[Glance]:
    """Every episode of ``state`` after its steps of ``period`` s, in double precision."""
    exact = state._replace(**{name: getattr(state, name).double() for name in state._fields if "ball" in name})
    times = state.step.double() * period
    balls, _, flying = obstacles.balls_at(exact, times)
    parts = (times, state.position.double(), state.velocity.double(), balls, flying)
    times_, positions, velocities, places, aloft = (part.numpy() for part in parts)
    return [Glance(float(times_[e]), positions[e], velocities[e], places[e], aloft[e]) for e in range(len(times_))]


class Sight:
    """The eyes of one fleet during one episode."""

    def __init__(self, scenario: ScenarioSpec, spacing: float) -> None:
        self._scenario, self._spacing = scenario, spacing
        self._first: dict[int, tuple[float, Array]] = {}
        self._known: dict[int, Parabola] = {}

    def look(self, glance: Glance) -> View:
        """The fleet's view; to be called at every control period."""
        time = glance.time
        seen = self._seen(glance)
        self._first = {ball: frame for ball, frame in self._first.items() if ball in seen}
        for ball, place in seen.items():
            begun, first = self._first.setdefault(ball, (time, place))
            if ball not in self._known and time - begun >= self._spacing - TICK:
                self._known[ball] = fit(ball, (begun, time), (first, place), self._scenario.ball_radius)
        balls = tuple(self._known[ball] for ball in sorted(seen) if ball in self._known)
        return View(time, glance.position, glance.velocity, balls)

    def _seen(self, glance: Glance) -> dict[int, Array]:
        """Balls in the air and in range of any drone: number -> position (3,) in m."""
        range_ = np.linalg.norm(glance.ball[:, None] - glance.position, axis=-1).min(-1)
        seen = np.flatnonzero(glance.flying & (range_ < self._scenario.sensing_range))
        return {int(ball): glance.ball[ball] for ball in seen}
