import math

import numpy as np
import pytest
import torch

from envs.core.errors import UnknownNameError
from envs.rotations import from_yaw
from envs.scenario import GeomCfg, LinkCfg, ObjectCfg, ObjectJointCfg, ScenarioCfg
from envs.state import EntityState, State
from roboverse_learn.data.augmentation.references import References


def door(kind):
    """A door half a metre beside its frame's origin, at the end of its link's y axis."""
    geom = GeomCfg(shape="box", size=(0.1, 0.1, 0.1), mass_kg=1.0)
    joint = ObjectJointCfg(kind=kind, axis=(0.0, 0.0, 1.0), range=(-3.0, 3.0))
    link = LinkCfg(name="door", geoms=(geom,), joint=joint, pos=(0.5, 0.0, 0.0))
    return ObjectCfg(name="cupboard", geoms=(geom,), links=(link,), kind="fixed")


def state(joint_pos):
    count = len(joint_pos)
    root = EntityState.at_rest(np.array([[1.0, 0.0, 0.0]] * count), from_yaw(np.full(count, math.pi / 2)))
    root.joint_pos = torch.tensor(joint_pos, dtype=torch.float64)[:, None]
    return State({}, {"cupboard": root})


def test_hinged_part_turns_about_its_joint():
    references = References(ScenarioCfg(robots=(), objects=(door("hinge"),)))
    found = references.pose(state([0.0, math.pi / 2]), "cupboard/door")
    np.testing.assert_allclose(found.pos, [[1.0, 0.5, 0.0]] * 2, atol=1e-12)
    np.testing.assert_allclose(np.abs(found.rot[1] @ from_yaw(math.pi)), 1.0)


def test_sliding_part_moves_along_its_joint():
    references = References(ScenarioCfg(robots=(), objects=(door("slide"),)))
    found = references.pose(state([0.0, 0.25]), "cupboard/door")
    np.testing.assert_allclose(found.pos, [[1.0, 0.5, 0.0], [1.0, 0.5, 0.25]], atol=1e-12)


def test_object_is_where_its_root_is():
    references = References(ScenarioCfg(robots=(), objects=(door("hinge"),)))
    assert references.pose(state([0.3]), "cupboard").pos.tolist() == [[1.0, 0.0, 0.0]]
    assert references.movable == () and list(references.parts) == ["cupboard/door"]


def test_unknown_reference_suggests_the_nearest():
    references = References(ScenarioCfg(robots=(), objects=(door("hinge"),)))
    with pytest.raises(UnknownNameError, match="Did you mean 'cupboard/door'"):
        references.pose(state([0.0]), "cupboard/doors")
