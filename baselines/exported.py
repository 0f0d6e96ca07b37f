"""Policies of any library, as exported programs: trained elsewhere, flown and evaluated here.

``save`` writes a network with ``torch.export``; the file holds the program, its weights and what it observes, but none
of the code that trained it. ``formctl eval --policy FILE.pt2`` flies it.
"""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from baselines.protocol import Capabilities
from envs import observation
from envs.formation import FormationEnv
from envs.interfaces.stream import flatten
from envs.scenarios import sample
from envs.spec import Observation, ObservationSpec, Scenarios, State

FORMAT = "formctl-exported-1"
ENTRY = "formctl.json"
"""The file's own entry for what is not in the program."""


@dataclass(frozen=True)
class ExportedSpec:
    """Settings of :class:`ExportedPolicy`."""

    policy: str  # file written by ``save``


class ExportedPolicy:
    """An exported network: the vector of every drone (``envs.interfaces.stream``) in, commands out, no memory."""

    capabilities = Capabilities(command="ctbr", batched=True, needs_ball_parameters=False, max_drones=None)

    def __init__(self, name: str, env: FormationEnv, spec: ExportedSpec) -> None:
        """Raises ValueError, one line, for a file that is none and for a world that the network was not made for."""
        self.name, self.env = name, env
        program, head = load(spec.policy)
        self.network = program.module()
        self.sensor = observation.sensor(ObservationSpec(**head["observation"]))
        self.balls = int(head["balls"])
        if env.drones != head["drones"]:
            raise ValueError(f"{spec.policy} flies {head['drones']} drones, the formation has {env.drones}")
        if env.world.scenario.balls > self.balls:
            raise ValueError(
                f"{spec.policy} was made for {self.balls} balls at most, the scene has {env.world.scenario.balls}"
            )

    def reset(self, scenarios: Scenarios, state: State) -> None:
        """Nothing to prepare: the policy has no memory."""

    @torch.no_grad()
    def act(self, state: State, scenarios: Scenarios) -> Tensor:
        """Commands (E, N, 4) in [-1, 1]."""
        time, world = self.env.time(state), self.env.world.scenario
        seen = self.sensor.observe(state, scenarios, time, world, self.env.slots)
        told = self.network(flatten(_with_balls(seen, self.balls)).float())
        return told.clamp(-1, 1).to(state.position.dtype)


def save(path: str | Path, network: nn.Module, env: FormationEnv, meta: dict[str, Any] | None = None) -> None:
    """Write ``network``, which maps vectors (B, N, d) float32 to commands (B, N, 4) in [-1, 1] for any B, to ``path``.

    ``env`` is the world that it was trained in; ``meta`` holds plain facts: ``name``, ``algo``, ``steps``, ``seed``
    appear in reports. Raises ValueError for a name that does not end in .pt2 and for commands of another shape.
    """
    path = Path(path)
    if path.suffix != ".pt2":
        raise ValueError(f"{path} has to end in .pt2, torch.export's own ending")
    if env.commands != ("ctbr",):
        raise ValueError(f"exported policies command ctbr, this world takes {env.commands[0]}")
    scenarios = sample(env.world.scenario, 2, 0, torch.float32)
    seen = flatten(env.observe(FormationEnv(env.world).reset(scenarios), scenarios)).contiguous()
    network = network.eval().cpu()
    with torch.no_grad():
        told = network(seen)
    if told.shape != (2, env.drones, 4):
        raise ValueError(f"the network gives {tuple(told.shape)} for {tuple(seen.shape)}, not (2, {env.drones}, 4)")
    program = torch.export.export(network, (seen,), dynamic_shapes=({0: torch.export.Dim("episodes")},))
    head = {
        "format": FORMAT,
        "observation": asdict(env.world.observation),
        "drones": env.drones,
        "balls": env.world.scenario.balls,
        "drone": env.world.drone.name,
        "scenario": env.world.scenario.name,
        "meta": meta or {},
    }
    torch.export.save(program, path, extra_files={ENTRY: json.dumps(head)})


def load(path: str | Path) -> tuple[torch.export.ExportedProgram, dict[str, Any]]:
    """The program of a file written by ``save``, and what else the file says. Raises ValueError, one line."""
    extra = {ENTRY: ""}
    if not Path(path).is_file():
        raise ValueError(f"there is no policy {path}")
    try:
        program = torch.export.load(path, extra_files=extra)
        head = json.loads(extra[ENTRY])
    except Exception as error:  # torch raises a dozen types for damaged archives
        raise ValueError(
            f"{path} is damaged, of another torch, or was not written by baselines.exported.save"
            f" ({type(error).__name__})"
        ) from error
    if head.get("format") != FORMAT:
        raise ValueError(f"{path} is of format {head.get('format')!r}, this version reads {FORMAT!r}")
    return program, head


def _with_balls(seen: Observation, balls: int) -> Observation:
    """The observation with room for ``balls``: absent ones are masked."""
    dynamic, mask = seen["dynamic"], seen["dynamic_mask"]
    episodes, drones, present, width = dynamic.shape
    missing = balls - present
    if missing <= 0:
        return seen
    more = dynamic.new_zeros(episodes, drones, missing, width)
    none = mask.new_zeros(episodes, drones, missing)
    return seen | {"dynamic": torch.cat((dynamic, more), 2), "dynamic_mask": torch.cat((mask, none), 2)}
