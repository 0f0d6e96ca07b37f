"""What a flight over motion capture and radio adds to the world, in place of the paper's real flights (Sec. VI-D).

The paper flies Crazyflies from a computer: motion capture gives poses, differences of poses give velocities, a policy
or planner decides 50 times a second, and body rates with thrust go out by radio. Two things stand for that here, each
over either physics:

- ``environment``: the craft are not quite the model. Mass, thrust and motor lag differ from drone to drone and flight
  to flight, air moves, and a command takes effect some way into the period it was sent for.
- ``Link``: an agent that sees noisy poses and their differences instead of the state, whose commands are clipped,
  late and sometimes lost. A craft flies on with the last command that reached it.

All of a flight's disturbances follow from ``DeploySpec.seed`` and the number of its episode, whatever else is flown
with it. The rate loop on board keeps its own, undisturbed gyroscope.
"""

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import Annotated, Any, NamedTuple, Protocol

import numpy as np
import torch
from annotated_types import Ge, Gt, Le
from torch import Tensor

from envs import air, memory, obstacles, rotation
from envs.dynamics import Conditions
from envs.formation import FormationEnv, WorldSpec
from envs.spec import AirSpec, DroneSpec, Scenarios, State

BLOCK = 64
"""Steps whose noise is drawn at a time."""

Range = tuple[Annotated[float, Gt(0)], Annotated[float, Gt(0)]]


@dataclass(frozen=True)
class DeploySpec:
    """The disturbances of a deployment (``conf/deploy/``)."""

    name: str
    seed: Annotated[int, Ge(0)]
    position_noise: Annotated[float, Ge(0)]  # m, standard deviation per axis of a drone's measured position
    attitude_noise: Annotated[float, Ge(0)]  # rad, the same of its attitude, about each body axis
    ball_noise: Annotated[float, Ge(0)]  # m, the same of a ball's position
    difference_periods: Annotated[int, Ge(0)]  # control periods that differences span; 0 tells exact velocities
    latency: Annotated[float, Ge(0)]  # s, from the capture of a pose until its command takes effect
    packet_loss: Annotated[float, Ge(0), Le(1)]  # share of commands that never arrive, each drone for itself
    mass: Range  # factor on the model's mass and inertia, uniform, each drone and flight for itself
    thrust: Range  # factor on the rotors' thrust and torque, the same
    motor_lag: Range  # factor on the motors' time constant, the same
    wind: tuple[Annotated[float, Ge(0)], Annotated[float, Ge(0)]]  # m/s, steady wind, uniform, in any direction
    gusts: Annotated[float, Ge(0)]  # times the turbulence that belongs to that wind near the ground
    ground_effect: bool  # rotors push harder close to the ground
    rate_clip: Annotated[float, Gt(0)]  # rad/s, clamp on the commanded rates before they are sent
    thrust_clip: tuple[float, float]  # clamp on the commanded thrust, shares of full scale


class Agent(Protocol):
    """What ``Link`` can fly: ``baselines.protocol.Agent``."""

    name: str
    capabilities: Any

    def reset(self, scenarios: Scenarios, state: State) -> None: ...

    def act(self, state: State, scenarios: Scenarios) -> Tensor: ...


class Sight(NamedTuple):
    """One frame of motion capture."""

    position: Tensor  # (E, N, 3) m
    attitude: Tensor  # (E, N, 4) wxyz
    ball: Tensor  # (E, M, 3) m
    flying: Tensor  # (E, M) bool


def environment(kind: type[FormationEnv], world: WorldSpec, spec: DeploySpec, **settings: Any) -> FormationEnv:
    """The world of class ``kind`` (torch or MuJoCo physics) with the craft of ``spec``; ``settings`` are its own.

    ValueError for a drone with a latency besides that of ``spec``.
    """
    if world.drone.latency:
        raise ValueError(f"a deployment has a latency of its own ({spec.latency:g} s): leave drone.latency at 0")
    env = type(f"Deployed{kind.__name__}", (_Craft, kind), {})(world, **settings)
    env.deploy = spec
    return env


