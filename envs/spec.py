"""What the world is made of: its settings (frozen dataclasses, one per group in ``conf/``) and its tensors.

Shapes use E environments, N drones, M balls, C columns. SI units; world frame with z up unless a line says *body*;
quaternions are ``wxyz``. Settings carry no defaults: their values, each with a comment, stand in ``conf/``.
"""

from dataclasses import dataclass, fields
from typing import Annotated, ClassVar, Literal, NamedTuple

from annotated_types import Ge, Gt, Le
from torch import Tensor


@dataclass(frozen=True)
class DroneSpec:
    """A quadrotor, its rate controller and its rotors (``conf/drone/``; docs/method.md, Action and drone)."""

    command: ClassVar[str] = "ctbr"  # what ``step`` takes: roll, pitch, yaw rate and collective thrust
    name: str
    mass: float  # kg
    inertia: tuple[float, float, float]  # kg m^2, body axes
    rotor_positions: tuple[tuple[float, float], ...]  # (4, 2) m, body x and y
    rotor_directions: tuple[float, ...]  # (4,) spin sense; -1 gives +z reaction torque
    max_thrust: float  # N per rotor, at full speed
    max_torque: float  # N m per rotor, drag torque about body z at full speed
    thrust_curve: tuple[float, float]  # thrust as a share of max_thrust: a s + b s^2 of the speed's share s; a + b = 1
    torque_curve: tuple[float, float]  # the same of the drag torque
    motor_time_constant: Annotated[float, Gt(0)]  # s, T below
    spin_up: tuple[float, float]  # T ds/dt = (a + b (c + s)) (c - s) towards a commanded speed share c above s
    spin_down: tuple[float, float]  # the same towards one below it
    rotor_momentum: float  # kg m^2/s, angular momentum of one rotor at full speed, propeller and motor
    rotor_radius: float  # m, for the ground effect
    thrust_bias: float  # share of full scale that the motor map adds to every command
    linear_damping: float  # 1/s, of the velocity through the air
    axial_damping: float  # 1/s, more of it along body z
    angular_damping: float  # 1/s
    downwash_radial: float  # sharpness of the wake across its axis
    downwash_axial: float  # 1/m, decay of the wake along its axis; the wake is off when negative
    rate_limit: float  # rad/s commanded by |a| = 1
    rate_clip: float  # rad/s, clamp on the commanded rate (sim-to-real)
    thrust_range: tuple[float, float]  # clamp on the commanded collective thrust, shares of full scale
    rate_gain_p: tuple[float, float, float]  # rate PID, firmware units (deg/s -> PWM counts)
    rate_gain_i: tuple[float, float, float]
    rate_gain_d: tuple[float, float, float]
    rate_integral_limit: tuple[float, float, float]  # deg
    control_period: float  # s, one command
    substeps: int  # rate PID, rotor and rigid-body steps per command
    latency: float  # s, from a command to its effect, rounded up to whole steps; at most the control period

    def __post_init__(self) -> None:
        if not 0 <= self.latency <= self.control_period:
            raise ValueError(
                f"drone.latency={self.latency:g} s is not between 0 and the control period, {self.control_period:g} s: "
                "longer ones are flown with formctl deploy"
            )
        for name, curve in (("thrust_curve", self.thrust_curve), ("torque_curve", self.torque_curve)):
            if abs(sum(curve) - 1) > 1e-6:
                raise ValueError(f"drone.{name}={list(curve)} has to sum to 1, the share at full speed")


@dataclass(frozen=True)
class RotorDroneSpec(DroneSpec):
    """A quadrotor that is told the thrust of each rotor; its rate controller, and the limits of CTBR, are idle."""

    command: ClassVar[str] = "rotor"  # what ``step`` takes: four thrusts, -1 none and 1 all that the rotor has

    @classmethod
    def of(cls, drone: DroneSpec, period: float) -> "RotorDroneSpec":
        """The same craft, told its rotor thrusts every ``period`` s; physics steps no longer than they were."""
        steps = max(1, round(drone.substeps * period / drone.control_period))
        told = {"control_period": period, "substeps": steps, "thrust_bias": 0.0}
        return cls(**{field.name: getattr(drone, field.name) for field in fields(drone)} | told)


