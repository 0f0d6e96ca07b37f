"""What an exported policy takes and gives: measurements in SI units in, CTBR set-points out.

Everything between a motion-capture frame and what is sent to a drone is inside an export: the observation with its
scaling, the network, tanh and the limits of the command. Its inputs are plain measurements in SI units and the world
frame, so that nobody has to write the observation a second time.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from algos.policy import Policy
from envs import control, obstacles
from envs.formation import FormationEnv
from envs.scenarios import sample
from envs.spec import FAR, Scenarios, State

Inputs = dict[str, Tensor]
"""Arguments of ``DeployedPolicy.forward`` by name."""


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


class DeployedPolicy(nn.Module):
    """From measurements to set-points: the observation of ``env``, ``policy``, tanh and the limits of its drone."""

    def __init__(self, policy: Policy, env: FormationEnv) -> None:
        super().__init__()
        policy.check(env)
        if env.world.scenario.messages.period:
            raise ValueError(
                "an export is told where the other drones are now, not what they said: use scenario.messages.period=0"
            )
        self.policy, self.env = policy, env

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
        throttle: Tensor | None = None,
        previous_command: Tensor | None = None,
    ) -> tuple[Tensor, Tensor, Tensor]:
        """``OUTPUTS``, of the inputs that ``fields(policy)`` names; what is not looked at may be left out."""
        step = time / self.env.dt
        nothing = position.new_zeros(())
        ball = (ball_position, ball_velocity, ball_position[..., 2], ball_position[..., 2])
        blank = torch.zeros_like(attitude)  # for what the policy does not look at
        rotors = blank if throttle is None else throttle
        last = blank if previous_command is None else previous_command
        told = position.new_zeros((1, position.shape[1], 0, 6))  # positions and velocities are what is known
        state = State(position, attitude, velocity, rates, rotors, rates, rates, last, step, *ball, told)
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


@torch.no_grad()
def record_midway(
    policy: Policy, env: FormationEnv, count: int, seed: int, frames: int = 16, stride: int = 3
) -> Inputs:
    """``count`` measurements of ``policy`` in ``env``, of flights that start anywhere on the course.

    Each of them lasts for ``frames`` times ``stride`` commands: a second or two of flight among columns and balls is
    recorded in as many seconds of computing, where ``record`` flies whole episodes.
    """
    scenario = env.world.scenario
    episodes = -(-count // frames)
    scenarios = sample(scenario, episodes, seed, dtype=env.dtype)
    act, state = policy.agent(env), env.reset(scenarios)
    share = torch.rand(episodes, generator=torch.Generator().manual_seed(seed))
    step = (0.8 * share * scenario.duration / env.dt).long()
    way = (step * env.dt)[:, None] * state.position.new_tensor(scenario.velocity)
    state = state._replace(step=step, position=state.position + way[:, None])
    recorded: list[Inputs] = []
    for number in range(frames * stride):
        if number % stride == stride - 1:
            recorded.append(measure(policy, env, state, scenarios))
        state, _, _ = env.step(state, act(state, scenarios), scenarios)
    return {name: torch.cat([frame[name] for frame in recorded])[:count] for name in recorded[0]}


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
