"""From the command line's overrides to frozen settings: ``conf/`` composed by Hydra, checked against the dataclasses."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, is_dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from hydra import compose as hydra_compose
from hydra import initialize_config_dir
from hydra.errors import HydraException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from pydantic import ConfigDict, TypeAdapter, ValidationError

from formctl import overrides as typed
from formctl.errors import ConfigError
from formctl.overrides import expand_sweep
from formctl.places import conf_dir
from formctl.spec import EngineSpec, LoggerSpec, SearchSpec, TrainSpec

if TYPE_CHECKING:
    from envs.spec import DroneSpec, ObservationSpec, ScenarioSpec

__all__ = ["Config", "ConfigError", "Weights", "compose", "conf_dir", "expand_sweep"]

Weights = tuple[float, float, float, float]
"""Formation, flight, obstacle, action."""

SPECS = {
    "scenario": "envs.spec.ScenarioSpec",
    "drone": "envs.spec.DroneSpec",
    "observation": "envs.spec.ObservationSpec",
    "reward": "envs.reward.RewardSpec",
    "weights": "formctl.spec.WeightsSpec",
    "encoder": "algos.encoder.EncoderSpec",
    "algo": "algos.mappo.MappoSpec",
    "curriculum": "algos.curriculum.CurriculumSpec",
    "eval": "envs.metrics.EvalSpec",
    "search": "formctl.spec.SearchSpec",
    "train": "formctl.spec.TrainSpec",
    "engine": "formctl.spec.EngineSpec",
    "logger": "formctl.spec.LoggerSpec",
    "baseline": "builtins.dict",
}
"""The dataclass of each group; a ``target`` key in the group's YAML names another."""


@dataclass(frozen=True)
class Config:
    """Everything a run is made from; one attribute per group of ``conf/`` and per key of ``conf/config.yaml``."""

    name: str  # label of the run
    seed: int
    sim: Literal["torch", "mujoco"]
    runs: Path  # the output store
    profile: str
    experiment: str
    scenario: "ScenarioSpec"
    drone: "DroneSpec"
    observation: "ObservationSpec"
    reward: Any
    weights: Weights
    encoder: Any
    algo: Any
    curriculum: Any
    eval: Any
    search: SearchSpec
    train: TrainSpec
    engine: EngineSpec
    logger: LoggerSpec
    baseline: dict[str, Any] | None
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
    specs = {group: _validate(group, tree.get(group)) for group in SPECS}
    top = {key: value for key, value in tree.items() if key not in SPECS}
    head = _validate_as(_Head, "", top)
    weights = specs.pop("weights")
    config = Config(
        **{**asdict(head), "runs": Path(head.runs)},
        **specs,
        weights=weights.vector,
        tree=_tree(top, {**specs, "weights": weights}, tree),
    )
    _check(config)
    return config


@dataclass(frozen=True)
class _Head:
    """The keys of ``conf/config.yaml`` itself."""

    name: str
    seed: int
    sim: Literal["torch", "mujoco"]
    runs: str
    profile: str
    experiment: str


def _split_reference(overrides: Sequence[str]) -> tuple[list[str], str | None]:
    """Take ``weights=@REFERENCE`` out: a path and ``trial=17`` are no values in Hydra's grammar."""
    prefix = "weights=@"
    references = [text.removeprefix(prefix) for text in overrides if text.startswith(prefix)]
    return [text for text in overrides if not text.startswith(prefix)], references[-1] if references else None


def _compose_tree(overrides: list[str]) -> dict[str, Any]:
    parsed = typed.parse(overrides)
    typed.check(parsed)
    for override in parsed:
        if override.key_or_group.split(".")[0] == "hydra":
            raise ConfigError(f"unknown key {override.key_or_group!r}; formctl conf keys lists them all")
    try:
        return _hydra(overrides)
    except (HydraException, OmegaConfBaseException) as error:
        groups = [override for override in parsed if typed.choices(override.key_or_group)]
        known = _hydra([override.input_line for override in groups if override.input_line])
        for override in parsed:
            if override not in groups and (complaint := typed.unknown_key(override.key_or_group, known)):
                raise complaint from None
        raise ConfigError(" ".join(str(error).split())) from error


