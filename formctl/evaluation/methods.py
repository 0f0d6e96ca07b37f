"""Who is flown: trained policies and baselines behind one protocol, each with the facts that its results carry."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from torch import Tensor

from algos import checkpoint
from algos.policy import Policy
from baselines import exported as programs
from baselines import registry
from baselines.protocol import Agent, Capabilities
from envs.formation import FormationEnv, WorldSpec
from envs.spec import Scenarios, State
from formctl import store
from formctl.errors import ConfigError
from formctl.settings import Config, build, choices, compose, restore
from formctl.settings import overrides as typed
from formctl.store import manifest
from formctl.store.files import StoreError


@dataclass(frozen=True)
class Method:
    """Something that can be flown. ``facts`` is what ``run.json`` says under ``method``."""

    facts: dict[str, Any]
    profile: str  # profile it was trained under; the evaluation's own for baselines
    parents: tuple[str, ...]  # ids of the runs it comes from
    make: Callable[[FormationEnv], Agent]
    settings: dict[str, Any] | None = None  # of a baseline, as composed
    trained: Policy | None = None  # the network behind it, where there is one
    capabilities: Capabilities | None = None  # of a baseline

    @property
    def name(self) -> str:
        return str(self.facts["name"])

    def fit(self, world: WorldSpec) -> WorldSpec:
        """The world as the method flies it: observed as its network was trained to, told rotor thrusts where the method
        commands those."""
        if self.trained is not None:
            return replace(world, observation=self.trained.observation)
        return self.capabilities.fit(world) if self.capabilities else world

    def settings_of(self, config: Config) -> Config:
        """``config`` with the observation that the method flies with."""
        own = None if self.trained is None else asdict(self.trained.observation)
        return config if own in (None, config.tree["observation"]) else restore(config.tree | {"observation": own})

    def policy(self) -> Policy:
        """The network. Raises ValueError for a method that is none."""
        if self.trained is None:
            raise ValueError(f"{self.name} is no trained policy")
        return self.trained


class PolicyAgent:
    """A trained policy as an agent: deterministic, without memory."""

    capabilities = Capabilities(command="ctbr", batched=True, needs_ball_parameters=False, max_drones=None)

    def __init__(self, name: str, policy: Policy, env: FormationEnv) -> None:
        self.name, self._act = name, policy.agent(env)

    def reset(self, scenarios: Scenarios, state: State) -> None:
        """Nothing to prepare."""

    def act(self, state: State, scenarios: Scenarios) -> Tensor:
        """Command (E, N, 4) in [-1, 1]."""
        return self._act(state, scenarios)


def facts(config: Config, run: str, **changed: Any) -> dict[str, Any]:
    """The ``method`` of a policy trained with ``config`` in the run of id ``run``."""
    return {
        "name": config.name,
        "kind": "policy",
        "algo": learners(config),
        "encoder": config.encoder.name,
        "curriculum": config.curriculum.name,
        "weights": list(config.weights),
        "experiment": config.experiment,
        "steps": config.train.steps,
        "seed": config.seed,
        "run": run,
    } | changed


def policy(text: str, root: Path) -> Method:
    """The policy that RUN, FILE or NAME means, a shipped one where no run is called so; FILE.pt2 is an exported one.

    Raises ValueError: no such thing, or a damaged file.
    """
    path = policy_file(text, root)
    if path.suffix == ".pt2":
        return exported(path)
    content = checkpoint.load(path, kind="policy")
    meta = content["meta"]
    known: Mapping[str, Any] = meta.get("method", {})
    blank: dict[str, Any] = {"name": path.stem, "kind": "policy", "algo": "", "curriculum": ""}
    blank |= {"encoder": content["encoder"]["name"], "weights": [], "steps": meta.get("steps"), "seed": 0, "run": ""}
    record = blank | dict(known)
    parents = (record["run"],) if record["run"] else ()
    profile = str(meta.get("profile", ""))
    if agent := content.get("agent"):  # a baseline's own network
        flown = baseline(agent, [f"baseline.policy={path}"])
        return replace(flown, facts=record, profile=profile, parents=parents)
    loaded = Policy.load(path)
    return Method(record, profile, parents, partial(PolicyAgent, record["name"], loaded), trained=loaded)


def in_memory(name: str, seed: int, policy: Policy) -> Method:
    """A policy that no file holds: one that is being trained."""
    facts = {"name": name, "seed": seed, "run": ""}
    return Method(facts, "", (), partial(PolicyAgent, name, policy), trained=policy)


def check_observation(config: Config, flown: Sequence[Method], words: Sequence[str]) -> None:
    """Raise ValueError where the overrides ``words`` ask for another observation than a policy was trained with."""
    if any(word.startswith("observation") for word in words):
        env = FormationEnv(build.world(config))
        for method in flown:
            if method.trained is not None:
                method.trained.check(env)


def shipped() -> dict[str, Path]:
    """The trained policies that come with the package, by name."""
    return {path.stem: path for path in sorted((Path(__file__).parents[1] / "policies").glob("*.pt"))}


def policy_file(text: str, root: Path) -> Path:
    path = Path(text).expanduser()
    if path.is_file() or path.suffix == ".pt2":
        return path
    try:
        path = store.resolve(text, root, holding="policy.pt").path / "policy.pt"
    except StoreError as error:
        if text in shipped():
            return shipped()[text]
        raise StoreError(f"{error}; shipped with formctl: {', '.join(shipped()) or 'none'}") from None
    if not path.is_file():
        raise StoreError(f"{path.parent} has no policy.pt yet: its training has not got that far")
    return path


def baseline(name: str, overrides: Sequence[str] = ()) -> Method:
    """The baseline ``conf/baseline/<name>.yaml``, or the class that ``FILE.py:CLASS`` names, raising ConfigError.

    ``overrides`` are ``baseline.KEY=VALUE``.
    """
    if ".py:" in name:
        return from_source(name, overrides)
    known = choices("baseline")
    if name not in known:
        raise ConfigError(
            f"there is no baseline {name!r}; the choices are {', '.join(known)}, or FILE.py:CLASS for one of your own"
        )
    settings = compose([f"baseline={name}", *overrides]).tree["baseline"]
    record: dict[str, Any] = {"name": name, "kind": "baseline", "algo": "", "encoder": "", "curriculum": ""}
    record |= {"weights": [], "steps": 0, "seed": 0, "run": ""} | registry.training(name, located(settings))
    record |= {key: settings[key] for key in ("label", "role") if key in settings}
    if settings.get("deviations"):
        record["deviations"] = settings["deviations"]
    return _baseline(record, settings)


def from_source(target: str, overrides: Sequence[str] = ()) -> Method:
    """The agent that ``FILE.py:CLASS`` names; its name is the file's, ``overrides`` are ``baseline.KEY=VALUE``.

    What is recorded with its flights: the file's place and digest. Raises ValueError, one line.
    """
    file, _, kind = target.rpartition(":")
    path = Path(file).expanduser().resolve()
    settings: dict[str, Any] = {"target": f"{path}:{kind}"}
    settings |= {word.key_or_group.removeprefix("baseline."): word.value() for word in typed.parse(overrides)}
    record = {"name": path.stem, "kind": "baseline", "algo": "", "encoder": "", "curriculum": "", "weights": []}
    known = _baseline(record | {"steps": 0, "seed": 0, "run": "", "source": str(path)}, settings)
    known.facts["sha256"] = manifest.digest(path)
    return known


def exported(path: Path) -> Method:
    """The policy of any library that ``baselines.exported.save`` wrote. Raises ValueError, one line."""
    meta = programs.load(path)[1]["meta"]
    record: dict[str, Any] = {"name": path.stem, "kind": "baseline", "algo": "", "encoder": "", "curriculum": ""}
    record |= {"weights": [], "steps": 0, "seed": 0, "run": "", **meta, "sha256": manifest.digest(path)}
    settings = {"target": "baselines.exported.ExportedPolicy", "policy": str(path.resolve())}
    return _baseline(record, settings)


def _baseline(record: dict[str, Any], settings: dict[str, Any]) -> Method:
    name = str(record["name"])
    known = registry.capabilities(name, settings)
    return Method(record, "", (), partial(_made, name, settings), settings, capabilities=known)


def located(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings of a baseline with the file of the shipped policy that they name, where they name one."""
    named = shipped().get(str(settings.get("policy")))
    return dict(settings) if named is None else {**settings, "policy": str(named)}


def _made(name: str, settings: Mapping[str, Any], env: FormationEnv) -> Agent:
    """The baseline for a world; with its settings bound, worker processes can be sent it."""
    return registry.make(name, env, located(settings))


def stored_baseline(record: Mapping[str, Any], settings: dict[str, Any]) -> Method:
    """The baseline that an evaluation flew, with the settings of then: ``method`` and ``baseline`` of its run."""
    return _baseline(dict(record), settings)


def learners(config: Config) -> str:
    """The learner, or those that the curriculum hands the policy through: ``shac+mappo``."""
    trees = [period.get("algo", config.tree["algo"]) for period in config.tree["curriculum"]["periods"]]
    return "+".join(dict.fromkeys(_learner(tree) for tree in trees))


def _learner(tree: Mapping[str, Any]) -> str:
    """``mappo`` of ``algos.mappo.MappoSpec``: a learner is named by its class, its settings stand in config.yaml."""
    return str(tree.get("target", "")).rpartition(".")[2].removesuffix("Spec").lower()
