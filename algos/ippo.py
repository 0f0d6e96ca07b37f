"""Independent PPO as Swarm-RL is trained (Huang et al. 2023; its code on Sample Factory): MAPPO's machinery, whose
critic sees only what its drone sees, with the costs of collisions growing from nothing and collisions replayed.
"""

from dataclasses import dataclass
from typing import Any

from algos.arena import Arena
from algos.compilation import Compiler
from algos.learner import Learner, Problem
from algos.mappo import Mappo, MappoSpec
from algos.replay import Replay, Replaying, ReplaySpec


@dataclass(frozen=True)
class IppoSpec(MappoSpec):
    """Settings of MAPPO, and what Swarm-RL adds (`conf/algo/swarm_rl.yaml`)."""

    annealing: float  # share of the period over which the obstacle objective's weight grows from 0; 0: there at once
    replay: ReplaySpec

    def build(self, problem: Problem, seed: int, compiler: Compiler) -> "Ippo":
        return Ippo(self, problem, seed, compiler)


def annealed(progress: float, annealing: float) -> float:
    """The share of the obstacle objective's weight that counts at `progress` in [0, 1] of a period."""
    return min(progress / annealing, 1.0) if annealing else 1.0


class Ippo(Mappo):
    """The learner (see `algos.learner.Learner`)."""

    def __init__(self, spec: IppoSpec, problem: Problem, seed: int, compiler: Compiler) -> None:
        super().__init__(spec, problem, seed, compiler)
        self.final_weights = problem.weights
        self.own = spec
        self.replay = Replay(spec.replay, problem.drone.control_period, seed)

    def start_period(self) -> None:
        super().start_period()
        self.replay.begin()

    def inherit(self, other: Learner) -> None:
        super().inherit(other)
        self.replay.begin()

    def update(self, arena: Arena, progress: float) -> dict[str, float]:
        share = annealed(progress, self.own.annealing)
        formation, flight, obstacle, action = self.final_weights
        self.weights = (formation, flight, share * obstacle, action)
        facts = super().update(Replaying(arena, self.replay), progress)
        return facts | {"learn/annealing": share, "learn/snapshots": float(len(self.replay.left))}

    def state_dict(self) -> dict[str, Any]:
        return super().state_dict() | {"replay": self.replay.state_dict()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        super().load_state_dict(state)
        self.replay.load_state_dict(state["replay"])
