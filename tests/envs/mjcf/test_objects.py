"""Objects in MuJoCo models: articulated, fixed, read from a file; and cameras that are carried."""

import dataclasses
import math

import numpy as np
import pytest
import torch
from PIL import Image

from envs.core.errors import ConfigError, UnknownNameError
from envs.robots.franka import FRANKA
from envs.scenario import CameraCfg, GeomCfg, LinkCfg, ObjectCfg, ObjectJointCfg, ScenarioCfg
from envs.simulators.mujoco.handler import MujocoHandler
from envs.state import EntityState, State

HINGE = ObjectJointCfg(kind="hinge", axis=(0.0, 1.0, 0.0), range=(-2.0, 2.0), default=0.5)
SLIDE = ObjectJointCfg(kind="slide", axis=(1.0, 0.0, 0.0), range=(0.0, 0.4))
PART = GeomCfg(shape="box", size=(0.1, 0.02, 0.02), mass_kg=1.0, pos=(0.1, 0.0, 0.0))
DOOR = ObjectCfg(
    name="door",
    kind="fixed",
    links=(
        LinkCfg(name="leaf", geoms=(PART,), joint=HINGE),
        LinkCfg(name="bolt", geoms=(PART,), joint=SLIDE, pos=(0.0, 0.5, 0.0)),
    ),
    pos=(0.0, 0.0, 1.0),
)
WRIST = CameraCfg(
    name="wrist",
    mount="franka/gripper/eef",
    pos=(0.05, 0.0, 0.0),
    look_at=(0.0, 0.0, 0.1),
    up=(1.0, 0.0, 0.0),
)


def launched(*objects, robots=(), cameras=(), num_envs=2):
    scenario = ScenarioCfg(robots=robots, objects=objects, cameras=cameras, table=None, room=None)
    handler = MujocoHandler(scenario, num_envs)
    handler.launch()
    return handler


def state_of(pos, joints, count=2):
    rest = EntityState.at_rest(
        np.array(pos), np.tile([1.0, 0, 0, 0], (count, 1)), np.tile(joints, (count, 1))
    )
    return State({}, {"door": rest})


def test_joints_begin_at_their_defaults_in_the_order_of_the_links():
    with launched(DOOR) as handler:
        assert DOOR.joint_names == ("leaf", "bolt")
        door = handler.get_states().objects["door"]
        assert torch.equal(door.joint_pos, torch.tensor([[0.5, 0.0]] * 2, dtype=torch.float64))
        assert torch.equal(door.pos, torch.tensor([[0.0, 0.0, 1.0]] * 2, dtype=torch.float64))


def test_fixed_object_keeps_the_pose_of_each_environment():
    with launched(DOOR) as handler:
        states = state_of((0.0, 0.0, 1.0), (0.25, 0.1))
        states.objects["door"].pos[1] = torch.tensor([1.0, 2.0, 3.0])
        handler.set_states(states)
        handler.step(10)
        assert torch.equal(handler.get_states().objects["door"].pos, states.objects["door"].pos)


def test_a_hanging_leaf_swings_with_the_period_of_its_pendulum():
    """A bar of 1 kg, centre 0.1 m below: I = m (a² + c²) / 3 + m d² about the hinge, T = 2π √(I / m g d)."""
    with launched(DOOR) as handler:
        inertia = (0.1**2 + 0.02**2) / 3 + 0.1**2
        period = 2 * math.pi * math.sqrt(inertia / (9.81 * 0.1))
        handler.set_states(state_of((0.0, 0.0, 1.0), (math.pi / 2 + 0.02, 0.0)))
        steps = round(period / 2 / handler.scenario.physics.timestep_s)
        handler.step(steps)
        swung = handler.get_states().objects["door"].joint_pos[0, 0]
        assert swung == pytest.approx(math.pi / 2 - 0.02, abs=2e-3)


def test_a_state_with_the_wrong_number_of_joints_is_refused():
    with (
        launched(DOOR) as handler,
        pytest.raises(ConfigError, match="'door' has 2 joints; the state gives 1"),
    ):
        handler.set_states(state_of((0.0, 0.0, 1.0), (0.1,)))


def test_poses_are_set_in_mid_episode_and_nothing_else_changes():
    with launched(DOOR) as handler:
        handler.set_states(state_of((0.0, 0.0, 1.0), (0.3, 0.2)))
        before = handler.get_states().objects["door"]
        quat = torch.tensor([[0.0, 0.0, 0.0, 1.0]], dtype=torch.float64)
        handler.set_poses({"door": (torch.tensor([[0.5, 0.0, 1.0]], dtype=torch.float64), quat)}, [1])
        after = handler.get_states().objects["door"]
        assert torch.equal(after.pos[0], before.pos[0])
        assert after.pos[1].tolist() == [0.5, 0.0, 1.0]
        assert torch.equal(after.joint_pos, before.joint_pos)
        with pytest.raises(
            UnknownNameError, match=r"Unknown fixed object or marker 'dor'.*Did you mean 'door'"
        ):
            handler.set_poses({"dor": (before.pos, before.rot)})


