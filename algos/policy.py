"""The decentralised policy: one network shared by all drones, from local observations to commands."""

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, Self

import torch
from torch import Tensor, nn

from algos import checkpoint
from algos.encoder import Encoder, EncoderSpec, build_encoder
from envs.formation import FormationEnv
from envs.spec import Observation, ObservationLayout, ObservationSpec, Scenarios, State

Act = Callable[[State, Scenarios], Tensor]
"""(state, scenarios) to commands (E, N, 4) in [-1, 1]."""


class Policy(nn.Module):
    """Diagonal Gaussian over u (..., 4); the command is tanh(u) in [-1, 1] as `envs.formation` reads it.

    As in the release, tanh belongs to the world: probabilities are those of u and carry no tanh correction. The spread
    of u does not depend on the state.
    """

    def __init__(
        self,
        encoder: EncoderSpec,
        layout: ObservationLayout,
        observation: ObservationSpec,
        drone: str,
        balls: int,
        log_std: float = 0.0,
        hover: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0),
        command: str = "ctbr",
    ) -> None:
        """`balls` is the capacity the encoder is built for, `hover` the command in [-1, 1] to start from."""
        super().__init__()
        self.encoder_spec, self.layout, self.observation, self.drone, self.balls = (
            encoder,
            layout,
            observation,
            drone,
            balls,
        )
        self.kind = command
        self.meta: dict[str, Any] = {}
        self.encoder = build_encoder(encoder, layout, balls)
        self.head = nn.Linear(self.encoder.features, 4)
        nn.init.xavier_uniform_(self.head.weight, gain=0.01)  # release: first commands are close to the bias
        with torch.no_grad():
            self.head.bias.copy_(torch.tensor(hover).atanh())
        self.log_std = nn.Parameter(torch.full((4,), float(log_std)))

    def forward(self, observation: Observation, gathered: Tensor | None = None) -> Tensor:
        """Mean of u (..., 4), one row per drone; calls between two changes of the policy may share `gathered()`."""
        return self.head(self.encoder(observation) if gathered is None else self.encoder(observation, gathered))

    def gathered(self) -> Tensor | None:
        """The encoder's parameters as its C++ operator reads them, None where that is not used."""
        return self.encoder.gathered() if isinstance(self.encoder, Encoder) and self.encoder.op else None

    @torch.no_grad()
    def command(self, observation: Observation) -> Tensor:
        """The deterministic command (..., 4): tanh of the mean."""
        dtype = self.head.weight.dtype
        given = {name: x if x.dtype == torch.bool else x.to(dtype) for name, x in observation.items()}
        return self(given).tanh()

    def agent(self, env: FormationEnv) -> Act:
        """The policy as `act(state, scenarios) -> (E, N, 4)`, deterministic, for any number of obstacles.

        Raises ValueError when the environment observes something else than the policy was trained on.
        """
        self.check(env)
        command = self.command if self.gathered() is not None else env.compiler(self.command)

        def act(state: State, scenarios: Scenarios) -> Tensor:
            return command(env.observe(state, scenarios)).to(state.position.dtype)

        return act

    def check(self, env: FormationEnv) -> None:
        """Raise ValueError unless `env` observes what the policy was trained on and takes its kind of command.

        Another number of drones is the encoder's to refuse.
        """
        if self.kind not in env.commands:
            raise ValueError(f"the policy commands {self.kind}, drone={env.world.drone.name} takes {env.commands[0]}")
        ours, theirs = asdict(self.observation), asdict(env.world.observation)
        if differing := [key for key in ours if key != "name" and ours[key] != theirs[key]]:
            key = differing[0]
            own = [f"observation.{key}={ours[key]}" for key in differing] if ours["name"] == theirs["name"] else []
            raise ValueError(
                f"the policy was trained with observation={ours['name']} ({key}={ours[key]}) and cannot fly "
                f"observation={theirs['name']} ({key}={theirs[key]}): "
                + " ".join((f"use observation={ours['name']}", *own))
            )

    def save(self, path: str | Path, meta: dict[str, Any] | None = None) -> None:
        """Write weights and everything needed to fly them; `meta` holds plain facts about the training.

        What a method with an observation of its own has learnt is flown by the agent of that name, not by `load`.
        """
        content = {
            "encoder": asdict(self.encoder_spec),
            "layout": asdict(self.layout),
            "observation": asdict(self.observation),
            "drone": self.drone,
            "balls": self.balls,
            "command": self.kind,
            "agent": "" if isinstance(self.observation, ObservationSpec) else self.observation.name,
            "meta": self.meta if meta is None else meta,
            "weights": self.state_dict(),
        }
        checkpoint.save(path, content, kind="policy")

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """A policy written by `save`; its training facts are in `.meta`. Raises CheckpointError."""
        content = checkpoint.load(path, kind="policy")
        try:
            policy = cls(
                EncoderSpec(**content["encoder"]),
                ObservationLayout(**content["layout"]),
                ObservationSpec(**content["observation"]),
                content["drone"],
                content["balls"],
                command=content.get("command", "ctbr"),  # files of before there were others do not say
            )
            policy.load_state_dict(content["weights"])
        except (KeyError, TypeError, RuntimeError) as error:
            raise checkpoint.CheckpointError(
                f"{path} holds a policy of another version of formctl ({' '.join(str(error).split())[:120]})"
            ) from error
        policy.meta = content["meta"]
        return policy.eval()
