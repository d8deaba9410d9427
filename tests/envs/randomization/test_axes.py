"""The axes robot, sensor and layout: frozen splits, draws, starts that are possible, physics that stays."""

import hashlib
import json
from itertools import pairwise

import numpy as np
import pytest
import torch

from envs.core.errors import ConfigError
from envs.core.json_values import to_json_values
from envs.experts.actor import expert_episodes
from envs.randomization import distractors, layout, robot_start, sensor
from envs.randomization.channels import divided
from envs.randomization.randomizer import Randomizer
from envs.scenario import Appearance
from envs.spec import EnvSpec
from envs.state import State
from envs.tasks import TASKS
from envs.tasks.make import in_scene

FROZEN = {"robot": "0cc978028fdcba66", "sensor": "bc4b989f1a6e3df4", "layout": "401a027712de6ecd"}
"""First digits of the SHA-256 of what each channel holds out; another list would be another axis."""


def cell_of(offsets):
    """The cell of the channel's grid that the offsets of an arm's joints are in."""
    shares = [(offset / robot_start.BOUND_RAD + 1.0) / 2.0 for offset in offsets[:2]]
    counts = robot_start.CELLS
    return tuple(min(int(share * count), count - 1) for share, count in zip(shares, counts, strict=False))


FROZEN_SHAPES = "92e078c3653f5c59"
"""The same of the shapes and colours of all distractors."""


def make(only, *, task="PickCube", split="train", num_envs=1, **options):
    spec = EnvSpec(task=task, only=only, image_size=32)
    return spec.make(num_envs, split=split, num_threads=1, observation="state", **options)


def drawn(only, split, count=1000):
    scenario = TASKS.get("PickCube")().scenario
    randomizer = Randomizer(Appearance(), (), channels=(only,), split=split, seed=0, scenario=scenario)
    return [randomizer.draws(int(episode))[only] for episode in randomizer.split.episodes[:count]]


@pytest.mark.parametrize(
    ("only", "held_out"),
    [
        ("robot", robot_start.cells("test")),
        ("sensor", divided(sensor.CELLS, "test")),
        ("layout", divided(distractors.CATALOGUE, "test")),
    ],
)
def test_what_is_held_out_is_frozen(only, held_out):
    digest = hashlib.sha256(json.dumps(held_out).encode()).hexdigest()
    assert digest.startswith(FROZEN[only]), (digest, held_out)


def test_the_catalogue_of_distractors_is_frozen():
    shapes = [to_json_values(distractors.distractor(name)) for name in distractors.CATALOGUE]
    assert hashlib.sha256(json.dumps(shapes).encode()).hexdigest()[:16] == FROZEN_SHAPES


@pytest.mark.parametrize(("count", "total"), [(7, 110), (1, 11)])
def test_cells_of_the_robots_posture_are_divided(count, total):
    train, test = (set(robot_start.cells(split, count)) for split in ("train", "test"))
    assert not train & test and len(train | test) == total
    assert len(test) == total // 10 and (5, 4) not in test and (5, 5) not in test


def test_no_posture_of_a_test_episode_is_in_a_cell_of_training():
    for split in ("train", "test"):
        offsets = [row for draw in drawn("robot", split, 300) for row in draw["offsets_rad"]]
        assert np.abs(offsets).max() <= robot_start.BOUND_RAD
        found = {cell_of(row) for row in offsets}
        assert found == set(robot_start.cells(split)), "all of the split's cells, and no other"


def test_no_test_episode_has_a_combination_of_disturbances_of_training():
    cells = {split: {draw["cell"] for draw in drawn("sensor", split)} for split in ("train", "test")}
    assert not cells["train"] & cells["test"]
    assert cells["train"] | cells["test"] == set(sensor.CELLS) and len(cells["test"]) == 8
    parts = {split: {part for cell in found for part in cell.split(" + ")} for split, found in cells.items()}
    assert parts["train"] >= parts["test"], "each part of a combination is in training"