class _Craft(FormationEnv):
    """Craft that are not the model, in moving air. Drawn at ``reset``; ``step`` is for the episodes of that reset."""

    deploy: DeploySpec
    _vehicle: Tensor  # (E, N, 3) factors on mass, thrust and motor lag
    _wind: Tensor  # (E, 1 + G, 7) as ``Scenarios.wind``

    def reset(self, scenarios: Scenarios) -> State:
        state = super().reset(scenarios)
        spec, scenario = self.deploy, self.world.scenario
        ids = [int(id) for id in scenarios.id]
        uniform = state.position.new_tensor(
            np.array([_stream(spec, id, "craft").random((3, self.drones)) for id in ids])
        )
        ranges = state.position.new_tensor((spec.mass, spec.thrust, spec.motor_lag))
        self._vehicle = ranges[:, 0] + (ranges[:, 1] - ranges[:, 0]) * uniform.movedim(1, -1)
        blown = AirSpec(spec.wind, spec.gusts, spec.ground_effect)
        drawn = torch.cat([air.draw(blown, scenario, 1, _stream(spec, id, "wind")) for id in ids])
        self._wind = memory.ordered(drawn.float().to(state.position))
        return state

    def _command(self, state: State, command: Tensor, since: float) -> Tensor:
        late = self.deploy.latency - whole_periods(self.deploy, self.dt) * self.dt
        return command if since + 1e-9 >= late else state.command

    def _conditions(self, state: State, scenarios: Scenarios) -> Conditions:
        vehicle, wind, cushion = super()._conditions(state, scenarios)
        vehicle = self._vehicle if vehicle is None else vehicle * self._vehicle
        if self._wind.shape[1]:
            blown = air.velocity(self._wind, state.position, self.time(state))
            wind = blown if wind is None else wind + blown
        return Conditions(vehicle, wind, cushion or self.deploy.ground_effect)


class Link:
    """An agent behind motion capture and radio; itself an agent, for the environment of the same ``DeploySpec``.

    Its flights are not portable, whoever flies: late commands and velocities from differences cost the loop its
    damping, and a start 1e-6 m off, forgotten without them, is centimetres after 12 s.

    ValueError for a world whose observation holds rotor throttles: nobody off board measures them.
    """

    def __init__(self, agent: Agent, env: FormationEnv, spec: DeploySpec) -> None:
        if env.world.observation.rotor_throttles:
            name = env.world.observation.name
            raise ValueError(
                f"observation={name} holds rotor throttles, which nobody measures in a real flight: train and fly with "
                "observation=paper_raw or observation=paper"
            )
        self.name, self.capabilities = agent.name, replace(agent.capabilities, portable=False)
        self._agent, self._env, self._spec = agent, env, spec
        self._ids: list[int] = []
        self._sights: deque[Sight] = deque(maxlen=spec.difference_periods + 1)
        self._sent: deque[Tensor] = deque(maxlen=whole_periods(spec, env.dt) + 1)
        self._noise: dict[str, tuple[int, Tensor]] = {}

    def reset(self, scenarios: Scenarios, state: State) -> None:
        """Forget the last flights."""
        self._ids = scenarios.id.tolist()
        self._sights.clear()
        self._sent.clear()
        self._noise.clear()
        self._agent.reset(scenarios, state)

    def act(self, state: State, scenarios: Scenarios) -> Tensor:
        """The command (E, N, 4) that reaches the craft in this period: the last one where a packet was lost."""
        step = int(state.step[0])
        wanted = self._agent.act(self.see(state, step), scenarios)
        self._sent.append(clip(wanted, self._spec, self._env.world.drone))
        if len(self._sent) < (self._sent.maxlen or 1):
            return state.command
        lost = self._draw("radio", step, (self._env.drones, 1), state) < self._spec.packet_loss
        return torch.where(lost, state.command, self._sent[0])

    @property
    def sent(self) -> Tensor:
        """The newest command (E, N, 4) that went out, whether or not it arrives."""
        return self._sent[-1]

    def see(self, state: State, step: int) -> State:
        """What the computer knows of ``state``: measured poses, their differences, its own last command."""
        spec, drones = self._spec, self._env.drones
        now = self._env.time(state)
        ball, ball_velocity, flying = obstacles.balls_at(state, now)
        turn = spec.attitude_noise * self._draw("attitude", step, (drones, 3), state)
        sight = Sight(
            state.position + spec.position_noise * self._draw("position", step, (drones, 3), state),
            rotation.multiply(state.attitude, rotation.exponential(turn)),
            ball + spec.ball_noise * self._draw("ball", step, tuple(ball.shape[1:]), state),
            flying,
        )
        self._sights.append(sight)
        velocity, rates = state.velocity, state.rates
        if spec.difference_periods:
            velocity, rates, ball_velocity, flying = differences(self._sights, self._env.dt)
        known = state._replace(position=sight.position, attitude=sight.attitude, velocity=velocity, rates=rates)
        if self._sent:
            known = known._replace(command=self._sent[-1])
        return obstacles.sighted(known, now, sight.ball, ball_velocity, flying, self._env.world.scenario)

    def _draw(self, kind: str, step: int, shape: tuple[int, ...], like: State) -> Tensor:
        """Noise (E, *shape) of one step: standard normal, or uniform in [0, 1) for the radio."""
        block = step // BLOCK
        if self._noise.get(kind, (-1,))[0] != block:
            streams = (_stream(self._spec, id, kind, block) for id in self._ids)
            size = (BLOCK, *shape)
            drawn = [
                stream.random(size, np.float32) if kind == "radio" else stream.standard_normal(size, np.float32)
                for stream in streams
            ]
            self._noise[kind] = block, like.position.new_tensor(np.array(drawn))
        return self._noise[kind][1][:, step % BLOCK]


