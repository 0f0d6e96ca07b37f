"""An episode as a MuJoCo scene to look at: drones, columns, balls, trails and the formation's edges.

Only for pictures: bodies are placed, nothing is simulated. Shadows and multi-sampling are off, which makes software
rendering many times faster. Imported by ``envs.render_worker`` alone, after ``MUJOCO_GL`` is set.
"""

import math
from itertools import combinations, pairwise
from typing import Any

import mujoco
import numpy as np

Shape = mujoco.mjtGeom
DRONE_COLOURS = (
    (0.00, 0.45, 0.70),
    (0.90, 0.62, 0.00),
    (0.00, 0.62, 0.45),
    (0.80, 0.47, 0.65),
    (0.34, 0.71, 0.91),
    (0.58, 0.40, 0.74),
)
"""Okabe and Ito's colours, told apart by colour-blind readers, without the red that marks a hit."""
HIT = (0.84, 0.10, 0.11)
COLUMN = (0.55, 0.58, 0.64, 1.0)
BALL = (0.95, 0.38, 0.14, 1.0)
EDGE = (0.20, 0.22, 0.28, 0.45)
HORIZON = (0.95, 0.96, 0.98)
COLUMN_HEIGHT = 3.0
"""m (paper, Sec. III-A); the world's columns are infinite."""
HIDDEN = (0.0, 0.0, -100.0)
PAINTED = ("hub", "rotor0", "rotor1", "rotor2", "rotor3")
"""Parts of a drone that carry its colour."""
ARM = 0.0396
"""m from a drone's centre to its rotors."""


class Scene:
    """A recording (arrays of ``envs.render.Recording``) seen through a view (fields of ``envs.render.View``)."""

    def __init__(self, recording: dict[str, np.ndarray], view: dict[str, Any]) -> None:
        self.recording, self.view = recording, view
        self.position, self.balls = recording["position"], recording["balls"]
        self.drones = self.position.shape[1]
        self.model = self._model()
        self.data = mujoco.MjData(self.model)
        self.renderer = mujoco.Renderer(self.model, view["height"], view["width"], max_geom=4000)
        self.centre = _smooth(self.position.mean(1), round(0.8 / float(recording["dt"])))

    def picture(self, entry: int) -> np.ndarray:
        """The recording at ``entry`` as (height, width, 3) uint8."""
        self._place(entry)
        self.renderer.update_scene(self.data, self._camera(entry))
        for first, second in combinations(range(self.drones), 2):
            self._line(self.position[entry, first], self.position[entry, second], 0.008, EDGE)
        for drone in range(self.drones):
            self._trail(entry, drone)
        return np.asarray(self.renderer.render())

    def close(self) -> None:
        """Free the OpenGL context."""
        self.renderer.close()

    def _model(self) -> mujoco.MjModel:
        spec = mujoco.MjSpec()
        _surroundings(spec, self.view["width"], self.view["height"], self.view["fovy"])
        for i in range(self.drones):
            _add_drone(spec, f"drone{i}", self.view["drone_scale"])
        radius = float(self.recording["column_radius"])
        for x, y in self.recording["columns"]:
            half = COLUMN_HEIGHT / 2
            spec.worldbody.add_geom(type=Shape.mjGEOM_CYLINDER, pos=(x, y, half), size=(radius, half, 0), rgba=COLUMN)
        for i in range(self.balls.shape[1]):
            ball = spec.worldbody.add_body(name=f"ball{i}", mocap=True)
            size = (float(self.recording["ball_radius"]), 0, 0)
            ball.add_geom(type=Shape.mjGEOM_SPHERE, size=size, rgba=BALL, material="bright")
        return spec.compile()

    def _place(self, entry: int) -> None:
        self.data.mocap_pos[: self.drones] = self.position[entry]
        self.data.mocap_quat[: self.drones] = self.recording["attitude"][entry]
        balls = self.balls[entry]
        self.data.mocap_pos[self.drones :] = np.where(np.isnan(balls), HIDDEN, balls)
        for drone in range(self.drones):
            colour = HIT if self.recording["hit"][entry, drone] else _colour(drone)
            for part in PAINTED:
                self.model.geom(f"drone{drone}_{part}").rgba[:3] = colour
        mujoco.mj_kinematics(self.model, self.data)

    def _camera(self, entry: int) -> mujoco.MjvCamera:
        camera = mujoco.MjvCamera()
        camera.type = mujoco.mjtCamera.mjCAMERA_FREE
        camera.lookat = self.centre[entry] + (0.0, self.view["ahead"], -0.2)
        camera.distance = self.view["distance"]
        camera.azimuth, camera.elevation = self.view["azimuth"], self.view["elevation"]
        return camera

    def _trail(self, entry: int, drone: int) -> None:
        """The drone's recent path, fading into the past."""
        stride = max(1, round(0.08 / float(self.recording["dt"])))
        length = round(self.view["trail"] / float(self.recording["dt"]))
        path = self.position[max(0, entry - length) : entry + 1][::-stride, drone]
        for k, (newer, older) in enumerate(pairwise(path)):
            self._line(newer, older, 0.018, (*_colour(drone), 0.8 * (1 - k / max(len(path) - 1, 1))))

    def _line(self, start: np.ndarray, end: np.ndarray, width: float, rgba: tuple[float, ...]) -> None:
        scene = self.renderer.scene
        if scene.ngeom == scene.maxgeom or (start == end).all():
            return
        geom = scene.geoms[scene.ngeom]
        mujoco.mjv_initGeom(
            geom, Shape.mjGEOM_CAPSULE, np.zeros(3), np.zeros(3), np.zeros(9), np.array(rgba, np.float32)
        )
        mujoco.mjv_connector(geom, Shape.mjGEOM_CAPSULE, width, start.astype(float), end.astype(float))
        scene.ngeom += 1