def test_no_distractor_of_a_test_episode_is_in_training():
    names = {
        split: {item["name"] for draw in drawn("layout", split) for item in draw}
        for split in ("train", "test")
    }
    assert not names["train"] & names["test"]
    assert names["train"] | names["test"] == set(distractors.CATALOGUE) and len(names["test"]) == 3


def test_every_sensor_draw_is_its_cell():
    for draw in drawn("sensor", "train", 400):
        found, cell = draw["sensor"], draw["cell"]
        assert (found["gaussian_noise"] > 0) == ("gaussian noise" in cell)
        assert (found["shot_noise"] > 0) == ("shot noise" in cell)
        assert (found["blur_sigma"] > 0) == ("gaussian blur" in cell)
        assert (found["motion_length"] > 0) == ("motion blur" in cell)
        assert (found["jpeg_quality"] > 0) == ("no jpeg" not in cell)
        assert np.sign(found["exposure_ev"]) == {"dark": -1, "bright": 1}.get(cell.split(" + ")[-1], 0)


def test_distractors_are_low_and_of_their_stated_radius():
    for name in distractors.CATALOGUE:
        item = distractors.distractor(name)
        for geom in item.geoms:
            half = geom.size[2] if geom.shape == "box" else geom.size[-1]
            assert geom.pos[2] + half <= distractors.HEIGHT_M and geom.pos[2] - half >= -1e-9
        assert 0.02 < item.radius_m < 0.1
    looks = {distractors.distractor(name).geoms for name in distractors.CATALOGUE}
    assert len(looks) == len(distractors.CATALOGUE)


@pytest.mark.parametrize("split", ["train", "test"])
def test_the_robot_starts_free_above_the_table_and_elsewhere(split):
    env = make("robot", split=split, num_envs=2)
    plain = EnvSpec(task="PickCube").make(2, split=split, num_threads=1, observation="state")
    robot, arm = env.task.robot, list(env.task.robot.arm)
    test_cells = set(robot_start.cells("test"))
    for first, second in pairwise(env.split_indices[:20].tolist()):
        for each in (env, plain):
            each.reset_envs([0, 1], [first, second])
        ours, theirs = env.get_states(), plain.get_states()
        moved = (ours.robots[robot.name].joint_pos - theirs.robots[robot.name].joint_pos)[:, arm].numpy()
        assert np.abs(moved).max() <= robot_start.BOUND_RAD + 1e-9 and np.abs(moved).max(1).min() > 0.02
        for row in moved:
            assert (cell_of(row) in test_cells) == (split == "test")
        assert (ours.robots[robot.name].ee_pos[:, 2] > robot_start.CLEARANCE_M - 1e-6).all()
        for name, entity in theirs.objects.items():
            assert torch.equal(ours.objects[name].pos, entity.pos), "objects are where they were"
        assert torch.equal(ours.robots[robot.name].joint_target, ours.robots[robot.name].joint_pos)
        qpos = ours.robots[robot.name].joint_pos[0].numpy()
        assert not env.randomizer.workspace.touches(ours.select([0]), qpos)
    env.close()
    plain.close()


def test_an_arm_that_would_touch_is_noticed():
    env = make("robot")
    env.reset_envs([0], env.split_indices[:1])
    state, workspace = env.get_states(), env.randomizer.workspace
    low = state.robots["franka"].joint_pos[0].numpy().copy()
    low[1] += 0.9
    assert workspace.hand(low)[2] < 0.0 and workspace.touches(state, low)
    env.close()


def test_a_robot_that_moves_freely_keeps_its_start():
    with pytest.raises(ConfigError, match=r"an arm that is bolted down.*only=sensor"):
        make("robot", task="humanoid/stand")


@pytest.mark.parametrize("task", ["humanoid/stand", "control/cartpole"])
def test_a_task_without_an_arm_and_objects_has_no_distractors(task):
    with pytest.raises(ConfigError, match=r"beside those of a task that an arm does.*only=sensor"):
        make("layout", task=task)


