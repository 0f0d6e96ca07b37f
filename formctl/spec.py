"""Settings of the pipeline itself, one frozen dataclass per group in ``conf/``; values stand in the YAML."""

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le

from envs.spec import ScenarioSpec

Count = Annotated[int, Ge(1)]
Share = Annotated[float, Ge(0), Le(1)]


@dataclass(frozen=True)
class WeightsSpec:
    """A point of the reward-weight simplex (``conf/weights/``; paper, Sec. IV-B)."""

    name: str
    formation: Share
    flight: Share
    obstacle: Share
    action: Share

    @property
    def vector(self) -> tuple[float, float, float, float]:
        """The weights in the order of every reward vector: formation, flight, obstacle, action."""
        return (self.formation, self.flight, self.obstacle, self.action)


@dataclass(frozen=True)
class TrainSpec:
    """What one stage-2 training may spend and how often it saves (``conf/train/``)."""

    name: str
    steps: Count  # environment steps, all periods together
    compile: bool  # torch.compile the world and the learner
    checkpoint_minutes: Annotated[float, Gt(0)]
    log_updates: Count  # updates between two lines of metrics.jsonl
    judge_steps: Count  # environment steps between two judgements of the policy; the end is judged too
    judge_episodes: Count  # episodes of the configured scenario that each judgement flies


@dataclass(frozen=True)
class SearchSpec:
    """Stage 1: the search over reward weights (``conf/search/``; paper, Sec. IV-B1)."""

    name: str
    scenario: ScenarioSpec  # the simplified task that every trial trains and is judged on
    sampler: Literal["dirichlet", "release"]
    trials: Count  # total of the study, not "more"
    steps: Count  # environment steps per trial
    episodes: Count  # evaluation episodes per trial


@dataclass(frozen=True)
class EngineSpec:
    """Where trials and stages run (``conf/engine/``)."""

    name: str
    threads: Count  # torch threads per process


@dataclass(frozen=True)
class LoggerSpec:
    """Trackers beside the metrics file that is always written (``conf/logger/``)."""

    name: str
    tensorboard: bool