def chosen(overrides: Sequence[str] = ()) -> dict[str, str]:
    """The file that each part of the composed settings comes from: ``{"scenario": "mixed", "scenario@search.scenario":
    "stage1", ...}``, the package behind ``@`` where it is not the group's own name."""
    plain, _ = _split_reference(overrides)
    with initialize_config_dir(config_dir=str(conf_dir()), version_base="1.3"):
        choices = hydra_compose("config", plain, return_hydra_config=True).hydra.runtime.choices
    return {str(group): str(choice) for group, choice in choices.items() if not str(group).startswith("hydra/")}


def _hydra(overrides: list[str]) -> dict[str, Any]:
    with initialize_config_dir(config_dir=str(conf_dir()), version_base="1.3"):
        composed = hydra_compose("config", overrides)
        tree = OmegaConf.to_container(composed, resolve=True)
    assert isinstance(tree, dict)
    return {str(key): value for key, value in tree.items()}


def _validate(group: str, values: Any) -> Any:
    if values is None:
        return None
    if not isinstance(values, dict):
        raise ConfigError(f"{group}={values!r} is no group of settings; the choices are {typed.choices(group)}")
    dotted = values.get("target", SPECS[group])
    spec = _load(dotted)
    if not is_dataclass(spec):
        return values
    fields = spec.__dataclass_fields__
    return _validate_as(spec, group, {key: value for key, value in values.items() if key != "target" or key in fields})


@cache
def _adapter(spec: Any) -> TypeAdapter[tuple[Any]]:
    """A strict reader of one dataclass; the one-tuple lets it carry a configuration that nested ones inherit."""
    return TypeAdapter(tuple[spec], config=ConfigDict(extra="forbid"))


def _validate_as(spec: Any, group: str, values: dict[str, Any]) -> Any:
    try:
        return _adapter(spec).validate_python((values,))[0]
    except ValidationError as error:
        raise _explain(group, error) from error


def _explain(group: str, error: ValidationError) -> ConfigError:
    first = error.errors(include_url=False)[0]
    path = [str(part) for part in first["loc"][1:] if not (isinstance(part, str) and ("[" in part or part == "str"))]
    key = ".".join(([group] if group else []) + path)
    if first["type"] == "missing":
        return ConfigError(f"{key} is missing: give it in conf/{group}/ or as {key}=VALUE")
    if first["type"] == "unexpected_keyword_argument":
        return ConfigError(f"unknown key {key!r}; formctl conf keys lists them all")
    message = first["msg"].replace("Input should", "it should")
    return ConfigError(f"{key}={first['input']!r} cannot be used: {message}")


def _load(dotted: str) -> Any:
    module, _, name = dotted.rpartition(".")
    try:
        return getattr(import_module(module), name)
    except (ImportError, AttributeError):
        return dict


def _tree(top: dict[str, Any], specs: dict[str, Any], tree: dict[str, Any]) -> dict[str, Any]:
    """The validated values as plain data, so that what is saved is what was used (1e6 steps become 1000000)."""
    plain = dict(top)
    for group, spec in specs.items():
        values = _adapter(type(spec)).dump_python((spec,), mode="json")[0] if is_dataclass(spec) else spec
        target = (tree.get(group) or {}).get("target")
        plain[group] = values if target is None or values is None else {"target": target, **values}
    return plain


def _check(config: Config) -> None:
    """What no single field can tell: weights on the simplex, columns that fit their grid."""
    if abs(sum(config.weights) - 1) > 1e-6:
        raise ConfigError(f"weights {config.weights} sum to {sum(config.weights):g}: they have to sum to 1")
    for key, scenario in (("scenario", config.scenario), ("search.scenario", config.search.scenario)):
        cells = grid_cells(scenario)
        if scenario.columns > cells:
            raise ConfigError(f"{key}.columns={scenario.columns}: the {scenario.column_layout} grid has {cells} cells")


def grid_cells(scenario: "ScenarioSpec") -> int:
    """Number of places a column can stand in."""
    if scenario.column_layout == "fixed4":
        return 4
    first, last = scenario.field
    return round((last - first) / scenario.column_cell) * round(2 * scenario.column_half_width / scenario.column_cell)
