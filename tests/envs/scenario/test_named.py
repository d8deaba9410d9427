"""What a scene names: every file and every material, with its key."""

from dataclasses import replace

from envs.scenario import GeomCfg, ObjectCfg, SurfaceMaterial
from envs.scenario.named import named
from envs.scenario.units import AssetRef, MaterialName
from envs.tasks.make import make_task

SCENE = make_task("PickCube").scenario
MUG = GeomCfg(shape="mesh", size=(1.0, 1.0, 1.0), mesh="mug.obj", texture="mug.png", mass_kg=0.1)


def test_files_of_robots_objects_and_furniture_are_found() -> None:
    chair = replace(MUG, mesh="chair.obj", texture=None)
    scene = replace(
        SCENE,
        objects=(ObjectCfg(name="mug", geoms=(MUG,)), ObjectCfg(name="box", mjcf="box.xml")),
        appearance=replace(SCENE.appearance, furniture={"wall0/0": (chair,)}),
    )
    found = dict(named(scene, AssetRef))
    robot = SCENE.robots[0]
    assert found == {
        "scenario.robots.franka.mjcf": robot.mjcf,
        "scenario.robots.franka.gripper_mjcf": robot.gripper_mjcf,
        "scenario.objects.mug.geoms.0.mesh": "mug.obj",
        "scenario.objects.mug.geoms.0.texture": "mug.png",
        "scenario.objects.box.mjcf": "box.xml",
        "scenario.appearance.furniture.wall0/0.0.mesh": "chair.obj",
    }


def test_materials_are_no_files() -> None:
    materials = {"table": SurfaceMaterial(texture="wood-017"), "wall": SurfaceMaterial()}
    appearance = replace(SCENE.appearance, materials=materials)
    assert dict(named(appearance, MaterialName, "look")) == {"look.materials.table.texture": "wood-017"}
    assert not list(named(appearance, AssetRef))
