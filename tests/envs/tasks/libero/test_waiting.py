"""The arm at the beginning of an evaluation, against LeRobot's own environment of LIBERO."""

import json
from pathlib import Path

import numpy as np
import pytest

from envs.spec import EnvSpec
from envs.tasks.libero.native import CAMERAS
from envs.tasks.protocols import PROTOCOLS
from tests.robot_files import needs_files_of_task

ORIGINAL = json.loads((Path(__file__).parent / "original_starts.json").read_text())
"""Of ``docs/generate/libero_starts.py``: states of some starts, and images of the first, 16 pixels wide."""

STATES = np.array(ORIGINAL["states"])
KWARGS = dict(PROTOCOLS.get("libero").env["task_kwargs"])


@pytest.fixture(scope="module")
def env():
    needs_files_of_task(ORIGINAL["task"])
    spec = EnvSpec(task=ORIGINAL["task"], task_kwargs=KWARGS, cameras=("image", "image2"), image_size=64)
    env = spec.make(len(STATES), split="test", num_threads=1)
    env.reset_envs(np.arange(len(STATES)), env.split_indices[: len(STATES)])
    yield env
    env.close()


@pytest.mark.slow
def test_episodes_begin_with_the_arm_where_lerobots_environment_has_it(env):
    state = env.observe()["observation.state"]
    np.testing.assert_allclose(state[:, :3], STATES[:, :3], rtol=0, atol=2e-4)
    np.testing.assert_allclose(state[:, 3:6], STATES[:, 3:6], rtol=0, atol=1e-3)
    np.testing.assert_allclose(state[:, 6:], STATES[:, 6:], rtol=0, atol=2e-4)
    assert not env.get_states().robots["franka"].joint_vel.any(), "an episode begins at rest"


@pytest.mark.slow
def test_a_start_without_the_native_actions_is_that_of_the_file():
    needs_files_of_task(ORIGINAL["task"])
    ours = EnvSpec(task=ORIGINAL["task"], task_kwargs={"starts": "libero"}).make_task().fixed_start(0)
    theirs = EnvSpec(task=ORIGINAL["task"], task_kwargs=KWARGS).make_task().fixed_start(0)
    joints = [each.robots["franka"].joint_pos[0].numpy() for each in (ours, theirs)]
    assert 0.01 < np.abs(joints[0] - joints[1])[:7].max() < 0.1
    assert joints[1][7] > 0.038 > joints[0][7], "the file has the hand half open"


@pytest.mark.slow
def test_images_are_lerobots_in_place_orientation_and_brightness(env):
    seen = env.observe()
    for name in CAMERAS.values():
        image = seen[f"observation.images.{name}"][0]
        ours = image.reshape(16, 4, 16, 4, 3).mean(axis=(1, 3))
        theirs = np.array(ORIGINAL["images"][name], float)
        distance = np.abs(ours - theirs).mean()
        assert distance < 25 and abs(ours.mean() - theirs.mean()) < 20
        turned = [ours[::-1], ours[:, ::-1], ours[::-1, ::-1], ours.transpose(1, 0, 2), ours[..., ::-1]]
        assert distance < min(np.abs(each - theirs).mean() for each in turned)