Factor = Annotated[float, Gt(0)]
NonNegative = Annotated[float, Ge(0)]
Loss = Annotated[float, Ge(0), Le(0.9)]


@dataclass(frozen=True)
class VehicleSpec:
    """How far craft are from ``drone`` (``scenario.vehicle``): factors, uniform, each drone and flight for itself."""

    mass: tuple[Factor, Factor]  # on mass and inertia
    thrust: tuple[Factor, Factor]  # on the rotors' thrust and torque
    motor_lag: tuple[Factor, Factor]  # on the motors' time constant


@dataclass(frozen=True)
class AirSpec:
    """Wind, gusts and the ground's cushion (``scenario.air``); see ``envs.air``."""

    wind: tuple[NonNegative, NonNegative]  # m/s, steady and horizontal at flying height, uniform; any direction
    gusts: NonNegative  # times the turbulence that belongs to that wind near the ground
    ground_effect: bool


@dataclass(frozen=True)
class MessageSpec:
    """What drones know of each other (``scenario.messages``); see ``envs.messages``."""

    period: NonNegative  # s, between two messages of a drone; 0: everybody knows everybody's state
    delay: tuple[NonNegative, NonNegative]  # s, mean of a flight's delays, uniform
    jitter: NonNegative  # standard deviation of a delay as a share of that mean (Gamma)
    loss: tuple[Loss, Loss]  # share of a flight's messages that never arrive, uniform
    burst: Annotated[float, Ge(1)]  # messages that are lost in a row, on average
    horizon: Annotated[float, Gt(0)]  # s, what was said this long ago is known at the latest

    def __post_init__(self) -> None:
        if self.period and not self.horizon >= self.period:
            raise ValueError(
                f"scenario.messages.horizon={self.horizon:g} s is shorter than the period, {self.period:g} s"
            )
        if self.loss[1] > self.burst / (1 + self.burst):
            least = self.loss[1] / (1 - self.loss[1])
            raise ValueError(
                f"scenario.messages.loss up to {self.loss[1]:g} cannot come in bursts of {self.burst:g} on average: "
                f"use scenario.messages.burst={least:.3g} or more"
            )

    @property
    def window(self) -> int:
        """How many of a drone's last messages may still be news; 0 without messages."""
        return max(1, round(self.horizon / self.period)) if self.period else 0


@dataclass(frozen=True)
class ScenarioSpec:
    """The task and the law that its episodes are drawn from (``conf/scenario/``)."""

    name: str
    formation: str | tuple[tuple[float, float, float], ...]  # a named shape, or (N, 3) offsets in units of its size
    formation_size: float  # m, circumradius of a named shape
    start: tuple[float, float, float]  # m, formation reference at the start
    velocity: tuple[float, float, float]  # m/s, v*; flight is along +y
    height: float  # m, commanded altitude
    duration: float  # s, training episode
    field: tuple[float, float]  # m, first and last course of the obstacle field; its end is the goal line
    columns: int
    column_layout: Literal["zigzag", "fixed4"]
    column_cell: float  # m, grid spacing
    column_half_width: float  # m, obstacle band |x| <= this
    corridor: float  # m, flight corridor |x| <= this
    balls: int
    ball_aim: Literal["drone", "box", "mix"]
    throw_time: tuple[float, float]  # s
    ball_speed: tuple[float, float]  # m/s, horizontal
    time_to_hit: tuple[float, float]  # s
    release_height: tuple[float, float]  # share of the height of the aim point
    spawn_clearance: float  # m, a throw that would appear closer to a drone is redrawn
    throw_candidates: int  # draws kept per ball to redraw from
    ball_radius: float  # m, drawing, landing and MuJoCo geoms
    column_radius: float  # m, drawing and MuJoCo geoms
    hit_radius: float  # m, centre distance (to a ball or drone) or axis distance (to a column) that is a collision
    altitude: tuple[float, float]  # m, ground and ceiling crash limits
    sensing_range: float  # m, balls further away are not observed
    position_jitter: float  # m, half-width of the uniform start displacement per axis
    attitude_jitter: float  # rad, half-width of the uniform start roll, pitch and yaw
    vehicle: VehicleSpec
    air: AirSpec
    messages: MessageSpec

    @property
    def goal(self) -> float:
        """Course in m that every drone has to pass: the end of the obstacle field."""
        return self.field[1]


