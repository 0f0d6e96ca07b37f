"""Settings of the pipeline itself, one frozen dataclass per group in ``conf/``; values stand in the YAML."""

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le

from envs.spec import ScenarioSpec
from envs.vocabulary import Weights
from formctl.engines.engine import Count

Share = Annotated[float, Ge(0), Le(1)]


@dataclass(frozen=True)
class WeightsSpec:
    """A point of the reward-weight simplex (``conf/weights/``; paper, Sec. V-B)."""

    name: str
    formation: Share
    flight: Share
    obstacle: Share
    action: Share

    @property
    def vector(self) -> Weights:
        """The weights in the order of every reward vector: formation, flight, obstacle, action."""
        return (self.formation, self.flight, self.obstacle, self.action)


@dataclass(frozen=True)
class TrainSpec:
    """What one stage-2 training may spend and how often it saves (``conf/train/``)."""

    name: str
    steps: Count  # environment steps, all periods together
    processes: Count | Literal["auto"]  # that train together, each with a share of the environments
    compile: bool  # torch.compile the world and the learner
    checkpoint_minutes: Annotated[float, Gt(0)]
    log_updates: Count  # updates between two lines of metrics.jsonl
    judge_steps: Count  # environment steps between two judgements of the policy; the end is judged too
    judge_episodes: Count  # episodes of the configured scenario that each judgement flies


@dataclass(frozen=True)
class ConfirmSpec:
    """The best trials, trained again with other seeds and flown on fresh episodes."""

    trials: Annotated[int, Ge(0)]  # how many of the best; 0: none
    seeds: Count  # trainings of each
    budget: Count  # their steps, in units of a trial's


@dataclass(frozen=True)
class SearchSpec:
    """Stage 1: the search over reward weights (``conf/search/``; paper, Sec. V-B1)."""

    name: str
    scenario: ScenarioSpec  # the simplified task that every trial trains and is judged on
    sampler: Literal["dirichlet", "release", "sobol", "tpe", "cmaes", "nsga2"]
    trials: Count  # total of the study, not "more"
    steps: Count  # environment steps per trial
    episodes: Count  # evaluation episodes per trial
    fresh_episodes: Count  # episodes of the bank that no trial is chosen on
    confirm: ConfirmSpec
    pruner: Literal["none", "median", "hyperband"]
    pruner_episodes: Count  # episodes of each intermediate SR, where there is a pruner
    lease_minutes: Annotated[float, Gt(0)]  # without a sign of life, until a trial is handed to another worker


@dataclass(frozen=True)
class LoggerSpec:
    """Trackers beside the metrics file that is always written (``conf/logger/``)."""

    name: str
    tensorboard: bool
    tracker: Literal["", "wandb", "mlflow", "trackio"] = ""  # beside it; settings of before there were any do not say
    project: str = "formctl"  # its name for all of these runs
    online: bool = False  # whether anything may leave this machine


@dataclass(frozen=True)
class PartSpec:
    """Some scenes and who flies them."""

    words: tuple[str, ...]  # overrides, --record WHICH, --vary KEY=A,B; comma lists combined as with -m; []: left out
    episodes: dict[str, Count]  # of each group that takes part

    @property
    def overrides(self) -> list[str]:
        """The words that are settings."""
        return [word for word in self.words if not word.startswith("--")]

    def option(self, name: str) -> list[str]:
        """What follows ``--name`` among the words, each time it stands there."""
        return [word.removeprefix(f"--{name} ") for word in self.words if word.startswith(f"--{name} ")]

    @property
    def record(self) -> str | None:
        """The episodes to record."""
        return next(iter(self.option("record")), None)


@dataclass(frozen=True)
class SurveySpec:
    """Everything a report shows (``conf/survey/``)."""

    name: str
    trained_on: str  # scenario of the trainings whose policies are flown
    groups: dict[str, tuple[str, ...]]  # names of baselines
    parts: dict[str, PartSpec]
