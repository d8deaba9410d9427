"""Converted robots as SAPIEN and Genesis load them, without their renderers."""

import importlib
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path
from typing import Any, override

import numpy as np

from docs.generate.conversion.readers import Poses, Reader
from envs.core.errors import SimulatorError
from envs.mjcf.link_tree import Inertia
from envs.rotations import from_matrix, multiply


def _without(path: Path, *tags: str) -> ET.Element:
    """Returns a URDF's root without the elements of these names, right below it or in its links."""
    root = ET.parse(path).getroot()
    for parent in (root, *root.iter("link")):
        for tag in tags:
            for child in parent.findall(tag):
                parent.remove(child)
    return root


class SapienReader(Reader):
    """SAPIEN's loader of URDF, on PhysX; visuals are left out, since they need a Vulkan device."""

    def __init__(self, path: Path) -> None:
        import sapien
        import sapien.physx
        from sapien.wrapper.urdf_loader import URDFLoader

        self._scene = sapien.Scene([sapien.physx.PhysxCpuSystem()])
        root = _without(path, "visual")
        for mesh in root.iter("mesh"):
            mesh.set("filename", str(path.parent / str(mesh.get("filename"))))
        loader = URDFLoader()
        loader.set_scene(self._scene)
        loader.fix_root_link = False
        stripped = path.with_name(f".{path.stem}-sapien.urdf")
        ET.ElementTree(root).write(stripped)
        try:
            builders, actors, _ = loader.parse(str(stripped))
        finally:
            stripped.unlink()
        if len(builders) == 1:
            self._robot = builders[0].build()
            self._links = {link.name: link for link in self._robot.links}
            self._order = [joint.name for joint in self._robot.active_joints]
        else:  # a single link becomes a body of its own
            from sapien.physx import PhysxRigidDynamicComponent

            self._robot, self._order = None, []
            body = actors[0].build().find_component_by_type(PhysxRigidDynamicComponent)
            self._links = {next(iter(root.iter("link"))).get("name"): body}

    @override
    def poses(self, joints: Mapping[str, float]) -> Poses:
        if self._robot is not None:
            self._robot.set_qpos(np.array([joints[name] for name in self._order], np.float32))
        found = {}
        for name, link in self._links.items():
            pose = link.entity.pose
            found[name] = (pose.p.astype(np.float64), pose.q.astype(np.float64))
        return found

    @override
    def inertials(self) -> dict[str, Inertia]:
        found = {}
        for name, link in self._links.items():
            com = link.cmass_local_pose
            found[name] = Inertia(
                float(link.mass), com.p.astype(float), com.q.astype(float), np.array(link.inertia, float)
            )
        return found

    @override
    def close(self) -> None:
        self._robot, self._links = None, {}


class GenesisReader(Reader):
    """Genesis's loader of URDF, without shapes.

    Genesis adds an element ``<mujoco>`` of its own to what it reads; a file that has one already is read by
    an older parser, with a warning. So it is left out here, and may be left out by whoever loads the file.
    """

    def __init__(self, path: Path) -> None:
        gs: Any = importlib.import_module("genesis")
        if not gs._initialized:
            gs.init(backend=gs.cpu, logging_level="error")
        root = _without(path, "mujoco", "visual", "collision")
        stripped = path.with_name(f".{path.stem}-genesis.urdf")
        ET.ElementTree(root).write(stripped)
        try:
            self._scene = gs.Scene(
                show_viewer=False, rigid_options=gs.options.RigidOptions(enable_collision=False)
            )
            self._robot = self._scene.add_entity(
                gs.morphs.URDF(file=str(stripped), fixed=False, merge_fixed_links=False, align=False)
            )
            self._scene.build()
        except gs.GenesisException as error:
            raise SimulatorError(str(error)) from error
        finally:
            stripped.unlink()
        self._order = {joint.name: joint.qs_idx_local[0] for joint in self._robot.joints if joint.n_dofs == 1}
        self._rest = self._robot.get_qpos().cpu().numpy().copy()

    @override
    def poses(self, joints: Mapping[str, float]) -> Poses:
        qpos = self._rest.copy()
        for name, index in self._order.items():
            qpos[index] = joints[name]
        self._robot.set_qpos(qpos)
        places = self._robot.get_links_pos().cpu().numpy().astype(np.float64)
        turns = self._robot.get_links_quat().cpu().numpy().astype(np.float64)
        return {link.name: (places[i], turns[i]) for i, link in enumerate(self._robot.links)}

    @override
    def inertials(self) -> dict[str, Inertia]:
        robot, found = self._robot, {}
        masses, centres = robot.get_links_mass().cpu().numpy(), robot.get_links_COM().cpu().numpy()
        matrices = robot.get_links_inertia().cpu().numpy().astype(np.float64)
        for index, link in enumerate(robot.links):
            moments, axes = np.linalg.eigh(matrices[index])
            axes[:, 0] *= np.sign(np.linalg.det(axes))
            turn = multiply(np.array(link.desc.inertial_quat, np.float64), from_matrix(axes))
            found[link.name] = Inertia(float(masses[index]), centres[index].astype(np.float64), turn, moments)
        return found
