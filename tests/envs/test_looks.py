"""Images of the four levels: visible changes, reproducible, each channel changing its own."""

import numpy as np
import pytest

import envs
from envs.randomization import LEVEL_CHANNELS, LEVELS

SIZE = 64
EPISODES = 8
SATURATED_SHARE = 0.05
"""At most so many pixels of an image may be clipped at white or black; the most seen is 0.01."""


def drawn(split="test", count=EPISODES, *, kinds=("rgb",), **options):
    """Images (n, H, W, …) by kind of the first episodes of a split, before anything moves."""
    env = envs.make_vec("PickCube", count, split=split, image_size=SIZE, **options)
    try:
        env.reset_envs(np.arange(count), env.split_indices[:count])
        images = env.handler.render(None, kinds)["front"]
        hashes = [env.initial_state_hash(i) for i in range(count)]
        names = env.handler.segmentation_names
        return images, hashes, names
    finally:
        env.close()


@pytest.fixture(scope="module")
def levels():
    return {level: drawn(level=level, kinds=("rgb", "segmentation")) for level in LEVELS}


@pytest.fixture(scope="module")
def channels():
    kinds = ("rgb", "depth", "segmentation")
    return {channel: drawn(only=channel, kinds=kinds) for channel in LEVEL_CHANNELS}


@pytest.mark.slow
@pytest.mark.parametrize("level", LEVELS)
def test_images_are_neither_black_nor_burnt(levels, level):
    rgb = levels[level][0]["rgb"].astype(float)
    means = rgb.mean(axis=(1, 2, 3))
    assert means.min() >= 15.0
    assert means.max() <= 235.0
    clipped = ((rgb >= 254.0).all(axis=-1) | (rgb <= 1.0).all(axis=-1)).mean(axis=(1, 2))
    assert clipped.max() <= SATURATED_SHARE
    assert rgb.std(axis=(1, 2, 3)).min() > 5.0


@pytest.mark.slow
@pytest.mark.parametrize("level", LEVELS)
def test_the_robot_is_in_every_image(levels, level):
    images, _, names = levels[level]
    robot = images["segmentation"] == names.index("franka")
    assert (robot.mean(axis=(1, 2)) > 0.02).all()


@pytest.mark.slow
@pytest.mark.parametrize("level", LEVELS)
def test_the_cube_is_seen_in_nearly_every_image(levels, level):
    images, _, names = levels[level]
    cube = images["segmentation"] == names.index("cube")
    assert (cube.sum(axis=(1, 2)) > 0).mean() >= 0.75


@pytest.mark.slow
def test_level_0_looks_the_same_in_every_episode(levels):
    """Where only table, wall and ground are seen, images of all episodes are nearly equal."""
    images, _, names = levels[0]
    still = np.isin(images["segmentation"], [names.index(n) for n in ("table", "wall", "ground")])
    everywhere = still.all(axis=0)
    assert everywhere.mean() > 0.3
    values = images["rgb"][:, everywhere].astype(float)
    # The arm's shadow moves with its start posture; everything else is bit-identical.
    assert np.median(values.std(axis=0)) == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("level", [1, 2, 3])
def test_higher_levels_look_different_in_every_episode(levels, level):
    rgb = levels[level][0]["rgb"]
    for first in range(EPISODES):
        for second in range(first):
            assert np.abs(rgb[first].astype(float) - rgb[second]).mean() > 2.0


@pytest.mark.slow
def test_images_are_the_same_again(levels):
    again, hashes, _ = drawn(level=3, kinds=("rgb", "segmentation"))
    np.testing.assert_array_equal(again["rgb"], levels[3][0]["rgb"])
    assert hashes == levels[3][1]


@pytest.mark.slow
def test_each_level_keeps_the_samples_of_the_last(levels, channels):
    """The start is the task channel's alone: at every level the robot and the cube begin alike."""
    np.testing.assert_array_equal(
        levels[0][0]["segmentation"] == levels[0][2].index("cube"),
        levels[1][0]["segmentation"] == levels[1][2].index("cube"),
    )
    np.testing.assert_array_equal(channels["environment"][0]["rgb"], levels[1][0]["rgb"])


@pytest.mark.slow
def test_hashes_differ_between_appearances(levels):
    every = [digest for level in LEVELS for digest in levels[level][1]]
    assert len(set(every)) == len(every)
    assert all(len(digest) == 16 and int(digest, 16) >= 0 for digest in every)


@pytest.mark.slow
def test_the_task_channel_alone_is_level_0(levels, channels):
    np.testing.assert_array_equal(channels["task"][0]["rgb"], levels[0][0]["rgb"])
    assert channels["task"][1] == levels[0][1]


@pytest.mark.slow
def test_lighting_alone_changes_colours_and_no_geometry(channels):
    plain, lit = channels["task"][0], channels["lighting"][0]
    np.testing.assert_array_equal(plain["depth"], lit["depth"])
    np.testing.assert_array_equal(plain["segmentation"], lit["segmentation"])
    assert np.abs(plain["rgb"].astype(float) - lit["rgb"]).mean() > 3.0


@pytest.mark.slow
def test_the_environment_alone_changes_surfaces_and_not_where_things_are(channels):
    names = channels["task"][2]
    plain, furnished = channels["task"][0], channels["environment"][0]
    for name in ("franka", "cube", "goal"):
        here, there = ((p["segmentation"] == names.index(name)) for p in (plain, furnished))
        np.testing.assert_array_equal(here, there, err_msg=name)
    cube = plain["segmentation"] == names.index("cube")
    apart = np.abs(plain["rgb"].astype(float) - furnished["rgb"])
    assert apart[cube].mean() < 1.0
    table = (plain["segmentation"] == names.index("table")) & (
        furnished["segmentation"] == names.index("table")
    )
    assert apart[table].mean() > 5.0


@pytest.mark.slow
def test_the_camera_alone_changes_the_view(channels):
    plain, moved = channels["task"][0], channels["camera"][0]
    for row in range(EPISODES):
        assert (plain["depth"][row] != moved["depth"][row]).mean() > 0.9


@pytest.mark.slow
def test_train_and_test_do_not_share_an_image():
    train, _, _ = drawn("train", 4, level=3)
    test, _, _ = drawn("test", 4, level=3)
    seen = {image.tobytes() for image in train["rgb"]}
    assert not seen & {image.tobytes() for image in test["rgb"]}


def test_sampled_values_are_json():
    import json

    env = envs.make_vec("PickCube", 1, split="test", level=3, image_size=SIZE)
    env.reset_envs([0], env.split_indices[3:4])
    draws = env.draws(0)
    env.close()
    assert json.loads(json.dumps(draws)) == draws
    assert set(draws) == {"environment", "camera", "lighting"}
    assert set(draws["environment"]["textures"]) == {"table", "wall", "ground"}
