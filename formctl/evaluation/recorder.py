"""Recording episodes while they are flown: the world's tensors on their way into ``analysis.recordings``."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from analysis.recordings import Event, Plan, Recording, Scene, Throw, Trace
from baselines.protocol import Planning
from envs.flight import Watch
from envs.obstacles import balls_at
from envs.scenarios import select
from envs.spec import FAR, Events, State
from formctl.evaluation.flight import EpisodeWorker, rows_of
from formctl.store import provenance
from formctl.store.files import plain

if TYPE_CHECKING:
    from baselines.protocol import Agent
    from envs.formation import FormationEnv
    from formctl.evaluation.methods import Method
    from formctl.evaluation.scenes import EvaluationScene
    from formctl.settings import Config

PLAN_EVERY = 0.2
"""s between two recorded plans of a drone."""
PLAN_STEP = 0.1
"""s between two points of a recorded plan."""
PLAN_AHEAD = 4.0
"""s of a plan that are recorded."""

DIGITS = 6
"""Decimals of everything sampled but positions and attitudes: float32 has no more, and files are half as large."""

CONTACTS = {
    "column": "a drone met a column",
    "ball": "a ball met a drone",
    "drone": "two drones met",
    "ground": "a drone fell to the ground",
    "ceiling": "a drone rose above the ceiling",
}
"""What ends a flight, in words."""

STATES = ("position", "attitude", "velocity", "throttle")


class Recorder:
    """Keeps what happens to some episodes of a batch while ``EpisodeWorker.fly`` flies it with ``observe``."""

    env: "FormationEnv"
    agent: "Agent"

    def __init__(self, index: Sequence[int]) -> None:
        """``index`` are the places in the batch of the episodes to be kept."""
        self.index = list(index)
        self._samples: dict[str, list[np.ndarray]] = {
            name: [] for name in (*STATES, "command", "reward", "gap", "error")
        }
        self._plans: list[Plan] = []

    def observe(self, env: "FormationEnv", agent: "Agent", start: State) -> Watch:
        """Begin with the state of all episodes of the batch after ``env.reset``; returns what notes each step."""
        self.env, self.agent, self._last = env, agent, start
        self._chosen = torch.tensor(self.index, device=start.position.device)
        self._sample(start)
        return self.watch

    def watch(self, state: State, reward: torch.Tensor, events: Events) -> None:
        """Note one more step."""
        self._sample(state)
        gap = torch.stack((events.column, events.ball, events.drone), -1)
        for name, value in (("command", state.command), ("reward", reward), ("gap", gap)):
            self._samples[name].append(self._of(value))
        self._samples["error"].append(self._of(events.formation_error))
        self._last = state
        self._plan(float(self.env.time(state)[0]))

    def trace(self, episode: int, method: "Method", row: dict[str, Any]) -> Trace:
        """What happened to an episode of ``index``; ``row`` is what the evaluation says about it."""
        place = self.index.index(episode)
        whole = {
            name: np.stack([entry[place] for entry in entries]).astype(np.float64)
            for name, entries in self._samples.items()
        }
        gap = np.where(whole["gap"] >= FAR / 2, np.inf, whole["gap"])
        ball, throws = self._balls(episode, len(whole["position"]))
        return Trace(
            method=method.name,
            facts=plain(method.facts),
            row=plain(row),
            position=whole["position"],
            attitude=whole["attitude"],
            **{name: whole[name].round(DIGITS) for name in ("velocity", "throttle", "command", "reward")},
            gap=gap.round(DIGITS),
            formation_error=whole["error"].round(DIGITS),
            ball=ball.round(DIGITS),
            throws=throws,
            events=self._events(whole["position"], gap, throws, row),
            plans=tuple(self._plans),
        )

    def recording(
        self,
        episode: int,
        method: "Method",
        scene: "EvaluationScene",
        number: int,
        row: dict[str, Any],
        config: "Config",
    ) -> Recording:
        """The recording of an episode of ``index``, which is episode ``number`` of its scene's bank."""
        trace = self.trace(episode, method, with_limit(row, config))
        return Recording(recorded_scene(scene, self.env, config, number), (trace,), provenance.stamp())

    def _of(self, value: torch.Tensor) -> np.ndarray:
        return value[self._chosen].cpu().numpy()  # indexing has copied it

    def _sample(self, state: State) -> None:
        for name in STATES:
            self._samples[name].append(self._of(getattr(state, name)))

    def _plan(self, now: float) -> None:
        """What the planners of a fleet intend; such agents fly one episode at a time."""
        due = round(now / self.env.dt) % max(1, round(PLAN_EVERY / self.env.dt)) == 0
        if not (due and isinstance(self.agent, Planning) and self.index):
            return
        for drone, trajectory in enumerate(self.agent.plans()):
            ahead = np.arange(now, min(trajectory.end, now + PLAN_AHEAD) + 1e-9, PLAN_STEP)
            if len(ahead) > 1:
                points = np.column_stack((ahead, trajectory.at(ahead).position))
                self._plans.append(Plan(now, drone, points.round(DIGITS)))

    def _balls(self, episode: int, samples: int) -> tuple[np.ndarray, tuple[Throw, ...]]:
        """Positions (T, M, 3) of an episode's balls at every sample, NaN before the throw, and their throws."""
        own = State(*(field[episode : episode + 1] for field in self._last))
        every = State(*(field.expand(samples, *field.shape[1:]) for field in own))
        every = every._replace(step=torch.arange(samples, device=own.step.device))
        now = self.env.time(every)
        position, _, _ = balls_at(every, now)
        ball = torch.where((now[:, None] >= every.ball_time)[..., None], position, torch.nan)
        parts = [own.ball_time, own.ball_landing, own.ball_origin, own.ball_velocity]
        time, landing, origin, velocity = (part[0].double().tolist() for part in parts)
        throws = [
            Throw(number, time[number], landing[number], tuple(origin[number]), tuple(velocity[number]))
            for number in np.flatnonzero(np.isfinite(time)).tolist()
        ]
        return ball.double().cpu().numpy(), tuple(sorted(throws, key=lambda throw: throw.time))

    def _events(
        self, position: np.ndarray, gap: np.ndarray, throws: Sequence[Throw], row: dict[str, Any]
    ) -> tuple[Event, ...]:
        """Throws, every drone's first contact of each kind, and the end, in their order."""
        scenario, dt = self.env.world.scenario, self.env.dt
        found = [Event(throw.time, "throw", f"ball {throw.ball} is thrown") for throw in throws]
        height = position[1:, :, 2, None]
        low, high = scenario.altitude
        touches = np.concatenate((gap < scenario.hit_radius, height < low, height > high), -1)  # (S, N, 5)
        for drone in range(position.shape[1]):
            for number, (cause, words) in enumerate(CONTACTS.items()):
                when = np.flatnonzero(touches[:, drone, number])
                if len(when):
                    text = f"{words} (drone {drone})"
                    found.append(Event(float((when[0] + 1) * dt), "contact", text, drone, cause))
        if row["reached"]:
            found.append(Event(float(row["time_to_goal"]), "goal", "every drone is past the goal line"))
        elif len(position) * dt > row["time_limit"]:
            found.append(Event(float(row["time_limit"]), "late", "the time to reach the goal is over"))
        return tuple(sorted(found, key=lambda event: round(event.time / dt)))


