"""Writes USD with UsdPhysics: https://openusd.org/release/api/usd_physics_page_front.html.

Every link with a mass is a rigid body below the robot's prim; one without is a frame of the rigid body that
carries it. What UsdPhysics lacks is written under the names of MuJoCo, PhysX and Newton: armature, passive
damping and friction (``mjc:*``, ``physxJoint:armature``), mimic joints (``NewtonMimicAPI``).
USD has joint angles in degrees, and gains per degree.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from envs.convert.description import Description, Joint, Link, Material, Mesh, Shape
from envs.convert.obj import write_image
from envs.core.errors import MissingExtraError
from envs.core.extras import install_command
from envs.rotations import conjugate, multiply, rotate
from envs.scenario.units import IDENTITY

_AXIS_X = np.array([1.0, 0.0, 0.0])


def write_usd(description: Description, folder: Path) -> tuple[str, ...]:
    """Writes ``<name>.usd``, binary, and the images of its materials under ``textures/``.

    Args:
        description: The robot.
        folder: Where to; it exists.

    Returns:
        What only some programs read, one sentence each.

    Raises:
        MissingExtraError: if usd-core is not installed.
    """
    try:
        from pxr import Usd, UsdGeom, UsdPhysics
    except ModuleNotFoundError as error:
        raise MissingExtraError(
            "Writing USD needs the package 'usd-core', which is not installed. "
            f"Install it with: {install_command('usd')}"
        ) from error
    stage = Usd.Stage.CreateNew(str(folder / f"{description.name}.usd"))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    losses = _Writer(stage, description, folder).write()
    stage.GetRootLayer().Save()
    return losses


@dataclass(frozen=True, slots=True)
class _Placed:
    """A link's prim, its pose in the world, and the rigid body that it is part of, with its pose."""

    path: str
    pos: np.ndarray
    rot: np.ndarray
    body: str
    body_pos: np.ndarray
    body_rot: np.ndarray


