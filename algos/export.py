"""A policy for other runtimes: measurements in, CTBR set-points out, as one ONNX graph.

Everything between a motion-capture frame and what is sent to a drone is inside the graph: the observation with its
scaling, the network, tanh and the limits of the command. Its inputs are plain measurements in SI units and the world
frame, so that nobody has to write the observation a second time. Numbers of episodes (the batch), columns and balls
stay free where the encoder allows it; the number of drones is the formation's.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from algos.policy import Policy
from envs import control, obstacles
from envs.formation import FormationEnv
from envs.scenarios import sample
from envs.spec import FAR, Scenarios, State

OPSET = 18
PACKAGES = ("onnx", "onnxscript", "onnxruntime")

Inputs = dict[str, Tensor]
"""Arguments of ``Pilot.forward`` by name."""


@dataclass(frozen=True)
class Field:
    """One input or output of the graph, as ``contract.json`` tells it."""

    name: str
    shape: tuple[str, ...]  # E episodes, N drones, C columns, M balls, or a number
    unit: str
    frame: str
    meaning: str


INPUTS = (
    Field("time", ("E",), "s", "", "since the start of the flight"),
    Field("position", ("E", "N", "3"), "m", "world", "drones in the order of the formation's slots"),
    Field("attitude", ("E", "N", "4"), "1", "body to world", "unit quaternions w, x, y, z"),
    Field("velocity", ("E", "N", "3"), "m/s", "world", "drones"),
    Field("rates", ("E", "N", "3"), "rad/s", "body", "drones, about x (forward), y (left), z (up)"),
    Field("columns", ("E", "C", "2"), "m", "world", f"axes x, y; {FAR:g} for an absent column; at least one entry"),
    Field("ball_position", ("E", "M", "3"), "m", "world", "centres; at least one entry"),
    Field("ball_velocity", ("E", "M", "3"), "m/s", "world", "balls"),
    Field("ball_flying", ("E", "M"), "bool", "", "true while a ball is in the air; the others are not looked at"),
)
THROTTLE = Field("throttle", ("E", "N", "4"), "1", "", "rotor speeds as shares of their maximum")
COMMAND = Field("previous_command", ("E", "N", "4"), "1", "", "the output `command` of the call before; first: hover")
OUTPUTS = (
    Field("rates_setpoint", ("E", "N", "3"), "rad/s", "body", "commanded rates about x, y, z, limited"),
    Field("thrust_setpoint", ("E", "N"), "1", "body z", "commanded collective thrust, share of full scale, limited"),
    Field(
        "command", ("E", "N", "4"), "1", "", "roll, pitch, yaw rate and thrust in [-1, 1], after tanh, before limits"
    ),
)


class Pilot(nn.Module):
    """From measurements to set-points: the observation of ``env``, ``policy``, tanh and the limits of its drone."""

    def __init__(self, policy: Policy, env: FormationEnv) -> None:
        super().__init__()
        policy.check(env)
        self.policy, self.env = policy, env
        self.further = [field.name for field in fields(policy)[len(INPUTS) :]]

    def forward(
        self,
        time: Tensor,
        position: Tensor,
        attitude: Tensor,
        velocity: Tensor,
        rates: Tensor,
        columns: Tensor,
        ball_position: Tensor,
        ball_velocity: Tensor,
        ball_flying: Tensor,
        first: Tensor | None = None,
        second: Tensor | None = None,
    ) -> tuple[Tensor, Tensor, Tensor]:
        """``OUTPUTS`` of ``fields(policy)`` in their order: those of ``INPUTS``, then what else the policy observes."""
        step = time / self.env.dt
        nothing = position.new_zeros(())
        ball = (ball_position, ball_velocity, ball_position[..., 2], ball_position[..., 2])
        blank = torch.zeros_like(attitude)  # for what the policy does not look at
        more = dict(zip(self.further, (first, second), strict=False))
        throttle, command = more.get("throttle", blank), more.get("previous_command", blank)
        told = position.new_zeros((1, position.shape[1], 0, 6))  # positions and velocities are what is known
        state = State(position, attitude, velocity, rates, throttle, rates, rates, command, step, *ball, told)
        world = self.env.world
        state = obstacles.sighted(state, time, ball_position, ball_velocity, ball_flying, world.scenario)
        scenarios = Scenarios(step, position, attitude, columns, ball_position[..., 2], *[nothing] * 5)
        command = self.policy(self.env.observe(state, scenarios)).tanh()
        rates_setpoint, thrust_setpoint = control.ctbr(command, world.drone)
        return rates_setpoint, thrust_setpoint, command


def fields(policy: Policy) -> tuple[Field, ...]:
    """The inputs that a policy needs."""
    spec = policy.observation
    return (*INPUTS, *[THROTTLE] * spec.rotor_throttles, *[COMMAND] * spec.previous_command)


def require() -> None:
    """Raise ValueError unless the packages of the extra ``export`` are installed."""
    missing = [name for name in PACKAGES if find_spec(name) is None]
    if missing:
        raise ValueError(f"export needs {', '.join(missing)}: pip install 'formctl[export]'")


def free_sizes(policy: Policy) -> tuple[str, ...]:
    """Sizes that may differ from call to call; without cross-attention the number of balls is not among them."""
    attends = policy.encoder_spec.cross_attention == "attention"
    return ("E", "C", "M") if attends else ("E", "C")


def write(policy: Policy, env: FormationEnv, path: Path) -> None:
    """The graph as an ONNX file. Raises ValueError where a package of the extra ``export`` is missing."""
    require()
    import logging
    import warnings

    wanted = fields(policy)
    free = free_sizes(policy)
    example = blank(policy, env, 2, 2, 2 if "M" in free else policy.balls)
    shapes = tuple(
        {axis: torch.export.Dim.DYNAMIC for axis, size in enumerate(field.shape) if size in free} for field in wanted
    )
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the exporter's own making
        program = torch.onnx.export(
            Pilot(policy, env).eval(),
            tuple(example[field.name] for field in wanted),
            input_names=[field.name for field in wanted],
            output_names=[field.name for field in OUTPUTS],
            dynamic_shapes=shapes,
            opset_version=OPSET,
            dynamo=True,
            verbose=False,
        )
    assert program is not None
    program.save(path, external_data=False)


def blank(policy: Policy, env: FormationEnv, episodes: int, columns: int, balls: int) -> Inputs:
    """Inputs of the right shapes: drones in their slots at rest."""
    size = {"E": episodes, "N": env.drones, "C": columns, "M": balls}
    made = {
        field.name: torch.zeros([size[part] if part in size else int(part) for part in field.shape])
        for field in fields(policy)
    }
    scenarios = sample(env.world.scenario, episodes, seed=0)
    made |= {"position": scenarios.position, "attitude": scenarios.attitude}
    made["ball_flying"] = made["ball_flying"].bool()
    return made


@torch.no_grad()
def record(policy: Policy, env: FormationEnv, count: int, seed: int, episodes: int = 20) -> Inputs:
    """``count`` measurements of flights of ``policy`` in ``env``, spread evenly over time and episodes."""
    scenarios = sample(env.world.scenario, episodes, seed, dtype=env.dtype)
    act, state = policy.agent(env), env.reset(scenarios)
    frames: list[Inputs] = []
    steps = round(env.world.scenario.duration / env.dt)
    stride = max(1, steps * episodes // count)
    for step in range(steps):
        if step % stride == 0:
            frames.append(measure(policy, env, state, scenarios))
        state, _, _ = env.step(state, act(state, scenarios), scenarios)
    return {name: torch.cat([frame[name] for frame in frames])[:count] for name in frames[0]}


def measure(policy: Policy, env: FormationEnv, state: State, scenarios: Scenarios) -> Inputs:
    """The inputs of a state."""
    time = env.time(state)
    ball, velocity, flying = obstacles.balls_at(state, time)
    columns, episodes = scenarios.columns, len(scenarios.id)
    if columns.shape[1] == 0:
        columns = columns.new_full((episodes, 1, 2), FAR)
    if ball.shape[1] == 0:
        ball, velocity = ball.new_zeros((2, episodes, 1, 3))
        flying = flying.new_zeros((episodes, 1))
    found = {
        "time": time, "position": state.position, "attitude": state.attitude, "velocity": state.velocity,
        "rates": state.rates, "columns": columns, "ball_position": ball, "ball_velocity": velocity,
        "ball_flying": flying, "throttle": state.throttle, "previous_command": state.command,
    }  # fmt: skip
    return {field.name: found[field.name] for field in fields(policy)}


@dataclass(frozen=True)
class Parity:
    """How far an ONNX file is from the policy on recorded measurements."""

    observations: int
    balls: int
    columns: int
    largest: dict[str, float]  # absolute difference by output, in its unit

    @property
    def worst(self) -> float:
        """The larger of command and thrust; the rates are the command times their limit, in rad/s."""
        return max(self.largest["command"], self.largest["thrust_setpoint"])


@torch.no_grad()
def compare(path: Path, policy: Policy, env: FormationEnv, inputs: Mapping[str, Tensor]) -> Parity:
    """Run a file with onnxruntime and the policy with torch on the same measurements."""
    names = [field.name for field in fields(policy)]
    ours = Pilot(policy, env).eval()(*(inputs[name] for name in names))
    theirs = session(path).run(None, {name: inputs[name].numpy() for name in names})
    largest = {
        field.name: float(np.abs(mine.numpy().astype(float) - other).max())
        for field, mine, other in zip(OUTPUTS, ours, theirs, strict=True)
    }
    sizes = inputs["ball_position"].shape[1], inputs["columns"].shape[1]
    return Parity(len(inputs["time"]), *sizes, largest)


def session(path: Path) -> Any:
    """The file in onnxruntime, on one CPU thread. Raises ValueError where the package is missing."""
    require()
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    return onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
