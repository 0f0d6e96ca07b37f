"""The environment: three Crazyflies (or N) fly a formation along +y through columns while balls are thrown at them.

A batch of E episodes is advanced by pure functions of tensors. ``step`` and ``observe`` draw no random numbers and
branch on no data, so they compile, differentiate and replay exactly.

| action (E, N, 4) | range | meaning |
|---|---|---|
| 0, 1, 2 | [-1, 1] | commanded roll, pitch, yaw rate, body frame, times ``drone.rate_limit`` |
| 3 | [-1, 1] | collective thrust, -1 none and 1 full scale, clamped to ``drone.thrust_range`` |

A drone whose command is ``rotor`` takes four rotor thrusts instead, -1 none and 1 the most that the rotor gives.

Observations: ``envs.observation``. Rewards: ``envs.reward``. Start: at rest in formation (jittered in the real-flight
scenarios), rotors at hover. End: ``terminated`` on a collision or crash, ``truncated`` after ``scenario.duration``.
"""

import copy
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar

import torch
from torch import Tensor

from envs import air, control, dynamics, memory, messages, observation, obstacles, rotation, shapes
from envs.episodewise import Episodewise
from envs.reward import Reward
from envs.spec import (
    DroneSpec,
    Events,
    Observation,
    ObservationSpec,
    Scenarios,
    ScenarioSpec,
    State,
)
from envs.step_view import StepView


@dataclass(frozen=True)
class WorldSpec:
    """Everything that defines the task: scenario, vehicle, what is observed and what is rewarded."""

    scenario: ScenarioSpec
    drone: DroneSpec
    observation: ObservationSpec
    reward: Reward