@pytest.mark.slow
@pytest.mark.parametrize("split", ["train", "test"])
def test_distractors_change_nothing_of_the_task(split):
    """The expert's episodes are bit-identical to those without distractors: in all states, and in rewards."""
    runs = {}
    for only in ("layout", None):
        env = make(only, split=split, num_envs=2)
        runs[only] = list(expert_episodes(env, env.split_indices[:6], record=("states",)))
        env.close()
    for with_them, without in zip(runs["layout"], runs[None], strict=True):
        assert with_them.instruction == without.instruction
        np.testing.assert_array_equal(with_them.actions, without.actions)
        np.testing.assert_array_equal(with_them.rewards, without.rewards)
        for key, values in without.raw.items():
            np.testing.assert_array_equal(with_them.raw[key], values, err_msg=key)
        shown = 0
        for name, entity in with_them.states.objects.items():
            if name.startswith("distractor"):
                assert torch.equal(entity.pos, entity.pos[:1].expand_as(entity.pos)), "they stay"
                shown += bool(entity.pos[0, 2] > -0.5)
        assert 2 <= shown <= 3


def test_distractors_stay_clear_of_objects_and_of_the_hands_way():
    env = make("layout")
    workspace = env.randomizer.workspace
    for episode in env.split_indices[:10].tolist():
        env.reset_envs([0], [episode])
        state = env.get_states()
        own = State(state.robots, {k: v for k, v in state.objects.items() if not k.startswith("distractor")})
        way = workspace.way(own, np.random.default_rng(episode))  # another way than the one that was drawn
        low = way[way[:, 2] < distractors.HEIGHT_M + 0.05, :2]
        for item in env.draws(0)["layout"]:
            body = state.objects[distractors.object_name(item["name"])]
            if body.pos[0, 2] < -0.5:
                continue
            at, radius = body.pos[0, :2].numpy(), distractors.distractor(item["name"]).radius_m
            cube = own.objects["cube"].pos[0, :2].numpy()
            assert np.linalg.norm(at - cube) > radius + layout.FROM_OBJECTS_M + 0.02
            assert np.linalg.norm(low - at, axis=1).min() > radius + layout.FROM_HAND_M - 0.05
    env.close()


def test_starts_that_are_given_stay():
    """A replay of recorded states keeps them, on every axis."""
    env = make("robot+layout", num_envs=1)
    first, second = env.split_indices[:2].tolist()
    env.reset_envs([0], [first])
    recorded = env.get_states()
    env.reset_envs([0], [second], recorded)
    for key, values in recorded.flatten().items():
        assert torch.equal(env.get_states().flatten()[key], values), key
    env.close()


def test_distractors_keep_away_from_objects_that_are_given():
    """States of a dataset without distractors get some where there is room in them."""
    plain, env = make("camera"), make("layout")
    first, second = env.split_indices[:2].tolist()
    plain.reset_envs([0], [first])
    env.reset_envs([0], [second], plain.get_states())
    state = env.get_states()
    cube = state.objects["cube"].pos
    assert torch.equal(cube, plain.get_states().objects["cube"].pos)
    shown = [
        entity.pos[0]
        for name, entity in state.objects.items()
        if name.startswith("distractor") and entity.pos[0, 2] > -0.5
    ]
    assert len(shown) >= 2
    assert all(torch.linalg.vector_norm((pos - cube[0])[:2]) > layout.FROM_HAND_M for pos in shown)
    plain.close()
    env.close()


def test_a_task_in_a_larger_scene_keeps_its_options():
    task = TASKS.get("PickCube")(variant="lift", cube_half_size_m=0.03)
    extra = distractors.distractor("can-0").as_object()
    scenario = task.scenario
    larger = in_scene(task, type(scenario)(robots=scenario.robots, objects=(*scenario.objects, extra)))
    assert (larger.variant, larger.cube_half_size_m, larger.name) == ("lift", 0.03, "PickCube")
    assert [item.name for item in larger.scenario.objects] == ["cube", "distractor_can_0"]
