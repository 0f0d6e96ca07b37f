"""The seam between the trainer and a learner: anything that improves a policy in an arena.

A learner's settings dataclass (`conf/algo/`, named there by `target`) builds it; the trainer knows nothing else of it.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import torch
from torch.utils import _pytree as pytree

from algos.arena import Arena
from algos.compilation import Compiler
from algos.encoder import EncoderSpec
from algos.policy import Policy
from algos.replicas import ALONE, Replicas
from envs.spec import DroneSpec, ObservationLayout, ObservationSpec
from envs.vocabulary import Weights

if TYPE_CHECKING:
    from algos.networks import ActorCritic


@dataclass(frozen=True)
class Problem:
    """What is to be learnt, as far as a learner needs to know."""

    encoder: EncoderSpec
    layout: ObservationLayout
    observation: ObservationSpec
    drone: DroneSpec
    balls: int  # capacity
    weights: Weights  # of the objectives, on the simplex
    device: torch.device
    replicas: Replicas = ALONE  # processes that learn together


class Learner(Protocol):
    """Improves `policy` by flying in an arena. Its state dict holds plain containers and tensors only.

    Replicas of a learner have the same networks and optimisers, and noise of their own.
    """

    generator: torch.Generator  # of exploration noise and of minibatches

    @property
    def spec(self) -> "LearnerSpec": ...
    @property
    def policy(self) -> Policy:
        """What is judged and kept."""
        ...

    @property
    def networks(self) -> "ActorCritic":
        """What another learner would go on with."""
        ...

    def update(self, arena: Arena, progress: float) -> dict[str, float]:
        """Fly and learn once; `progress` in [0, 1) is the share of the period that has passed.

        Raises TrainingDiverged, its parameters being those of before the update.
        """
        ...

    def start_period(self) -> None:
        """A new period begins with the weights learnt so far."""
        ...

    def inherit(self, other: "Learner") -> None:
        """Go on with another learner's policy and noise, and with its critic where both are built alike."""
        ...

    def adopt(self, policy: Policy) -> None:
        """Go on with a policy trained elsewhere, without its critic. Raises ValueError if it is built otherwise."""
        ...

    def value_scale(self) -> tuple[float, float]:
        """(mean, deviation): returns are mean + deviation * what the critic says."""
        ...

    def state_dict(self) -> dict[str, Any]:
        """Everything that the next update depends on."""
        ...

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from a `state_dict`."""
        ...


class LearnerSpec(Protocol):
    """Settings of a learner, with what the trainer has to know before it builds one."""

    @property
    def envs(self) -> int: ...
    @property
    def rollout(self) -> int: ...
    @property
    def hits_terminate(self) -> bool: ...
    @property
    def stagger(self) -> bool: ...
    @property
    def pool(self) -> int: ...
    @property
    def pool_updates(self) -> int: ...

    def build(self, problem: Problem, seed: int, compiler: Compiler) -> Learner:
        """A fresh learner; all its randomness follows from `seed`."""
        ...


def snapshot(state: dict[str, Any]) -> Any:
    """A copy of a learner's state, several times cheaper than ``copy.deepcopy``."""
    return pytree.tree_map_only(torch.Tensor, torch.Tensor.clone, state)


class TrainingDiverged(RuntimeError):
    """A loss or gradient stopped being finite. `record` holds plain facts: where, which losses, which parameters."""

    def __init__(self, record: dict[str, Any]) -> None:
        super().__init__("training diverged: " + ", ".join(f"{key}={value}" for key, value in record.items()))
        self.record = record