def _surroundings(spec: mujoco.MjSpec, width: int, height: int, fovy: float) -> None:
    """Sky, floor with a metre grid, light, and the size of the picture."""
    spec.visual.global_.offwidth, spec.visual.global_.offheight = width, height
    spec.visual.quality.offsamples = 0
    spec.visual.quality.shadowsize = 0
    spec.visual.quality.numslices, spec.visual.quality.numstacks = 14, 6
    spec.visual.global_.fovy = fovy
    spec.visual.headlight.ambient = (0.4, 0.4, 0.4)
    spec.visual.headlight.diffuse = (0.3, 0.3, 0.3)
    spec.visual.headlight.specular = (0.1, 0.1, 0.1)
    spec.visual.rgba.haze = (*HORIZON, 1)
    spec.visual.map.zfar, spec.visual.map.znear = 80, 0.05
    spec.stat.extent, spec.stat.center = 1.0, (0, 0, 0)
    texture, image = mujoco.mjtTexture, mujoco.mjtBuiltin
    spec.add_texture(
        name="sky",
        type=texture.mjTEXTURE_SKYBOX,
        builtin=image.mjBUILTIN_GRADIENT,
        rgb1=(0.62, 0.74, 0.88),
        rgb2=HORIZON,
        width=256,
        height=1536,
    )
    floor = spec.add_texture(
        name="grid",
        type=texture.mjTEXTURE_2D,
        builtin=image.mjBUILTIN_CHECKER,
        rgb1=(0.90, 0.91, 0.92),
        rgb2=(0.85, 0.86, 0.88),
        width=256,
        height=256,
    )
    floor.mark, floor.markrgb = mujoco.mjtMark.mjMARK_EDGE, (0.74, 0.76, 0.80)
    material = spec.add_material(
        name="floor", texrepeat=(0.5, 0.5), texuniform=True, emission=0.35, specular=0, reflectance=0
    )
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "grid"
    spec.add_material(name="bright", emission=0.4)
    spec.worldbody.add_geom(name="floor", type=Shape.mjGEOM_PLANE, size=(0, 0, 1), material="floor")
    spec.worldbody.add_light(
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=(0, 0, 20),
        dir=(0.4, 0.5, -1),
        diffuse=(0.55, 0.55, 0.55),
        castshadow=False,
    )


def _add_drone(spec: mujoco.MjSpec, name: str, scale: float) -> None:
    """A quadrotor as a body to place: a hub and rotor discs in the drone's colour, arms, and a white nose at +x."""
    dark = (0.13, 0.14, 0.17, 1.0)
    body = spec.worldbody.add_body(name=name, mocap=True)
    hub = scale * np.array((0.019, 0.019, 0.012))
    body.add_geom(name=f"{name}_hub", type=Shape.mjGEOM_ELLIPSOID, size=hub, rgba=(1, 1, 1, 1), material="bright")
    for k in range(4):
        turn = math.pi / 4 + k * math.pi / 2
        tip = scale * ARM * np.array((math.cos(turn), math.sin(turn), 0.0))
        body.add_geom(type=Shape.mjGEOM_CAPSULE, fromto=(0, 0, 0, *tip), size=(scale * 0.004, 0, 0), rgba=dark)
        body.add_geom(
            name=f"{name}_rotor{k}",
            type=Shape.mjGEOM_CYLINDER,
            pos=tip + np.array((0.0, 0.0, scale * 0.008)),
            size=scale * np.array((0.023, 0.0015, 0.0)),
            rgba=(1, 1, 1, 0.8),
            material="bright",
        )
    nose = scale * np.array((0.024, 0.0, 0.002))
    body.add_geom(type=Shape.mjGEOM_SPHERE, pos=nose, size=(scale * 0.006, 0, 0), rgba=(0.98, 0.98, 0.98, 1))


def _colour(drone: int) -> tuple[float, float, float]:
    return DRONE_COLOURS[drone % len(DRONE_COLOURS)]


def _smooth(path: np.ndarray, half: int) -> np.ndarray:
    """Moving average (T, 3) over ``2 half + 1`` entries, so that the camera glides."""
    window = 2 * half + 1
    padded = np.concatenate((path[:1].repeat(half, 0), path, path[-1:].repeat(half, 0)))
    total = np.cumsum(np.concatenate((np.zeros((1, 3)), padded)), 0)
    return np.asarray((total[window:] - total[:-window]) / window)