@dataclass(frozen=True)
class ObservationSpec:
    """Which numbers the policy is given and how they are conditioned (``conf/observation/``)."""

    name: str
    conditioned: bool  # scaled, course-relative inputs; False is the release's raw layout
    lookahead: float  # s, conditioned balls are shown where they will pass, at most this far ahead; 0: where they are
    rotor_throttles: bool  # four more self numbers, 2 theta - 1 (release)
    previous_command: bool  # four more self numbers, the last normalised command
    slot_relative: bool = False  # where the others are, less where their slots are; policies of before do not say
    message_age: bool = False  # one more number of each other drone, the age in s of what is known; likewise


@dataclass(frozen=True)
class ObservationLayout:
    """Widths and token counts of the observation groups: what a checkpoint was trained on."""

    name: str
    drones: int  # N
    self_dim: int
    drones_dim: int
    static_dim: int
    dynamic_dim: int


class Scenarios(NamedTuple):
    """A batch of episodes as numbers: all of an episode's randomness, drawn before it starts."""

    id: Tensor  # (E,) int64, index within the draw or bank
    position: Tensor  # (E, N, 3) m, start
    attitude: Tensor  # (E, N, 4) start, wxyz
    columns: Tensor  # (E, C, 2) m, axes; an absent column stands at FAR
    throw_time: Tensor  # (E, M) s; an absent ball has inf
    aim: Tensor  # (E, M) int64, drone aimed at, or -1 for a point in the formation's bounding box
    throws: (
        Tensor  # (E, M, R, 7) candidates: direction x, y; speed m/s; time to hit s; release share; box x, y in [0, 1]
    )
    vehicle: Tensor  # (E, N, 3) factors on mass, rotor thrust and motor lag; (E, N, 0) where every craft is the model
    wind: Tensor  # (E, 1 + G, 7) steady wind, then gust waves: m/s x, y, z; rad/m x, y, z; rad; (E, 0, 7) in still air
    delays: Tensor  # (E, N, N, K) s, from sender to receiver, of each message; inf: lost; K = 0 without messages


class State(NamedTuple):
    """Everything that changes during an episode."""

    position: Tensor  # (E, N, 3) m
    attitude: Tensor  # (E, N, 4) body to world, wxyz
    velocity: Tensor  # (E, N, 3) m/s
    rates: Tensor  # (E, N, 3) rad/s, body
    throttle: Tensor  # (E, N, 4) rotor speed as a share of its maximum
    rate_integral: Tensor  # (E, N, 3) deg, rate PID
    last_rates: Tensor  # (E, N, 3) deg/s, rates the PID saw last
    command: Tensor  # (E, N, 4) the last command in [-1, 1]: see ``DroneSpec.command``
    step: Tensor  # (E,) int64, commands since the start
    ball_origin: Tensor  # (E, M, 3) m, launch point
    ball_velocity: Tensor  # (E, M, 3) m/s, launch velocity
    ball_time: Tensor  # (E, M) s, launch time; inf before the throw
    ball_landing: Tensor  # (E, M) s, when the ball reaches the ground; inf before the throw
    told: Tensor  # (E, N, W, 6) position and velocity in each drone's last W messages, newest first; W = 0 without


class Events(NamedTuple):
    """What one step did, measured along the step (swept), not only at its end."""

    column: Tensor  # (E, N) m, least distance to a column axis
    ball: Tensor  # (E, N) m, least centre distance to a flying ball
    drone: Tensor  # (E, N) m, least centre distance to another drone
    formation_error: Tensor  # (E,) m, unnormalised Laplacian distance: the integrand of FM
    shape_error: Tensor  # (E,) normalised Laplacian distance
    command_change: Tensor  # (E, N) |a_t - a_(t-1)|
    throttle_change: Tensor  # (E, N) |theta_t - theta_(t-1)|


FAR = 1e3
"""Coordinate (m) of absent columns and value of distances to nothing: large, finite and harmless to gradients."""

Observation = dict[str, Tensor]
"""``self`` (E, N, 1, d), ``drones`` (E, N, N-1, d), ``static`` (E, N, 1, 9), ``dynamic`` (E, N, M, 10) and the boolean
masks ``static_mask`` (E, N, 1) and ``dynamic_mask`` (E, N, M), True where a token is present."""
