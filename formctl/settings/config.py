"""From overrides on the command line to frozen settings: ``conf/`` composed by Hydra, checked by the dataclasses."""

from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from annotated_types import Ge
from hydra import compose as hydra_compose
from hydra import initialize_config_dir
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from envs.vocabulary import Weights
from formctl.engines.cluster import RaySpec
from formctl.engines.workers import LocalSpec
from formctl.errors import ConfigError
from formctl.settings import faults, formations, periods, validation
from formctl.settings import overrides as typed
from formctl.settings.paths import conf_dir
from formctl.settings.schema import LoggerSpec, SearchSpec, SurveySpec, TrainSpec

if TYPE_CHECKING:
    from algos.curriculum import CurriculumSpec
    from algos.encoder import EncoderSpec
    from algos.learner import LearnerSpec
    from envs.deployment import DeploySpec
    from envs.metrics import EvalSpec
    from envs.reward import Reward
    from envs.spec import DroneSpec, ObservationSpec, ScenarioSpec

SPECS = {
    "scenario": "envs.spec.ScenarioSpec",
    "drone": "envs.spec.DroneSpec",
    "observation": "envs.spec.ObservationSpec",
    "reward": None,
    "weights": "formctl.settings.schema.WeightsSpec",
    "encoder": "algos.encoder.EncoderSpec",
    "algo": None,
    "curriculum": "algos.curriculum.CurriculumSpec",
    "eval": "envs.metrics.EvalSpec",
    "deploy": "envs.deployment.DeploySpec",
    "search": "formctl.settings.schema.SearchSpec",
    "train": "formctl.settings.schema.TrainSpec",
    "survey": "formctl.settings.schema.SurveySpec",
    "engine": None,
    "logger": "formctl.settings.schema.LoggerSpec",
}
"""The dataclass of each group; None where ``target`` in the chosen file names it."""


@dataclass(frozen=True)
class Config:
    """Everything a run is made from; one attribute per group of ``conf/`` and per key of ``conf/config.yaml``."""

    name: str  # label of the run
    seed: int
    sim: Literal["torch", "mujoco"]
    runs: Path  # the output store
    profile: str
    experiment: str
    start: str  # the policy that a training goes on from; "": chance
    scenario: "ScenarioSpec"
    drone: "DroneSpec"
    observation: "ObservationSpec"
    reward: "Reward"
    weights: Weights
    encoder: "EncoderSpec"
    algo: "LearnerSpec"
    curriculum: "CurriculumSpec"
    eval: "EvalSpec"
    deploy: "DeploySpec | None"  # disturbances of a flight over motion capture and radio; None: the undisturbed world
    search: SearchSpec
    train: TrainSpec
    survey: "SurveySpec | None"  # the flights of a report; None: reproduce searches and trains
    engine: LocalSpec | RaySpec
    logger: LoggerSpec
    baseline: dict[str, Any] | None  # settings of the agent that eval flies; checked when it is made
    tree: dict[str, Any]  # the same as plain values: what config.yaml of a run folder holds


def compose(overrides: Sequence[str] = (), resolve_weights: Callable[[str], Weights] | None = None) -> Config:
    """Compose ``conf/`` with the overrides typed by the user.

    ``weights=@REFERENCE`` is handed to ``resolve_weights`` without the ``@``; its answer becomes ``weights.name`` and
    the four weights. Raises ConfigError, one line, for anything that cannot be used.
    """
    plain, reference = _split_reference(overrides)
    tree = _compose_tree(plain)
    if reference is not None:
        if resolve_weights is None:
            raise ConfigError(f"weights=@{reference} cannot be used here: give weights=NAME or the four weights.KEY=")
        names = ("formation", "flight", "obstacle", "action")
        tree["weights"] = {"name": f"@{reference}", **dict(zip(names, resolve_weights(reference), strict=True))}
    return restore(tree)


def restore(tree: dict[str, Any]) -> Config:
    """The Config of a composed tree: what config.yaml of a run folder holds. Raises ConfigError."""
    left_out = {group for group in typed.OPTIONAL if tree.get(group) is None}
    groups = {group: dotted for group, dotted in SPECS.items() if group not in left_out}
    specs = {group: validation.read(group, _group(group, tree), dotted) for group, dotted in groups.items()}
    specs["curriculum"] = periods.read(specs["curriculum"])
    head = validation.read_as(_Head, "", {key: tree[key] for key in _HEAD if key in tree})
    agent = None if "baseline" in left_out else _group("baseline", tree)
    weights = specs["weights"].vector
    plain = {**asdict(head), **{group: _plain(group, spec, tree) for group, spec in specs.items()}, "baseline": agent}
    for group in ("deploy", "survey"):
        plain.setdefault(group, None)
    if unknown := [key for key in tree if key not in plain]:
        raise ConfigError(f"unknown key {unknown[0]!r}; formctl conf keys lists them all")
    validation.check_name(head.name)
    validation.check_weights(weights)
    validation.check_scenario("scenario", specs["scenario"])
    validation.check_scenario("search.scenario", specs["search"].scenario)
    validation.check_curriculum(specs["curriculum"], specs["scenario"])
    top = {**asdict(head), "runs": Path(head.runs).expanduser()}
    return Config(**top, **{"deploy": None, "survey": None, **specs, "weights": weights}, baseline=agent, tree=plain)