def recorded_scene(scene: "EvaluationScene", env: "FormationEnv", config: "Config", episode: int) -> Scene:
    """Where episode ``episode`` of a bank takes place."""
    spec = scene.world.scenario
    columns = scene.bank.scenarios.columns[episode].double().numpy()
    return Scene(
        scenario=spec.name,
        episode=int(scene.bank.scenarios.id[episode]),
        bank=scene.bank.sha256,
        columns=columns[columns[:, 0] < FAR / 2],
        slots=env.slots.double().cpu().numpy(),
        velocity=np.array(spec.velocity, dtype=np.float64),
        goal=spec.goal,
        time_limit=config.eval.time_limit,
        altitude=spec.altitude,
        column_radius=spec.column_radius,
        ball_radius=spec.ball_radius,
        hit_radius=spec.hit_radius,
        period=env.dt,
    )


@dataclass(frozen=True)
class RecordedFlight:
    """One method on one episode: its recording and its row."""

    recording: Recording
    row: dict[str, Any]


def record_episode(method: "Method", scene: "EvaluationScene", episode: int, config: "Config") -> RecordedFlight:
    """Fly one episode of a bank alone and record it; the row equals the one that an evaluation of the bank gives.

    Raises ValueError where the method does not fit the world.
    """
    recorder = Recorder([0])
    alone = select(scene.bank.scenarios, slice(episode, episode + 1))
    (row,) = rows_of(EpisodeWorker.of(method, scene.world, config).fly(alone, recorder.observe))
    return RecordedFlight(recorder.recording(0, method, scene, episode, row, config), row)


def with_limit(row: dict[str, Any], config: "Config") -> dict[str, Any]:
    """A row as a recording keeps it: with the limit that decides about ``late``."""
    return {str(key): value for key, value in row.items()} | {"time_limit": config.eval.time_limit}


def sentence(row: dict[str, Any]) -> str:
    """What happened, in a sentence."""
    met = CONTACTS.get(str(row["failure"]))
    first = f"{met} after {row['first_contact_time']:.1f} s" if met else "no collision"
    goal = f"every drone past the goal line after {row['time_to_goal']:.1f} s" if row["reached"] else "goal not reached"
    return f"{first}; {goal}; FM {row['fm']:.2f} m, mean speed {row['mean_speed']:.2f} m/s"