def differences(sights: "deque[Sight]", dt: float) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Velocities (E, N, 3), body rates (E, N, 3), ball velocities (E, M, 3) and flying flags (E, M) from two frames.

    The oldest frame and the newest, ``dt`` s between one and the next. Drones: the mean over that time, which lags by
    half of it; at rest in the first frame. Balls: the parabola through both frames; one seen in the newest frame only
    has no velocity yet and does not count as flying.
    """
    old, new, span = sights[0], sights[-1], (len(sights) - 1) * dt
    if span == 0:
        still = torch.zeros_like(new.position)
        return still, still, torch.zeros_like(new.ball), torch.zeros_like(new.flying)
    turn = rotation.logarithm(rotation.multiply(rotation.conjugate(old.attitude), new.attitude))
    fall = new.ball.new_tensor([0.0, 0.0, obstacles.GRAVITY * span / 2])
    return (
        (new.position - old.position) / span,
        turn / span,
        (new.ball - old.ball) / span - fall,
        new.flying & old.flying,
    )


def clip(command: Tensor, spec: DeploySpec, drone: DroneSpec) -> Tensor:
    """Commands (E, N, 4) in [-1, 1] with rates and thrust clamped as they are before they are sent (Sec. VI-D1)."""
    rate = spec.rate_clip / drone.rate_limit
    low, high = (2 * share - 1 for share in spec.thrust_clip)
    return torch.cat((command[..., :3].clamp(-rate, rate), command[..., 3:].clamp(low, high)), -1)


def whole_periods(spec: DeploySpec, dt: float) -> int:
    """Control periods of ``dt`` s that a command is late; what remains of the latency is shorter than one."""
    return math.floor(spec.latency / dt + 1e-9)


def _stream(spec: DeploySpec, episode: int, kind: str, block: int = 0) -> np.random.Generator:
    """Random numbers of one episode, for one purpose, from one block of steps."""
    purpose = ("craft", "position", "attitude", "ball", "radio", "wind").index(kind)
    return np.random.default_rng((spec.seed, episode, purpose, block))