class _Writer:
    def __init__(self, stage: Any, description: Description, folder: Path) -> None:
        from pxr import UsdGeom, UsdShade

        self.stage, self.description, self.folder = stage, description, folder
        self.root = f"/{identifier(description.name)}"
        self.taken: set[str] = set()
        self.placed: dict[str, _Placed] = {}
        self.joint_paths: dict[str, str] = {}
        self.materials: dict[int, Any] = {}
        stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, self.root).GetPrim())
        UsdGeom.Scope.Define(stage, f"{self.root}/joints")
        UsdGeom.Scope.Define(stage, f"{self.root}/materials")
        self._shading = UsdShade

    def write(self) -> tuple[str, ...]:
        from pxr import UsdPhysics

        UsdPhysics.ArticulationRootAPI.Apply(self.stage.GetPrimAtPath(self.root))
        for link in self.description.links:
            self._link(link)
        for link in self.description.links:
            self._joint(link)
        followers = [joint for joint in self.description.joints if joint.mimic is not None]
        for joint in followers:
            self._mimic(joint)
        if followers:
            names = ", ".join(joint.name for joint in followers)
            return (f"Joints that follow another ({names}) do so where NewtonMimicAPI is read.",)
        return ()

    def _link(self, link: Link) -> None:
        from pxr import UsdPhysics

        parent = self.placed.get(link.parent or "")
        pos, rot = link.pos, link.rot
        if parent is not None:
            pos, rot = parent.pos + rotate(parent.rot, pos), multiply(parent.rot, rot)
        rigid = link.inertial.mass > 0 or parent is None
        if rigid:
            path = self._define("Xform", self.root, link.name, pos, rot)
            self.placed[link.name] = _Placed(path, pos, rot, path, pos, rot)
        else:
            assert parent is not None
            path = self._define("Xform", parent.path, link.name, link.pos, link.rot)
            self.placed[link.name] = _Placed(path, pos, rot, parent.body, parent.body_pos, parent.body_rot)
        prim = self.stage.GetPrimAtPath(path)
        if link.inertial.mass > 0:
            UsdPhysics.RigidBodyAPI.Apply(prim)
            self._mass(prim, link)
        for shape in link.visuals:
            self._shape(path, shape, "visual")
        for shape in link.collisions:
            self._shape(path, shape, "collision")

    def _mass(self, prim: Any, link: Link) -> None:
        from pxr import Gf, UsdPhysics

        mass, inertial = UsdPhysics.MassAPI.Apply(prim), link.inertial
        mass.CreateMassAttr(inertial.mass)
        mass.CreateCenterOfMassAttr(Gf.Vec3f(*inertial.com.tolist()))
        mass.CreateDiagonalInertiaAttr(Gf.Vec3f(*inertial.moments.tolist()))
        mass.CreatePrincipalAxesAttr(Gf.Quatf(*inertial.rot.tolist()))

    def _shape(self, parent: str, shape: Shape, role: str) -> None:
        from pxr import UsdGeom, UsdPhysics

        if shape.kind == "mesh":
            assert shape.mesh is not None
            path = self._define("Mesh", parent, f"{role}_{shape.mesh.name}", shape.pos, shape.rot)
            self._mesh(path, shape.mesh)
        else:
            kind = {"box": "Cube"}.get(shape.kind, shape.kind.capitalize())
            scale = shape.size if shape.kind == "box" else None
            path = self._define(kind, parent, f"{role}_{shape.kind}", shape.pos, shape.rot, scale)
            prim = self.stage.GetPrimAtPath(path)
            if shape.kind != "box":
                prim.GetAttribute("radius").Set(shape.size[0])
            if shape.kind in ("cylinder", "capsule"):
                prim.GetAttribute("height").Set(2.0 * shape.size[1])
        prim = self.stage.GetPrimAtPath(path)
        if role == "visual":
            self._dress(prim, shape.material)
            return
        UsdPhysics.CollisionAPI.Apply(prim)
        if shape.kind == "mesh":
            UsdPhysics.MeshCollisionAPI.Apply(prim).CreateApproximationAttr(UsdPhysics.Tokens.convexHull)
        self._rub(prim, shape.friction)
        UsdGeom.Imageable(prim).CreatePurposeAttr(UsdGeom.Tokens.guide)

    def _mesh(self, path: str, mesh: Mesh) -> None:
        from pxr import Sdf, UsdGeom, Vt

        prim = UsdGeom.Mesh(self.stage.GetPrimAtPath(path))
        prim.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(mesh.vertices.astype(np.float32)))
        prim.CreateFaceVertexCountsAttr(Vt.IntArray(len(mesh.faces), 3))
        prim.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(mesh.faces.ravel().astype(np.int32)))
        prim.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        if mesh.normals is not None:
            values, corners = mesh.normals
            prim.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(values[corners.ravel()].astype(np.float32)))
            prim.SetNormalsInterpolation(UsdGeom.Tokens.faceVarying)
        if mesh.uvs is not None:
            values, corners = mesh.uvs
            variables = UsdGeom.PrimvarsAPI(prim)
            kind, varying = Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.faceVarying
            uv = variables.CreatePrimvar("st", kind, varying)
            uv.Set(Vt.Vec2fArray.FromNumpy(values.astype(np.float32)))
            uv.SetIndices(Vt.IntArray.FromNumpy(corners.ravel().astype(np.int32)))

    def _dress(self, prim: Any, material: Material) -> None:
        if id(material) not in self.materials:
            self.materials[id(material)] = self._material(material)
        binding = self._shading.MaterialBindingAPI.Apply(prim)
        binding.Bind(self.materials[id(material)])

    def _material(self, material: Material) -> Any:
        from pxr import Gf, Sdf

        shading = self._shading
        path = self._free(f"{self.root}/materials", material.name)
        made = shading.Material.Define(self.stage, path)
        surface = shading.Shader.Define(self.stage, f"{path}/surface")
        surface.CreateIdAttr("UsdPreviewSurface")
        kinds = Sdf.ValueTypeNames
        surface.CreateInput("roughness", kinds.Float).Set(material.roughness)
        surface.CreateInput("metallic", kinds.Float).Set(material.metallic)
        surface.CreateInput("opacity", kinds.Float).Set(material.rgba[3])
        colour = surface.CreateInput("diffuseColor", kinds.Color3f)
        colour.Set(Gf.Vec3f(*material.rgba[:3]))
        if material.image is not None:
            (self.folder / "textures").mkdir(exist_ok=True)
            name = f"textures/{path.rsplit('/', 1)[1]}.png"
            write_image(self.folder / name, material.image)
            reader = shading.Shader.Define(self.stage, f"{path}/coordinates")
            reader.CreateIdAttr("UsdPrimvarReader_float2")
            reader.CreateInput("varname", kinds.String).Set("st")
            found = reader.CreateOutput("result", kinds.Float2)
            image = shading.Shader.Define(self.stage, f"{path}/image")
            image.CreateIdAttr("UsdUVTexture")
            image.CreateInput("file", kinds.Asset).Set(name)
            image.CreateInput("scale", kinds.Float4).Set(Gf.Vec4f(*material.rgba[:3], 1.0))
            for wrap in ("wrapS", "wrapT"):
                image.CreateInput(wrap, kinds.Token).Set("repeat")
            image.CreateInput("st", kinds.Float2).ConnectToSource(found)
            colour.ConnectToSource(image.CreateOutput("rgb", kinds.Float3))
        made.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", kinds.Token))
        return made

    def _rub(self, prim: Any, friction: float) -> None:
        from pxr import UsdPhysics

        name = f"friction_{friction:g}".replace(".", "_").replace("-", "_")
        path = f"{self.root}/materials/{name}"
        made = self._shading.Material.Define(self.stage, path)
        surface = UsdPhysics.MaterialAPI.Apply(made.GetPrim())
        surface.CreateStaticFrictionAttr(friction)
        surface.CreateDynamicFrictionAttr(friction)
        binding = self._shading.MaterialBindingAPI.Apply(prim)
        binding.Bind(made, self._shading.Tokens.weakerThanDescendants, "physics")

    def _joint(self, link: Link) -> None:
        from pxr import Gf, UsdPhysics

        joint, child = link.joint, self.placed[link.name]
        if joint.kind == "free" or child.body != child.path:
            return
        if link.inertial.mass == 0:  # a root without a mass is the world itself
            return
        kinds = {
            "fixed": UsdPhysics.FixedJoint,
            "hinge": UsdPhysics.RevoluteJoint,
            "slide": UsdPhysics.PrismaticJoint,
            "ball": UsdPhysics.SphericalJoint,
        }
        path = self._free(f"{self.root}/joints", joint.name)
        made = kinds[joint.kind].Define(self.stage, path)
        self.joint_paths[joint.name] = path
        name_prim(made.GetPrim(), joint.name)
        parent = self.placed.get(link.parent or "")
        anchor_pos, anchor_rot = child.pos, child.rot
        # A USD joint moves about X, Y or Z of its frame: X, rotated onto the axis, is used.
        turn = _turn_x_onto(joint.axis) if joint.kind in ("hinge", "slide") else np.array(IDENTITY)
        if parent is not None:
            made.CreateBody0Rel().SetTargets([parent.body])
            back = conjugate(parent.body_rot)
            anchor_pos = rotate(back, child.pos - parent.body_pos)
            anchor_rot = multiply(back, child.rot)
        made.CreateBody1Rel().SetTargets([child.path])
        made.CreateLocalPos0Attr(Gf.Vec3f(*anchor_pos.tolist()))
        made.CreateLocalRot0Attr(Gf.Quatf(*multiply(anchor_rot, turn).tolist()))
        made.CreateLocalPos1Attr(Gf.Vec3f(0.0))
        made.CreateLocalRot1Attr(Gf.Quatf(*turn.tolist()))
        if joint.kind in ("hinge", "slide"):
            made.CreateAxisAttr(UsdPhysics.Tokens.x)
            self._limits_and_drive(made, joint)

    def _limits_and_drive(self, made: Any, joint: Joint) -> None:
        from pxr import Sdf, UsdPhysics

        unit = _unit(joint)
        if joint.range is not None:
            made.CreateLowerLimitAttr(joint.range[0] * unit)
            made.CreateUpperLimitAttr(joint.range[1] * unit)
        prim = made.GetPrim()
        drive = UsdPhysics.DriveAPI.Apply(prim, "angular" if joint.kind == "hinge" else "linear")
        drive.CreateTypeAttr(UsdPhysics.Tokens.force)
        drive.CreateStiffnessAttr(0.0 if joint.drive is None else joint.drive.kp / unit)
        drive.CreateDampingAttr(0.0 if joint.drive is None else joint.drive.kd / unit)
        if joint.max_force is not None:
            drive.CreateMaxForceAttr(joint.max_force)
        number = Sdf.ValueTypeNames.Double
        prim.AddAppliedSchema("MjcJointAPI")
        prim.AddAppliedSchema("PhysxJointAPI")
        prim.CreateAttribute("mjc:damping", number).Set(joint.damping)
        prim.CreateAttribute("mjc:frictionloss", number).Set(joint.friction)
        prim.CreateAttribute("mjc:armature", number).Set(joint.armature)
        prim.CreateAttribute("physxJoint:armature", Sdf.ValueTypeNames.Float).Set(joint.armature)

    def _mimic(self, joint: Joint) -> None:
        from pxr import Sdf

        assert joint.mimic is not None
        leader = next(other for other in self.description.joints if other.name == joint.mimic.joint)
        prim = self.stage.GetPrimAtPath(self.joint_paths[joint.name])
        prim.AddAppliedSchema("NewtonMimicAPI")
        prim.CreateRelationship("newton:mimicJoint").SetTargets([self.joint_paths[leader.name]])
        number = Sdf.ValueTypeNames.Float
        prim.CreateAttribute("newton:mimicCoef0", number).Set(joint.mimic.offset * _unit(joint))
        slope = joint.mimic.multiplier * _unit(joint) / _unit(leader)
        prim.CreateAttribute("newton:mimicCoef1", number).Set(slope)

    def _define(
        self,
        kind: str,
        parent: str,
        name: str,
        pos: np.ndarray,
        rot: np.ndarray,
        scale: tuple[float, ...] | None = None,
    ) -> str:
        from pxr import Gf, UsdGeom

        path = self._free(parent, name)
        prim = self.stage.DefinePrim(path, kind)
        name_prim(prim, name)
        placed = UsdGeom.Xformable(prim)
        double = UsdGeom.XformOp.PrecisionDouble
        placed.AddTranslateOp(double).Set(Gf.Vec3d(*pos.tolist()))
        placed.AddOrientOp(double).Set(Gf.Quatd(*(rot / np.linalg.norm(rot)).tolist()))
        if scale is not None:  # a cube's edge is 2
            placed.AddScaleOp(double).Set(Gf.Vec3d(*scale))
        return path

    def _free(self, parent: str, name: str) -> str:
        path, number = f"{parent}/{identifier(name)}", 2
        while path in self.taken:
            path, number = f"{parent}/{identifier(name)}_{number}", number + 1
        self.taken.add(path)
        return path


def identifier(name: str) -> str:
    """Returns the name as a valid USD identifier."""
    plain = re.sub(r"\W", "_", name, flags=re.ASCII)
    return f"_{plain}" if not plain or plain[0].isdigit() else plain


def name_prim(prim: Any, name: str) -> None:
    """Stores the source's name where the USD identifier differs."""
    prim.SetDisplayName(name)


def _unit(joint: Joint) -> float:
    """USD's unit of a joint's position per ours: degrees for a hinge, metres for a slide."""
    return 180.0 / np.pi if joint.kind == "hinge" else 1.0


def _turn_x_onto(axis: np.ndarray) -> np.ndarray:
    """Returns the shortest rotation (wxyz) of x onto a unit axis."""
    cosine = float(axis @ _AXIS_X)
    if cosine < -1.0 + 1e-12:
        return np.array([0.0, 0.0, 0.0, 1.0])
    quat = np.array([1.0 + cosine, *np.cross(_AXIS_X, axis)])
    return quat / np.linalg.norm(quat)
