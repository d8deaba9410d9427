"""One environment in PhysX: the trees of a scene as rigid bodies and articulations."""

import threading
from typing import override

import mujoco
import numpy as np
import sapien
from sapien import Pose, physx

from envs.mjcf.link_tree import SceneSpec
from envs.simulators.sapien.bodies import Part
from envs.simulators.sapien.builder import TreeBuilder, add_entity
from envs.simulators.sapien.settings import SapienSettings
from envs.simulators.sapien.shapes import ShapeFactory
from envs.simulators.translated_handler import World

_BUILDING = threading.Lock()


class SapienWorld(World):
    """A physics system of its own, and its dynamic bodies.

    PhysX keeps contacts and their order from step to step, so that the future depends on more than on what
    can be read or set. Where that would show, at the first step after a state was set, the system is made
    anew; setting a state and drawing it costs nothing.

    Args:
        model: The compiled model.
        spec: What was read of it.
        groups: Words of each geom's shape, (ngeom, 4), which say what touches what.
        settings: Options of PhysX.
    """

    def __init__(
        self, model: mujoco.MjModel, spec: SceneSpec, groups: np.ndarray, settings: SapienSettings
    ) -> None:
        self._model, self._spec, self._groups, self._settings = model, spec, groups, settings
        self._mocap: tuple[np.ndarray, np.ndarray] | None = None
        self._put: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
        self._build()

    @property
    def native(self) -> sapien.Scene:
        """SAPIEN's scene, until the world is rebuilt."""
        return self._scene

    def _build(self) -> None:
        with _BUILDING:  # PhysX's options belong to the process, and are read when something is made
            _configure(self._settings, self._model.opt.gravity)
            self._build_scene()
        self._has_stepped = False

    def _build_scene(self) -> None:
        self._scene = sapien.Scene([physx.PhysxCpuSystem()])
        self._system = self._scene.physx_system
        self._system.timestep = self._model.opt.timestep
        shapes = ShapeFactory(self._model, self._groups)
        if self._spec.still:
            component = physx.PhysxRigidStaticComponent()
            for geom, frame in self._spec.still:
                component.attach(shapes.make(geom, frame))
            add_entity(self._scene, component, "world", Pose())
        build = TreeBuilder(self._scene, shapes, self._settings)
        self._parts: list[Part] = []
        for tree in self._spec.trees:
            if any(link.geoms for link in tree.links) or tree.root != "mocap" or len(tree.links) > 1:
                self._parts += build.parts(tree)
        self._pushing = [part for part in self._parts if part.has_own_force]

    @override
    def put(self, qpos: np.ndarray, qvel: np.ndarray, ctrl: np.ndarray) -> None:
        self._put = qpos.copy(), qvel.copy(), ctrl.copy()

    def _settle(self) -> None:
        """Takes up the state that was put."""
        if self._put is None:
            return
        if self._has_stepped:
            self._scene.clear()
            self._build()
        if self._mocap is not None:
            for part in self._parts:
                part.place(*self._mocap)
        qpos, qvel, ctrl = self._put
        for part in self._parts:
            part.put(qpos, qvel)
            part.drive(ctrl)
        self._put = None

    @override
    def place(self, mocap_pos: np.ndarray, mocap_quat: np.ndarray) -> None:
        self._mocap = mocap_pos.copy(), mocap_quat.copy()
        if self._put is None:
            for part in self._parts:
                part.place(*self._mocap)

    @override
    def drive(self, ctrl: np.ndarray) -> None:
        self._settle()
        for part in self._parts:
            part.drive(ctrl)

    @override
    def step(self, num_steps: int) -> None:
        self._settle()
        self._has_stepped = True
        step = self._system.step
        if not self._pushing:
            for _ in range(num_steps):
                step()
            return
        for _ in range(num_steps):
            for part in self._pushing:
                part.push()
            step()

    @override
    def read(self, qpos: np.ndarray, qvel: np.ndarray) -> None:
        for part in self._parts:
            part.read(qpos, qvel)

    @override
    def close(self) -> None:
        self._parts = self._pushing = []
        self._scene.clear()


def _configure(settings: SapienSettings, gravity: np.ndarray) -> None:
    """Sets PhysX's options for the scenes and shapes that this process makes from now on."""
    physx.set_scene_config(
        gravity=np.asarray(gravity, np.float32),
        bounce_threshold=settings.bounce_threshold,
        enable_enhanced_determinism=True,
    )
    physx.set_shape_config(contact_offset=settings.contact_offset_m, rest_offset=0.0)