class FormationEnv:
    """A batch of formation flights as pure functions of (state, action, scenarios).

    ``compiler`` is what whoever flies in it compiles its own functions with; it changes nothing until ``compiled``.
    """

    pieces: ClassVar[tuple[str, ...]] = ("observe", "advance", "judge")
    """Methods that ``compiled`` compiles with PyTorch."""

    programs: ClassVar[dict[str, tuple[int, ...]]] = {
        "observe": (0,),
        "launch": (0,),
        "physics": (0, 1),
        "judge": (0, 1),
    }
    """Methods that ``compiled`` turns into C++, with the arguments that gradients flow back to."""

    def __init__(
        self, world: WorldSpec, dtype: torch.dtype = torch.float32, device: torch.device | str = "cpu"
    ) -> None:
        self.world = world
        self.dtype, self.device = dtype, torch.device(device)
        self.slots = shapes.slots(world.scenario, dtype).to(self.device)
        self.target = shapes.laplacian(self.slots)
        self.drones = len(self.slots)
        self.dt = world.drone.control_period
        _check_period(world)
        self.compiler: Callable[[Callable[..., Any]], Callable[..., Any]] = lambda function: function
        self.sensor = observation.sensor(world.observation)
        self.layout = self.sensor.layout(world.scenario)

    @property
    def commands(self) -> tuple[str, ...]:
        """Kinds of action that ``step`` takes."""
        return (self.world.drone.command,)

    def reset(self, scenarios: Scenarios) -> State:
        """Start of the episodes: in place, at rest, rotors at hover, rate loops cleared."""
        episodes, balls = scenarios.throw_time.shape

        def full(*shape: int, value: float = 0.0) -> Tensor:
            # Every field has memory of its own: shared tensors would make a compiled step compile twice.
            return memory.ordered(scenarios.position.new_full((episodes, *shape), value))

        hover = scenarios.position.new_tensor(dynamics.hover_action(self.world.drone))
        return State(
            position=memory.ordered(scenarios.position).clone(),
            attitude=memory.ordered(scenarios.attitude).clone(),
            velocity=full(self.drones, 3),
            rates=full(self.drones, 3),
            throttle=full(self.drones, 4, value=dynamics.hover_throttle(self.world.drone)),
            rate_integral=full(self.drones, 3),
            last_rates=full(self.drones, 3),
            command=full(self.drones, 4) + hover,
            step=torch.zeros(episodes, dtype=torch.int64, device=scenarios.position.device),
            ball_origin=full(balls, 3),
            ball_velocity=full(balls, 3),
            ball_time=full(balls, value=float("inf")),
            ball_landing=full(balls, value=float("inf")),
            told=messages.first(scenarios.position, self.world.scenario.messages.window),
        )

    def time(self, state: State) -> Tensor:
        """Seconds (E,) since the start of each episode."""
        return state.step.to(state.position) * self.dt

    def observe(self, state: State, scenarios: Scenarios) -> Observation:
        """Observation groups of every drone, see ``envs.observation``."""
        return self.sensor.observe(state, scenarios, self.time(state), self.world.scenario, self.slots)

    def step(self, state: State, action: Tensor, scenarios: Scenarios) -> tuple[State, Tensor, Events]:
        """One command of ``control_period`` seconds: next state, reward vector (E, N, 4) and events.

        ``action`` is (E, N, 4) in [-1, 1]. Balls due now are thrown first; collisions are tested along the step.
        """
        before, after = self.advance(state, action, scenarios)
        reward, events = self.judge(before, after, scenarios)
        return after, reward, events

    def compiled(self, compiler: Callable[..., Any]) -> "FormationEnv":
        """The same world with its pieces in C++ on a CPU, or else compiled apart by ``compiler(function)``.

        One graph for all of a step takes several times as long to compile and runs no faster. A compiler whose
        ``enabled`` is false leaves the world as it is.
        """
        world = copy.copy(self)
        world.compiler = cache(compiler)
        if self.device.type == "cpu" and self.dtype == torch.float32 and getattr(compiler, "enabled", False):
            for piece, differentiable in self.programs.items():
                function = getattr(self, piece)
                program = Episodewise(function, world.compiler, differentiable, rows=piece == "observe")
                setattr(world, piece, program)
            return world
        for piece in self.pieces:
            setattr(world, piece, world.compiler(getattr(world, piece)))
        return world

    def advance(self, state: State, action: Tensor, scenarios: Scenarios) -> tuple[State, State]:
        """The physics of one command: the state with this step's throws made, and the state at its end."""
        before = self.launch(state, scenarios)
        command = memory.ordered(action).clamp(-1, 1)
        return before, self._flown(before, self._fly(before, command, scenarios), command)

    def launch(self, state: State, scenarios: Scenarios) -> State:
        """The state with the balls thrown whose time has come."""
        return obstacles.launch(state, self.time(state), scenarios, self.world.scenario)

    def judge(self, before: State, after: State, scenarios: Scenarios) -> tuple[Tensor, Events]:
        """Reward vector (E, N, 4) and events of a step from ``before``, its throws made, to ``after``."""
        scenario = self.world.scenario
        start, end = self.time(before), self.time(after)
        columns = obstacles.column_clearance(before.position, after.position, scenarios)
        balls = obstacles.ball_clearance(before, after, start, end)
        size, shape = shapes.laplacian_distances(after.position, self.target)
        first = (before.step == 0)[:, None]
        change = rotation.norm(after.command - before.command)
        events = Events(
            column=obstacles.least(columns),
            ball=obstacles.least(balls),
            drone=obstacles.drone_clearance(before.position, after.position),
            formation_error=size,
            shape_error=shape,
            command_change=torch.where(first, 0.0, change),
            throttle_change=rotation.norm(after.throttle - before.throttle),
        )
        position, velocity, flying = obstacles.balls_at(after, end)
        ground, ceiling = self.crashed(after)
        view = StepView(
            before=before,
            state=after,
            events=events,
            column_distance=columns,
            ball_distance=balls,
            ball_position=position,
            ball_velocity=velocity,
            ball_thrown=~after.ball_time.isinf(),
            ball_flying=flying,
            last=self.truncated(after),
            crashed=ground | ceiling,
            slots=self.slots,
            scenarios=scenarios,
            scenario=scenario,
            drone=self.world.drone,
        )
        return self.world.reward(view), events

    def crashed(self, state: State) -> tuple[Tensor, Tensor]:
        """Whether each drone (E, N) is below the ground limit, and above the ceiling."""
        low, high = self.world.scenario.altitude
        return state.position[..., 2] < low, state.position[..., 2] > high

    def terminated(self, state: State, events: Events, hits: bool = True) -> Tensor:
        """Whether any drone (E,) crashed or, with ``hits``, met a column, a ball or another drone in the last step."""
        ground, ceiling = self.crashed(state)
        ended = (ground | ceiling).any(-1)
        return ended | self.hit(events) if hits else ended

    def hit(self, events: Events) -> Tensor:
        """Whether any drone (E,) met a column, a ball or another drone in the last step."""
        nearest = torch.minimum(torch.minimum(events.column, events.ball), events.drone)
        return (nearest < self.world.scenario.hit_radius).any(-1)

    def truncated(self, state: State) -> Tensor:
        """Whether the training episode's time is up (E,)."""
        return state.step >= round(self.world.scenario.duration / self.dt)

    def _fly(self, state: State, command: Tensor, scenarios: Scenarios) -> State:
        """``drone.substeps`` steps of physics under a command, the first of them perhaps still under the one before."""
        conditions, steps, before = self._conditions(state, scenarios), self.world.drone.substeps, state.command
        times = [step * self.dt / steps for step in range(steps)]
        late = sum(self._command(state, command, since) is before for since in times)
        for given, repeat in ((before, late), (command, steps - late)):
            state = self.physics(state, given, conditions, repeat=repeat) if repeat else state
        return state

    def physics(
        self, state: State, command: Tensor, conditions: dynamics.Conditions = dynamics.MODEL, repeat: int = 1
    ) -> State:
        """Rate loop, rotors and rigid bodies, ``repeat`` times under the command (E, N, 4) in force."""
        drone = self.world.drone
        dt = self.dt / drone.substeps
        for _ in range(repeat):
            turning = state.throttle
            state = self._drive(state, command, dt, conditions)
            wrench = dynamics.external_wrench(state, drone, conditions, turning, dt)
            state = dynamics.integrate(state, wrench, drone, dt)
        return state

    def _flown(self, before: State, after: State, command: Tensor) -> State:
        """``after`` a step that flew ``command`` from ``before``, with what the drones told each other by then."""
        after = after._replace(command=command, step=before.step + 1)
        spec = self.world.scenario.messages
        return messages.tell(after, self.time(before), self.time(after), spec) if spec.window else after

    def _conditions(self, state: State, scenarios: Scenarios) -> dynamics.Conditions:
        """The craft and the air of these episodes, over one command."""
        vehicle = scenarios.vehicle if scenarios.vehicle.shape[-1] else None
        still = scenarios.wind.shape[1] == 0
        wind = None if still else air.velocity(scenarios.wind, state.position, self.time(state))
        return dynamics.Conditions(vehicle, wind, self.world.scenario.air.ground_effect)

    def _command(self, state: State, command: Tensor, since: float) -> Tensor:
        """The command (E, N, 4) in force ``since`` seconds into the step that was given ``command``."""
        return state.command if since + 1e-9 < self.world.drone.latency else command

    def _drive(self, state: State, command: Tensor, dt: float, conditions: dynamics.Conditions) -> State:
        """Rotors over ``dt`` s towards what the command (E, N, 4) asks for, through the rate loop where it is CTBR."""
        drone = self.world.drone
        lag = None if conditions.vehicle is None else conditions.vehicle[..., 2:]
        if drone.command == "rotor":
            return state._replace(throttle=dynamics.respond(state.throttle, (command + 1) / 2, drone, dt, lag))
        rates, thrust = control.ctbr(command, drone)
        memory = control.PidState(state.rate_integral, state.last_rates)
        output, memory = control.rate_pid(rates, state.rates, memory, drone, dt)
        throttle = dynamics.respond(state.throttle, control.mix(output, thrust), drone, dt, lag)
        return state._replace(throttle=throttle, rate_integral=memory.integral, last_rates=memory.last_rates)


def _check_period(world: WorldSpec) -> None:
    """Raise ValueError for messages that would be sent between two commands."""
    period, dt = world.scenario.messages.period, world.drone.control_period
    if abs(period / dt - round(period / dt)) > 1e-6:
        raise ValueError(
            f"scenario.messages.period={period:g} s is not a multiple of the control period, {dt:g} s: "
            f"use e.g. scenario.messages.period={5 * dt:g}"
        )


def where(mask: Tensor, chosen: State | Scenarios, other: State | Scenarios) -> State | Scenarios:
    """Episode-wise choice between two batches of states or scenarios; ``mask`` is (E,)."""
    fields = (
        torch.where(mask.view(-1, *(1,) * (left.dim() - 1)), memory.ordered(left), memory.ordered(right))
        for left, right in zip(chosen, other, strict=True)
    )
    return type(chosen)(*fields)
