"""From the steps of an episode to its row: collisions, progress, formation, smoothness and satisfaction.

An episode is judged until its *end*: the moment every drone has passed the goal line, or ``time_limit``. It succeeds
when until then no drone touched anything or left the flight corridor, and the goal was reached: columns stand inside
the corridor only, so whoever may leave it meets none. Contacts after the end do not count for CFR, but
``first_contact_time`` is kept over the whole flight, so that other goal lines can be judged from the same rows. The
columns are described in ``docs/rows.md``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
import torch
from annotated_types import Ge, Gt
from torch import Tensor

from envs import rotation
from envs.formation import FormationEnv
from envs.spec import FAR, Events, State
from envs.vocabulary import CONTACTS, FAILURES

PERIOD = 0.02
"""s, between two samples of an episode, whatever the control period: changes per sample would halve at 100 Hz."""


@dataclass(frozen=True)
class EvalSpec:
    """How policies are flown and judged (``conf/eval/``)."""

    episodes: Annotated[int, Ge(1)]
    batch: Annotated[int, Ge(1)]  # episodes flown side by side
    compile: bool  # what flies them side by side
    seed: Annotated[int, Ge(0)]  # of the scenarios, when no bank is given
    seconds: Annotated[float, Gt(0)]  # s flown
    time_limit: Annotated[float, Gt(0)]  # s, every drone has to pass the goal line by then
    goal_lines: tuple[float, ...]  # m, passing times kept in the row
    strict_radius: Annotated[float, Ge(0)]  # m, hit radius with the drone's own body added
    corridor: Annotated[float, Gt(0)]  # m, |x| beyond which a drone has left the corridor
    formation_threshold: Annotated[float, Gt(0)]  # m, FM of a satisfying episode is below
    speed_threshold: Annotated[float, Gt(0)]  # m/s, mean |v - v*| of a satisfying episode is below
    height_threshold: Annotated[float, Gt(0)]  # m, mean distance from the commanded altitude of one is below
    action_threshold: Annotated[float, Gt(0)]  # mean throttle change of a satisfying episode is below


class EpisodeLog(NamedTuple):
    """Running record of E episodes; times in s, inf for never."""

    contact: Tensor  # (E, 5) first time of each cause at the hit radius
    strict: Tensor  # (E,) first contact at the strict radius
    contact_drone: Tensor  # (E,) drone of the first contact, -1 for none
    passed: Tensor  # (E, 1 + lines) when every drone had passed the goal and each goal line
    outside: Tensor  # (E,) when a drone first left the corridor
    steps: Tensor  # (E,) samples until the end
    steps_to_contact: Tensor  # (E,)
    sums: Tensor  # (E, 8) of SUMMED until the end
    contact_error: Tensor  # (E,) sum of the formation error up to the first contact
    least: Tensor  # (E, 3) m, smallest column, ball and drone distance until the end
    last_change: Tensor  # (E,) throttle change of the last sample before the end


SUMMED = (
    "fm",
    "shape_error",
    "throttle_change",
    "command_change",
    "speed_error",
    "height_error",
    "heading_error",
    "mean_speed",
)


def start(env: FormationEnv, state: State, evaluation: EvalSpec) -> EpisodeLog:
    """An empty record for the episodes in ``state``."""
    x = state.position

    def full(*shape: int, value: float = 0.0) -> Tensor:
        return x.new_full((len(x), *shape), value)

    never = float("inf")
    return EpisodeLog(
        contact=full(len(CONTACTS), value=never),
        strict=full(value=never),
        contact_drone=full(value=-1).long(),
        passed=full(1 + len(evaluation.goal_lines), value=never),
        outside=full(value=never),
        steps=full().long(),
        steps_to_contact=full().long(),
        sums=full(len(SUMMED)),
        contact_error=full(),
        least=full(3, value=FAR),
        last_change=full(),
    )


def span(env: FormationEnv) -> int:
    """Control periods per sample: 1 at 50 Hz, 2 at 100 Hz; at least 1."""
    return max(1, round(PERIOD / env.dt))


def merged(events: Sequence[Events], before: State, after: State) -> Events:
    """What happened in the consecutive steps of one sample, from ``before`` to ``after``, as if it were one step.

    Distances are the least of all steps, formation errors those of the last; changes are from end to end.
    """
    if len(events) == 1:
        return events[0]
    first = (before.step == 0)[:, None]
    least = (torch.stack([getattr(step, name) for step in events]).amin(0) for name in ("column", "ball", "drone"))
    return Events(
        *least,
        events[-1].formation_error,
        events[-1].shape_error,
        torch.where(first, 0.0, rotation.norm(after.command - before.command)),
        rotation.norm(after.throttle - before.throttle),
    )


def update(log: EpisodeLog, env: FormationEnv, state: State, events: Events, evaluation: EvalSpec) -> EpisodeLog:
    """The record after one more sample of ``PERIOD`` s that ended in ``state`` with ``events``."""
    now = env.time(state)
    scenario = env.world.scenario
    running = (now <= evaluation.time_limit + 1e-6) & log.passed[:, 0].isinf()
    untouched = log.contact.amin(-1).isinf()
    ground, ceiling = env.crashed(state)
    gaps = torch.stack((events.column, events.ball, events.drone), -1)  # (E, N, 3)
    touches = torch.cat((gaps < scenario.hit_radius, torch.stack((ground, ceiling), -1)), -1)  # (E, N, 5)
    strict = (gaps < evaluation.strict_radius).any(-1) | ground | ceiling
    contact = _first(log.contact, touches.any(1), now[:, None])
    course = state.position[..., 1].amin(-1, keepdim=True)
    lines = course.new_tensor((scenario.goal, *evaluation.goal_lines))
    touching = touches.any(-1)
    first_drone = torch.where(touching.any(-1), touching.long().argmax(-1), -1)
    counted = running.to(log.sums)
    up_to_contact = running & untouched
    change = events.throttle_change.mean(-1)
    return EpisodeLog(
        contact=contact,
        strict=_first(log.strict, strict.any(-1), now),
        contact_drone=torch.where(untouched, first_drone, log.contact_drone),
        passed=_first(log.passed, course > lines, now[:, None]),
        outside=_first(log.outside, (state.position[..., 0].abs() > evaluation.corridor).any(-1), now),
        steps=log.steps + running,
        steps_to_contact=log.steps_to_contact + up_to_contact,
        sums=log.sums + counted[:, None] * _summands(env, state, events, change),
        contact_error=log.contact_error + up_to_contact.to(counted) * events.formation_error,
        least=torch.where(running[:, None], torch.minimum(log.least, gaps.amin(1)), log.least),
        last_change=torch.where(running, change, log.last_change),
    )


def _first(times: Tensor, happened: Tensor, now: Tensor) -> Tensor:
    return torch.where(happened & times.isinf(), now, times)


def _summands(env: FormationEnv, state: State, events: Events, change: Tensor) -> Tensor:
    """Values (E, 8) in the order of SUMMED, averaged over the team."""
    wanted = state.velocity.new_tensor(env.world.scenario.velocity)
    forward = wanted.new_tensor([1.0, 0.0, 0.0])
    team = (
        rotation.norm(state.velocity - wanted),
        (state.position[..., 2] - env.world.scenario.height).abs(),
        rotation.norm(rotation.heading_axis(state.attitude) - forward),
        rotation.norm(state.velocity),
    )
    own = (events.formation_error, events.shape_error, change, events.command_change.mean(-1))
    return torch.stack((*own, *(value.mean(-1) for value in team)), -1)


def rows(log: EpisodeLog, evaluation: EvalSpec) -> dict[str, np.ndarray]:
    """One entry per episode of every metric column (``docs/rows.md``); times that never came are NaN.

    Numbers are kept to float32's precision, the world's own: as float64 of which half is noise they fill half the disk.
    """
    passed, contact = log.passed.double(), log.contact.double()
    limit = evaluation.time_limit + 1e-6
    end = passed[:, 0].clamp_max(limit)
    reached = passed[:, 0] <= limit
    hit = contact <= end[:, None]
    clean = ~hit.any(-1)
    clean_strict = log.strict.double() > end
    left = log.outside.double()
    inside = left > end
    steps = log.steps.clamp_min(1).double()
    means = (log.sums.double() / steps[:, None]).unbind(-1)
    columns: dict[str, Tensor] = dict(zip(SUMMED, means, strict=True))
    contact_error = log.contact_error.double() / log.steps_to_contact.clamp_min(1)
    columns |= {
        "cfr": clean & reached & inside,
        "cfr_strict": clean_strict & reached & inside,
        "cfr_any_path": clean & reached,
        "reached": reached,
        "time_to_goal": _seconds(torch.where(reached, passed[:, 0], torch.inf)),
        **{
            "time_y" + f"{line:g}".replace(".", "_"): _seconds(passed[:, 1 + k])
            for k, line in enumerate(evaluation.goal_lines)
        },
        **{f"hit_{cause}": hit[:, k] for k, cause in enumerate(CONTACTS)},
        "crashed": hit[:, 3] | hit[:, 4],
        "hit_strict": ~clean_strict,
        "first_contact_time": _seconds(contact.amin(-1)),
        "contact_drone": log.contact_drone,
        "left_corridor": ~inside,
        "fm_to_contact": contact_error,
        "throttle_change_last": log.last_change.double(),
        "ok_formation": columns["fm"] < evaluation.formation_threshold,
        "ok_flight": reached
        & inside
        & (columns["speed_error"] < evaluation.speed_threshold)
        & (columns["height_error"] < evaluation.height_threshold),
        "ok_obstacle": clean_strict,
        "ok_action": columns["throttle_change"] < evaluation.action_threshold,
        **{f"min_{name}": _distance(log.least[:, k]) for k, name in enumerate(CONTACTS[:3])},
    }
    columns["sr"] = columns["ok_formation"] & columns["ok_flight"] & columns["ok_obstacle"] & columns["ok_action"]
    table = {name: _kept(value).cpu().numpy() for name, value in columns.items()}
    table["failure"] = _failure(torch.cat((contact, left[:, None]), -1), end, reached)
    return table


def _kept(values: Tensor) -> Tensor:
    return values.float().double() if values.is_floating_point() else values


def _seconds(time: Tensor) -> Tensor:
    return torch.where(time.isinf(), torch.nan, time)


def _distance(gap: Tensor) -> Tensor:
    return torch.where(gap >= FAR / 2, torch.nan, gap.double())


def _failure(times: Tensor, end: Tensor, reached: Tensor) -> np.ndarray:
    """First of the failures in words; ``late`` where only the goal was not reached in time, empty for success.

    ``times`` (E, 6) in s: the first contact of each cause, and when the corridor was left.
    """
    failed = (times <= end[:, None]).any(-1)
    first = torch.where(failed, times.argmin(-1), torch.where(reached, len(FAILURES), len(FAILURES) - 1))
    return np.array([*FAILURES, ""], dtype=object)[first.cpu().numpy()]
