"""What drones know of each other: messages that are sent in turn, arrive late, and sometimes do not arrive.

The paper assumes perfect communication and names delays as future work (Sec. VII). Here every drone tells the others
its position and velocity every ``period`` seconds. Each message has its own delay on each link (Gamma), and messages
are lost in bursts (Gilbert and Elliott's two-state channel: everything is lost in the bad state, nothing in the good
one). A receiver keeps the newest message that has arrived and extrapolates it at constant velocity; what it cannot know
is how old its knowledge of a turn or a brake is.

Delays and losses are drawn before the flight. What was said is kept in the state (``State.told``), so that a step stays
a pure function through which gradients flow: also through what a drone told the others a quarter of a second ago.
"""

import math
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from envs.spec import MessageSpec, Scenarios, ScenarioSpec, State

EARLY = 1e-3
"""Share of a period by which a message may be early: times in float32 are not exact."""


class Neighbours(NamedTuple):
    """What each drone knows of the others, these in ascending order."""

    position: Tensor  # (E, N, N-1, 3) m, extrapolated to now
    velocity: Tensor  # (E, N, N-1, 3) m/s, as it was
    age: Tensor  # (E, N, N-1) s, since the newest message that has arrived was sent


def draw(
    spec: MessageSpec, scenario: ScenarioSpec, count: int, drones: int, generators: tuple[np.random.Generator, ...]
) -> Tensor:
    """``Scenarios.delays`` of ``count`` flights in float32: (count, N, N, K); message k is sent at k ``period``.

    ``generators`` are three: of a flight's means, of delays, of losses. Longer flights use the K messages again.
    """
    if not spec.period:
        return torch.zeros(count, drones, drones, 0)
    flights, late, lost = generators
    messages = max(math.ceil(scenario.duration / spec.period), spec.window)
    delays = torch.empty(count, drones, drones, messages)
    means = flights.random((count, 2))
    for first in range(0, count, 256):  # blocks: many messages make large tables
        mean, loss = (
            low + (high - low) * means[first : first + 256, k, None, None]
            for k, (low, high) in enumerate((spec.delay, spec.loss))
        )
        shape = (len(mean), drones, drones, messages)
        drawn = mean[..., None] * _gamma(spec.jitter, shape, late)
        drawn[_losses(loss, spec.burst, lost.random(shape))] = np.inf
        delays[first : first + 256] = torch.from_numpy(drawn)
    return delays


def _gamma(jitter: float, shape: tuple[int, ...], generator: np.random.Generator) -> np.ndarray:
    """Gamma numbers with mean 1 and standard deviation ``jitter``."""
    return generator.standard_gamma(jitter**-2, shape) * jitter**2 if jitter else np.ones(shape)


def _losses(share: np.ndarray, burst: float, numbers: np.ndarray) -> np.ndarray:
    """Which messages (..., K) are lost: a share of them, ``burst`` in a row on average.

    ``numbers`` (..., K) are uniform; ``share`` (..., 1) is each flight's.
    """
    leave = 1 / burst
    enter = leave * share / (1 - share)
    bad = numbers[..., 0] < share
    lost = [bad]
    for k in range(1, numbers.shape[-1]):
        bad = np.where(bad, numbers[..., k] >= leave, numbers[..., k] < enter)
        lost.append(bad)
    return np.stack(lost, -1)


def first(position: Tensor, window: int) -> Tensor:
    """``State.told`` before take-off: all ``window`` messages say that the drones stand at ``position`` (E, N, 3)."""
    standing = torch.cat((position, torch.zeros_like(position)), -1)
    return standing[:, :, None].expand(-1, -1, window, -1).clone()


def tell(state: State, before: Tensor, now: Tensor, spec: MessageSpec) -> State:
    """The state with a message of every drone, where one was due after ``before`` and up to ``now`` (E,) in s."""
    due = _sent(now, spec) > _sent(before, spec)
    said = torch.cat((state.position, state.velocity), -1)[:, :, None]
    told = torch.cat((said, state.told[:, :, :-1]), 2)
    return state._replace(told=torch.where(due[:, None, None, None], told, state.told))


def neighbours(state: State, scenarios: Scenarios, time: Tensor, spec: MessageSpec) -> Neighbours:
    """What each drone knows of the others at ``time`` (E,) in s; all of it, where the state holds no messages."""
    drones, window = state.told.shape[1:3]
    pairs = [[(i, j) for j in range(drones) if j != i] for i in range(drones)]
    receiver, sender = torch.tensor(pairs, device=time.device).unbind(-1)  # (N, N-1)
    if window == 0:
        age = state.position.new_zeros(len(time), drones, drones - 1)
        return Neighbours(state.position[:, sender], state.velocity[:, sender], age)
    last = torch.arange(window, device=time.device)
    sent = _sent(time, spec)
    number = (sent[:, None] - last) % scenarios.delays.shape[-1]
    delay = scenarios.delays.gather(-1, number[:, None, None].expand(-1, drones, drones, -1))
    ages = (time - spec.period * sent.to(time)).clamp_min(0)[:, None] + spec.period * last.to(time)  # (E, W)
    arrived = delay[:, sender, receiver] <= ages[:, None, None] + EARLY * spec.period  # (E, N, N-1, W)
    newest = torch.where(arrived, last, window - 1).amin(-1)
    age = ages.gather(1, newest.flatten(1)).view_as(newest)
    episode = torch.arange(len(time), device=time.device)[:, None, None]
    position, velocity = state.told[episode, sender, newest].split((3, 3), -1)
    return Neighbours(position + velocity * age[..., None], velocity, age)


def _sent(time: Tensor, spec: MessageSpec) -> Tensor:
    """Number (E,) of the newest message that was sent at ``time`` (E,) in s."""
    return (time / spec.period + EARLY).floor().long()