def test_an_object_of_a_file_brings_its_geoms():
    nut = ObjectCfg(name="nut", mjcf="robosuite:models/assets/objects/square-nut.xml", mjcf_root="object")
    with launched(nut) as handler:
        handler.step(1)
        body = handler.model.body("nut/object")
        assert handler.model.body(int(body.parentid[0])).name == "nut"
        assert handler.get_states().objects["nut"].joint_pos.shape == (2, 0)
        assert float(handler.model.body_subtreemass[handler.model.body("nut").id]) > 0


@pytest.mark.parametrize(("radians", "turn_deg"), [(True, 45.0), (False, 0.785398)])
def test_angles_of_a_part_that_leaves_their_unit_to_its_assembly(radians, turn_deg):
    """The round nut's ring is made of eight boxes; the fifth says ``axisangle="0 0 1 0.785398"``."""
    nut = ObjectCfg(
        name="nut",
        mjcf="robosuite:models/assets/objects/round-nut.xml",
        mjcf_root="object",
        mjcf_radians=radians,
    )
    with launched(nut) as handler:
        first = int(handler.model.body("nut/object").geomadr[0])
        turn = 2 * np.arccos(handler.model.geom_quat[first + 4][0])
        assert np.rad2deg(turn) == pytest.approx(turn_deg, abs=1e-3)


def test_a_file_without_the_named_body_or_joint_is_refused():
    nut = ObjectCfg(name="nut", mjcf="robosuite:models/assets/objects/square-nut.xml", mjcf_root="objekt")
    with pytest.raises(ConfigError, match=r"has no body 'objekt'. Its bodies: .*object"):
        launched(nut)
    hinged = dataclasses.replace(nut, mjcf_root="object", mjcf_joints=("hinge",))
    with pytest.raises(ConfigError, match="has no joint 'hinge'"):
        launched(hinged)


def test_a_mesh_falls_as_its_convex_hull(tmp_path):
    import trimesh

    path = tmp_path / "cube.obj"
    trimesh.creation.box((1.0, 1.0, 1.0)).export(path)
    mesh = GeomCfg(shape="mesh", mesh=str(path), size=(0.1, 0.1, 0.2), mass_kg=0.5)
    with launched(ObjectCfg(name="brick", geoms=(mesh,), pos=(0.0, 0.0, 0.11))) as handler:
        handler.step(400)
        assert handler.get_states().objects["brick"].pos[0, 2] == pytest.approx(0.1, abs=2e-3)


@pytest.mark.slow
def test_a_carried_camera_moves_with_the_hand():
    with launched(robots=(FRANKA,), cameras=(WRIST,)) as handler:
        model = handler.model
        camera = model.camera("wrist")
        assert model.body(int(camera.bodyid[0])).name == "franka/gripper/eef"
        first = handler.render(["wrist"])["wrist"]["rgb"]
        assert first.shape == (2, 256, 256, 3)
    unknown = dataclasses.replace(WRIST, mount="franka/gripper/eff")
    with pytest.raises(UnknownNameError, match=r"Unknown body that carries the camera 'wrist'.*Did you mean"):
        launched(robots=(FRANKA,), cameras=(unknown,))


TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\nf 1/1 4/2 2/3\n"


def test_a_large_texture_is_reduced(tmp_path):
    (tmp_path / "part.obj").write_text(TRIANGLE + "f 1/1 3/2 4/3\nf 2/1 4/2 3/3\n")
    Image.new("RGB", (2048, 1024), (200, 30, 10)).save(tmp_path / "large.png")
    seen = GeomCfg(
        shape="mesh",
        size=(0.1, 0.1, 0.1),
        mesh=str(tmp_path / "part.obj"),
        texture=str(tmp_path / "large.png"),
        collides=False,
    )
    with launched(ObjectCfg(name="part", kind="fixed", geoms=(seen,))) as handler:
        texture = handler.model.texture("part")
        assert (texture.width[0], texture.height[0], texture.nchannel[0]) == (512, 256, 3)
        first = texture.adr[0]
        assert handler.model.tex_data[first : first + 3].tolist() == [200, 30, 10]


@pytest.mark.parametrize("kind", ["words", "half an image"])
def test_texture_that_is_no_image_is_an_error(tmp_path, kind):
    (tmp_path / "part.obj").write_text(TRIANGLE)
    path = tmp_path / "words.png"
    path.write_text("no image")
    if kind == "half an image":
        Image.effect_noise((64, 64), 80.0).save(path)
        path.write_bytes(path.read_bytes()[:2000])
    seen = GeomCfg(
        shape="mesh",
        size=(0.1, 0.1, 0.1),
        mesh=str(tmp_path / "part.obj"),
        texture=str(tmp_path / "words.png"),
    )
    with pytest.raises(ConfigError, match=r"texture '.*words\.png' is not an image that can be read"):
        launched(ObjectCfg(name="part", kind="fixed", geoms=(seen,)))
