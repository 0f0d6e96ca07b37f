"""The same task on MuJoCo (``sim=mujoco``): an independent check of the torch world's physics.

Same scenarios, same commands, same rate loop and rotors, same observation, reward, events and flight code; MuJoCo's
rigid bodies, contacts and integrator. At the drone's own step and away from obstacles the two agree to rounding
(float64); at a shorter ``physics_step`` MuJoCo shows whether a policy or planner lives off the torch world's
integrator.

What differs from the torch world:

- **Contacts.** A drone that meets a column, a ball, another drone or the ground is pushed away; the torch world lets it
  pass. Hits are counted by the same geometric test in both, and contact geometry is chosen so that a touch is a hit
  (``envs.mujoco_model``). What happens before the first hit is therefore the same, what happens after it is not.
- **Balls** fly the torch world's analytic parabola in both: they are placed, not integrated, and push without being
  pushed (a ball is some forty times heavier than a drone). Before the throw and after the landing they are far away.
- **Step.** ``physics_step`` sets the step of rate loop, rotors and rigid bodies together: a rate loop that holds its
  output over several physics steps rings.
- **No gradient**, and no compilation of ``advance``: it leaves torch, for the CPU.
"""

import time
from typing import ClassVar

import mujoco
import mujoco.rollout
import numpy as np
import torch
from mujoco.batch import Batch
from torch import Tensor

from envs import dynamics, mujoco_model, obstacles
from envs.formation import FormationEnv, WorldSpec
from envs.scenarios import sample
from envs.spec import FAR, Scenarios, State


class MujocoFormationEnv(FormationEnv):
    """A batch of formation flights whose rigid bodies MuJoCo moves; see :class:`envs.formation.FormationEnv`.

    ``physics_step`` is MuJoCo's step in s, a whole fraction of the control period (default: the drone's own);
    ``threads`` is the number of threads that share the batch. Steps are functions of (state, action, scenarios), as in
    the torch world: a state from anywhere, also from the torch world, can be stepped on. ValueError for a step that
    does not divide the control period.
    """

    pieces = ("observe", "judge")
    programs: ClassVar[dict[str, tuple[int, ...]]] = {"observe": (0,), "launch": (0,), "judge": (0, 1)}

    def __init__(
        self,
        world: WorldSpec,
        dtype: torch.dtype = torch.float32,
        device: torch.device | str = "cpu",
        physics_step: float | None = None,
        contacts: bool = True,
        threads: int = 1,
    ) -> None:
        super().__init__(world, dtype, device)
        self.substeps = substeps(world, physics_step)
        self.contacts, self.threads = contacts, threads
        self._batch: Batch | None = None
        self._shape = (0, 0, 0)

    def model(self, scenarios: Scenarios) -> mujoco.MjModel:
        """The MuJoCo model of one episode, with room for the columns and balls of ``scenarios``."""
        columns, balls = scenarios.columns.shape[1], scenarios.throw_time.shape[1]
        return mujoco_model.build(
            self.world.scenario,
            self.world.drone,
            self.drones,
            columns,
            balls,
            self.dt / self.substeps,
            self.contacts,
        )

    def advance(self, state: State, action: Tensor, scenarios: Scenarios) -> tuple[State, State]:
        """The physics of one command: the state with this step's throws made, and the state at its end.

        ValueError for an action that is not finite, which MuJoCo would only log.
        """
        if not action.isfinite().all():
            episode = int((~action.isfinite()).flatten(1).any(1).nonzero()[0])
            raise ValueError(f"the action of episode {episode} of the batch is not finite")
        before = self.launch(state, scenarios)
        command = action.clamp(-1, 1)
        return before, self._flown(before, self._simulate(before, command, scenarios), command)

    def _simulate(self, state: State, command: Tensor, scenarios: Scenarios) -> State:
        """Rate loop and rotors in torch, rigid bodies in MuJoCo, ``substeps`` times over one command."""
        dt = self.dt / self.substeps
        conditions = self._conditions(state, scenarios)
        batch = self._sized(scenarios)
        pose, twist = batch.bind("qpos"), batch.bind("qvel")
        load(pose, state.position, state.attitude)
        load(twist, state.velocity, state.rates)
        for substep in range(self.substeps):
            turning = state.throttle
            state = self._drive(state, self._command(state, command, substep * dt), dt, conditions)
            wrench = dynamics.external_wrench(state, self.world.drone, conditions, turning, dt)
            load(batch.bind("qfrc_applied"), wrench.force, wrench.torque)
            self._place(batch, state, scenarios, self.time(state) + substep * dt)
            batch.step()
            position, attitude = self._read(pose, 7).split((3, 4), -1)
            velocity, turning = self._read(twist, 6).split((3, 3), -1)
            state = state._replace(position=position, attitude=attitude, velocity=velocity, rates=turning)
        return state

    def _sized(self, scenarios: Scenarios) -> Batch:
        """The batch of simulations for as many episodes, columns and balls as ``scenarios`` holds."""
        shape = (len(scenarios.id), scenarios.columns.shape[1], scenarios.throw_time.shape[1])
        if self._batch is None or self._shape != shape:
            self._batch, self._shape = Batch(self.model(scenarios), len(scenarios.id), self.threads), shape
        return self._batch

    def _place(self, batch: Batch, state: State, scenarios: Scenarios, now: Tensor) -> None:
        """Columns, and balls in the air at ``now`` (E,) in s; other balls far away."""
        ball, _, flying = obstacles.balls_at(state, now)
        ball = torch.where(flying[..., None], ball, FAR)
        places = batch.bind("mocap_pos")
        columns = scenarios.columns.shape[1]
        places[:, :columns, :2] = scenarios.columns.cpu().numpy()
        places[:, columns:] = ball.cpu().numpy()

    def _read(self, rows: np.ndarray, width: int) -> Tensor:
        """MuJoCo's rows (E, N width) as a tensor (E, N, width) of its own."""
        return torch.tensor(rows.reshape(len(rows), self.drones, width), dtype=self.dtype, device=self.device)


