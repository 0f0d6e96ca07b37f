"""The task as a MuJoCo model: drones as free bodies, columns and balls as bodies that are placed, not simulated.

Contact geometry is the hit test's: every geom has half of ``hit_radius``, so surfaces touch exactly when centres (or a
centre and a column's axis) are ``hit_radius`` apart, and a touch always counts as a hit. Columns have no end that a
drone could reach: like the torch world's they are infinite. Mass and inertia are the drone's, not its geom's.

Contacts have no friction: on a sphere around the centre of mass they push and do not spin. With friction a touch spins
27 g of drone faster than 20 ms steps can follow, and the episode ends in numbers that are none.
"""

import mujoco

from envs.dynamics import GRAVITY
from envs.spec import DroneSpec, ScenarioSpec

COLUMN_REACH = 10.0
"""m, half-length of a column: far beyond ground and ceiling."""


def build(
    scenario: ScenarioSpec, drone: DroneSpec, drones: int, columns: int, balls: int, step: float, contacts: bool = True
) -> mujoco.MjModel:
    """Model with ``drones`` free bodies, then ``columns`` and ``balls`` mocap bodies in this order; ``step`` in s.

    Euler without implicit damping: the drones' damping is applied as a force, as in the torch world. Warm starts are
    off so that a step depends on nothing but its inputs, automatic resets so that a bad state is seen, not hidden.
    """
    spec = mujoco.MjSpec()
    spec.option.timestep = step
    spec.option.gravity = (0, 0, -GRAVITY)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    off = mujoco.mjtDisableBit
    spec.option.disableflags = off.mjDSBL_EULERDAMP | off.mjDSBL_WARMSTART | off.mjDSBL_AUTORESET
    if not contacts:
        spec.option.disableflags |= off.mjDSBL_CONTACT
    radius = scenario.hit_radius / 2
    spec.default.geom.condim = 1
    spec.worldbody.add_geom(name="ground", type=mujoco.mjtGeom.mjGEOM_PLANE, size=(0, 0, 1))
    for i in range(drones):
        _add_drone(spec, f"drone{i}", drone, radius)
    for i in range(columns):
        column = spec.worldbody.add_body(name=f"column{i}", mocap=True)
        column.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=(radius, COLUMN_REACH, 0))
    for i in range(balls):
        ball = spec.worldbody.add_body(name=f"ball{i}", mocap=True)
        ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(radius, 0, 0))
    return spec.compile()


def _add_drone(spec: mujoco.MjSpec, name: str, drone: DroneSpec, radius: float) -> None:
    body = spec.worldbody.add_body(name=name, explicitinertial=True, mass=drone.mass, inertia=drone.inertia)
    body.add_freejoint()
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(radius, 0, 0))
