"""Boxes hold their geoms, and no pixel that they can change is left out."""

import mujoco
import numpy as np
import pytest

from envs.simulators.mujoco.moving_parts import Boxes, CameraPlane, LightPlane, can_move

MODEL = """
<mujoco>
  <asset>
    <mesh name="wedge" vertex="0 0 0  0.3 0 0  0 0.1 0  0 0 0.05  0.2 0.02 0.04"/>
  </asset>
  <worldbody>
    <body><geom size="0.1"/></body>
    <body>
      <freejoint/>
      <geom type="mesh" mesh="wedge"/>
      <body><geom type="capsule" size="0.05 0.2" pos="0.1 0 0"/></body>
    </body>
    <body mocap="true"><geom type="box" size="0.1 0.2 0.3"/></body>
  </worldbody>
</mujoco>
"""

SIZE = 24
"""Pixels along a side of the camera's image."""


def test_bodies_with_a_joint_above_them_and_placed_ones_can_move():
    assert can_move(mujoco.MjModel.from_xml_string(MODEL)).tolist() == [False, False, True, True, True]


def scene(rng):
    model = mujoco.MjModel.from_xml_string(MODEL)
    data = mujoco.MjData(model)
    data.qpos[:], data.mocap_pos[:], data.mocap_quat[:] = rng.normal(size=7), rng.normal(size=3), (1, 2, 3, 4)
    mujoco.mj_kinematics(model, data)
    return model, data


def aligned(low, high):
    """Corners of upright boxes, (B, 8, 3)."""
    ends = np.stack([low, high], axis=1)
    picks = np.stack(np.meshgrid(*3 * [(0, 1)]), axis=-1).reshape(8, 3)
    return ends[:, picks, np.arange(3)]


def test_boxes_hold_their_geoms():
    rng = np.random.default_rng(0)
    for _ in range(20):
        model, data = scene(rng)
        geoms = np.arange(model.ngeom)
        corners = Boxes(model, geoms).corners(data)
        assert corners.shape == (model.ngeom, 8, 3)
        for geom in geoms:
            axes, pos = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]
            low, high = ((box := (corners[geom] - pos) @ axes).min(axis=0), box.max(axis=0))
            if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
                assert (model.mesh_vert > low).all() and (model.mesh_vert < high).all()
                assert (high - low < np.ptp(model.mesh_vert, axis=0) + 0.01).all()
            else:
                assert (high - low > 2 * model.geom_size[geom][0]).all()


def camera(pos, rng):
    """The plane of a camera that looks to the origin, and the directions of its rays, (SIZE, SIZE, 3)."""
    away = pos if np.any(pos) else rng.normal(size=3)
    axes = np.linalg.qr(np.stack([away, *rng.normal(size=(2, 3))], axis=1))[0][:, [1, 2, 0]]
    axes[:, 2] *= np.sign(axes[:, 2] @ away)
    side = (np.arange(SIZE) + 0.5) / SIZE - 0.5
    rays = np.stack([*np.meshgrid(side, -side), -np.ones((SIZE, SIZE))], axis=-1)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    plane = CameraPlane.of(pos, axes, rays.astype(np.float32))
    assert plane is not None
    return plane, rays @ axes.T


def meet(pos, rays, low, high):
    """Which rays (…, 3) meet a box, by its slabs."""
    with np.errstate(divide="ignore"):
        ends = (np.stack([low, high]) - pos) / rays[..., None, :]
    enter, leave = ends.min(axis=-2).max(axis=-1), ends.max(axis=-2).min(axis=-1)
    return leave >= np.maximum(enter, 0.0)


def test_every_pixel_whose_ray_meets_a_box_is_touched_and_few_others():
    rng, num_met, num_touched = np.random.default_rng(1), 0, 0
    for _ in range(300):
        low = rng.normal(size=(3, 3))
        high = low + rng.uniform(0.0, 0.5, (3, 3))
        pos = 2.0 * rng.normal(size=3)
        plane, rays = camera(pos, rng)
        met = np.any([meet(pos, rays, *box) for box in zip(low, high, strict=True)], axis=0)
        touched = plane.touched(aligned(low, high))
        assert (touched | ~met).all()
        num_met, num_touched = num_met + met.sum(), num_touched + touched.sum()
    assert 3000 < num_met < num_touched < 0.1 * 300 * SIZE**2


def test_a_box_behind_a_camera_touches_nothing_and_one_round_it_everything():
    plane, rays = camera(np.zeros(3), np.random.default_rng(2))
    box = aligned(np.full((1, 3), -0.1), np.full((1, 3), 0.1))
    ahead = rays[SIZE // 2, SIZE // 2]
    assert plane.touched(box).all()
    assert not plane.touched(box - ahead).any()
    assert 0.0 < plane.touched(box + ahead).mean() < 0.2
    assert plane.touched(np.concatenate([box - ahead, box + ahead]))[SIZE // 2, SIZE // 2]
    assert not plane.touched(np.zeros((0, 8, 3))).any()


def test_rays_that_are_no_grid_have_no_plane():
    rays = np.random.default_rng(3).normal(size=(4, 4, 3)).astype(np.float32)
    assert CameraPlane.of(np.zeros(3), np.eye(3), rays) is None


@pytest.mark.parametrize("direction", [(0.0, 0.0, -1.0), (0.3, -0.2, -0.9), (1.0, 0.0, 0.0)])
def test_points_in_the_shadow_of_a_box_are_touched(direction):
    rng = np.random.default_rng(4)
    light = np.array(direction) / np.linalg.norm(direction)
    low = rng.normal(size=(3, 3))
    high = low + rng.uniform(0.0, 0.5, (3, 3))
    shaded = rng.uniform(low, high, (200, 3, 3)).reshape(-1, 3)
    shaded = shaded + rng.uniform(0.0, 3.0, (len(shaded), 1)) * light
    points = np.concatenate([shaded, rng.uniform(-4.0, 4.0, (2000, 3))])
    shown = np.ones(len(points), bool)
    shown[:10] = False  # these pixels show nothing
    touched = LightPlane.of(light, points, shown).touched(aligned(low, high))
    assert touched[10 : len(shaded)].all()
    assert not touched[:10].any()
    assert touched[len(shaded) :].mean() < 0.3


def test_an_image_of_nothing_lies_in_no_shadow():
    nothing = LightPlane.of(np.array([0.0, 0.0, -1.0]), np.zeros((5, 3)), np.zeros(5, bool))
    assert not nothing.touched(np.ones((1, 8, 3))).any()