def substeps(world: WorldSpec, physics_step: float | None = None) -> int:
    """Physics steps per command at ``physics_step`` seconds; ValueError unless they divide the control period."""
    period = world.drone.control_period
    if physics_step is None:
        return world.drone.substeps
    count = round(period / physics_step) if physics_step > 0 else 0
    if count < 1 or abs(count * physics_step - period) > 1e-9:
        raise ValueError(
            f"physics step of {physics_step} s does not divide the control period of {period} s: use e.g. 0.002"
        )
    return count


def load(rows: np.ndarray, first: Tensor, second: Tensor) -> None:
    """Write (E, N, a) and (E, N, b) into MuJoCo's rows (E, N (a + b)), drone after drone."""
    rows[:] = torch.cat((first, second), -1).flatten(1).detach().cpu().numpy()


def rollout_rate(
    world: WorldSpec, environments: int, threads: int = 0, commands: int = 50, physics_step: float | None = None
) -> float:
    """Environment steps (of all drones together) per second of MuJoCo's own ``rollout`` on this task.

    The yardstick of ``formctl bench env``: one call advances ``environments`` drawn scenes by ``commands`` control
    periods on ``threads`` threads (0: the calling one), drones pushed by random wrenches around hover, contacts on,
    columns in their places. Rigid bodies and contacts only: no rate loop, no observation, no reward.
    """
    env = MujocoFormationEnv(world, torch.float64, physics_step=physics_step)
    scenarios = sample(world.scenario, environments, seed=0, dtype=torch.float64)
    model = env.model(scenarios)
    steps = commands * env.substeps
    control, spec = _yardstick_control(env, scenarios, steps)
    data = mujoco.MjData(model)
    initial = np.empty((environments, mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)))
    start = env.reset(scenarios)
    for row, position, attitude in zip(initial, start.position, start.attitude, strict=True):
        data.qpos[:] = torch.cat((position, attitude), -1).flatten().numpy()
        mujoco.mj_getState(model, data, row, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    workers = [mujoco.MjData(model) for _ in range(max(threads, 1))]
    with mujoco.rollout.Rollout(nthread=threads) as pool:
        pool.rollout(model, workers, initial, control[:, :1], control_spec=spec)  # warm-up
        began = time.perf_counter()
        pool.rollout(model, workers, initial, control, control_spec=spec)
        return environments * commands / (time.perf_counter() - began)


def _yardstick_control(env: MujocoFormationEnv, scenarios: Scenarios, steps: int) -> tuple[np.ndarray, int]:
    """Applied forces and places of columns and balls (E, steps, ...), and the specification MuJoCo reads them by."""
    episodes = len(scenarios.id)
    random = np.random.default_rng(0)
    wrench = random.normal(0, (1e-2, 1e-2, 1e-2, 1e-6, 1e-6, 1e-6), (episodes, steps, env.drones, 6))
    wrench[..., 2] += env.world.drone.mass * dynamics.GRAVITY
    bodies = scenarios.columns.shape[1] + scenarios.throw_time.shape[1]
    places = np.full((episodes, steps, bodies, 3), FAR)
    places[:, :, : scenarios.columns.shape[1], :2] = scenarios.columns.numpy()[:, None]
    places[:, :, : scenarios.columns.shape[1], 2] = 0
    parts = (wrench.reshape(episodes, steps, -1), places.reshape(episodes, steps, -1))
    spec = mujoco.mjtState.mjSTATE_QFRC_APPLIED | mujoco.mjtState.mjSTATE_MOCAP_POS
    return np.concatenate(parts, -1), int(spec)