@dataclass(frozen=True)
class _Head:
    """The keys of ``conf/config.yaml`` itself."""

    name: str
    seed: Annotated[int, Ge(0)]
    sim: Literal["torch", "mujoco"]
    runs: str
    profile: str
    experiment: str
    start: str = ""  # settings of before it existed do not say


_HEAD = tuple(_Head.__dataclass_fields__)


def _group(group: str, tree: dict[str, Any]) -> dict[str, Any]:
    values = tree.get(group)
    if not isinstance(values, dict):
        raise ConfigError(f"{group} has to be one of {', '.join(typed.choices(group))}")
    return values


def _plain(group: str, spec: Any, tree: dict[str, Any]) -> dict[str, Any]:
    """The validated values, so that what is saved is what was used (1e6 steps become 1000000)."""
    target = tree[group].get("target")
    values = validation.plain(spec)
    return {
        **({} if target is None else {"target": target}),
        **(periods.plain(values) if "periods" in values else values),
    }


def _split_reference(overrides: Sequence[str]) -> tuple[list[str], str | None]:
    """Take ``weights=@REFERENCE`` out: a path and ``trial=17`` are no values in Hydra's grammar."""
    prefix = "weights=@"
    references = [text.removeprefix(prefix) for text in overrides if text.startswith(prefix)]
    return [text for text in overrides if not text.startswith(prefix)], references[-1] if references else None


def _compose_tree(overrides: list[str]) -> dict[str, Any]:
    overrides = [typed.quoted(text) for text in overrides]
    parsed = typed.parse(overrides)
    typed.check(parsed)
    for override in parsed:
        if override.key_or_group.split(".")[0] == "hydra":
            raise ConfigError(f"unknown key {override.key_or_group!r}; formctl conf keys lists them all")
    try:
        tree = _budgeted(overrides)
    except (HydraException, OmegaConfBaseException) as error:
        groups = [override for override in parsed if typed.choices(override.key_or_group)]
        known = _values([override.input_line for override in groups if override.input_line])
        for override in parsed:
            if override not in groups and (complaint := typed.unknown_key(override.key_or_group, known)):
                raise complaint from None
        raise ConfigError(" ".join(str(error).split())) from error
    except (YAMLError, UnicodeDecodeError) as error:
        raise faults.explain(error) from error
    periods.resolve(tree, _budgeted)
    formations.resolve(tree)
    return tree


def _budgeted(overrides: list[str]) -> dict[str, Any]:
    """The composed tree; a profile's budget for a setting that the chosen learner does not have is left out."""
    tree = _values(overrides)
    path = conf_dir() / "profile" / f"{tree.get('profile')}.yaml"
    algo = tree.get("algo")
    if isinstance(algo, dict) and path.exists():
        budget = OmegaConf.to_container(OmegaConf.load(path))
        known = validation.keys("algo", algo.get("target"))
        for key in budget.get("algo", {}) if isinstance(budget, dict) else ():
            if key not in known and not any(text.startswith(f"algo.{key}=") for text in overrides):
                algo.pop(key, None)
    return tree


def chosen(overrides: Sequence[str] = ()) -> dict[str, str]:
    """The file behind each part of the composed settings: e.g. scenario@search.scenario: stage1.

    A part's place stands behind ``@`` where it is not the group's own name.
    """
    plain, _ = _split_reference(overrides)
    choices = _hydra(plain, return_hydra_config=True).hydra.runtime.choices
    return {str(group): str(choice) for group, choice in choices.items() if not str(group).startswith("hydra/")}


def _values(overrides: list[str]) -> dict[str, Any]:
    return deepcopy(_composed(str(conf_dir()), tuple(overrides)))


@lru_cache(maxsize=256)
def _composed(directory: str, overrides: tuple[str, ...]) -> dict[str, Any]:
    """What Hydra makes of the files in ``directory``: a third of a second, and one call asks for the same again."""
    tree = OmegaConf.to_container(_hydra(list(overrides)), resolve=True)
    assert isinstance(tree, dict)
    return {str(key): value for key, value in tree.items()}


def _hydra(overrides: list[str], **settings: bool) -> DictConfig:
    with initialize_config_dir(config_dir=str(conf_dir()), version_base="1.3"):
        return hydra_compose("config", overrides, **settings)
