import numpy as np
import pytest
import torch

from envs.experts.actor import expert_episodes
from envs.randomization import channel_rng
from envs.rotations import from_yaw, multiply
from envs.spec import EnvSpec
from envs.state import State
from roboverse_learn.data.augmentation.actor import augmented_episodes
from roboverse_learn.data.augmentation.config import AugmentConfig
from roboverse_learn.data.augmentation.planner import AugmentPlanner
from roboverse_learn.data.augmentation.pose import Pose
from roboverse_learn.data.augmentation.recording import HandReader
from roboverse_learn.data.augmentation.references import References
from roboverse_learn.data.augmentation.sources import read_sources

pytestmark = pytest.mark.slow
EXACT = AugmentConfig(noise_m=0.0)


@pytest.fixture(scope="module")
def task():
    return EnvSpec(task="PickCube").make_task()


@pytest.fixture(scope="module")
def found(task, pick_cube_demos):
    return read_sources(pick_cube_demos, task, EXACT)


def moved_cube(state, way, yaw):
    """Returns a state whose cube is elsewhere, and turned."""
    flat = {key: value.clone() for key, value in state.flatten().items()}
    flat["objects/cube/pos"] += torch.tensor(way)
    flat["objects/cube/rot"] = torch.from_numpy(multiply(from_yaw(yaw), flat["objects/cube/rot"].numpy()))
    return State.unflatten(flat)


def test_hand_reaches_a_moved_cube_as_the_source_reached_its_own(task, found):
    one = found.sources[:1]
    planner, reader = AugmentPlanner(task, one, EXACT), HandReader.of(task)
    references = References(task.scenario)
    demo = one[0].demo
    state = moved_cube(demo.states.select([0]), [0.05, -0.04, 0.0], 0.3)
    plan = planner.plan(state, np.random.default_rng(0), stage=0)
    hand = reader.hands(plan.targets[-1:].astype(float)).rows(0)
    last = int(one[0].pieces[0].steps[-1])
    source = references.pose(demo.states, "cube").rows(0).inverse() @ demo.commanded.rows(last)
    expected = references.pose(state, "cube").rows(0) @ source
    np.testing.assert_allclose(hand.pos, expected.pos, atol=1e-3)
    assert abs(hand.rot @ expected.rot) == pytest.approx(1.0, abs=1e-5)
    assert plan.source == 0


def test_cube_that_is_held_otherwise_reaches_the_same_place(task, found):
    """The hand holds the cube 1 cm beside: it ends 1 cm beside, too."""
    one = found.sources[:1]
    planner, reader = AugmentPlanner(task, one, EXACT), HandReader.of(task)
    first = int(one[0].pieces[2].steps[0])
    state = one[0].demo.states.select([first])
    rng = np.random.default_rng(0)
    ends = [
        reader.hands(planner.plan(each, rng, stage=2).targets[-1:].astype(float)).rows(0)
        for each in (state, moved_cube(state, [0.01, 0.0, 0.0], 0.0))
    ]
    np.testing.assert_allclose(ends[0].pos - ends[1].pos, [0.01, 0.0, 0.0], atol=1e-3)


def test_nearest_source_is_the_one_of_the_same_start(task, found):
    planner = AugmentPlanner(task, found.sources, AugmentConfig(noise_m=0.0, nearest=1))
    for source in found.sources:
        state = source.demo.states.select([0])
        assert planner.plan(state, np.random.default_rng(0), stage=0).source == source.demo.index


def test_random_choice_takes_every_source(task, found):
    planner = AugmentPlanner(task, found.sources, AugmentConfig(noise_m=0.0, choose="random"))
    state, rng = found.sources[0].demo.states.select([0]), np.random.default_rng(0)
    assert {planner.plan(state, rng, stage=0).source for _ in range(20)} == {0, 1, 2, 3}


def test_what_reached_the_cube_grasps_it(task, found):
    planner = AugmentPlanner(task, found.sources, AugmentConfig(noise_m=0.0, choose="random"))
    state, rng = found.sources[0].demo.states.select([20]), np.random.default_rng(0)
    assert {planner.plan(state, rng, 1, last_source=2).source for _ in range(5)} == {2}


def test_cube_that_lies_elsewhere_is_not_held(task, found):
    planner = AugmentPlanner(task, found.sources, EXACT)
    source = found.sources[0]
    held = source.demo.states.select([int(source.pieces[2].steps[0])])
    assert planner.holds(held, 2) and planner.holds(held, 0)
    assert not planner.holds(moved_cube(held, [0.1, 0.0, 0.0], 0.0), 2)


def attempts(found, episodes, num_envs, **settings):
    config = AugmentConfig(**settings)
    env = EnvSpec(task="PickCube").make(num_envs, observation="state", num_threads=1)
    planner = AugmentPlanner(env.task, found.sources, config)
    made = list(augmented_episodes(env, episodes, planner, config.retries, record=()))
    env.close()
    return made


def test_episode_does_not_depend_on_the_number_of_environments(found):
    alone, together = (attempts(found, [20, 21, 22], count) for count in (1, 3))
    for one, other in zip(alone, together, strict=True):
        assert one.success and other.success
        np.testing.assert_array_equal(one.actions, other.actions)
        assert one.memory.made_of == other.memory.made_of


def test_episode_is_no_copy_of_a_source_and_names_its_sources(found):
    (episode,) = attempts(found, [23], 1)
    pieces = [(piece.reference, piece.carried) for piece in episode.memory.made_of]
    assert pieces == [("cube", ""), ("cube", ""), ("goal", "cube")]
    assert {piece.demonstration for piece in episode.memory.made_of} <= {0, 1, 2, 3}
    for source in found.sources:
        assert len(episode.actions) != source.demo.num_steps or not np.allclose(
            episode.actions[:, 7], source.demo.gripper
        )


def test_failed_grasp_is_begun_again(found, monkeypatch):
    """A planner that finds the hand empty once goes back to where the subtask begins."""
    answers = iter([True, True, False])
    usual = AugmentPlanner.holds
    monkeypatch.setattr(AugmentPlanner, "holds", lambda *given: next(answers, True) and usual(*given))
    (episode,) = attempts(found, [24], 1)
    assert episode.memory.retries >= 1
    assert [piece.reference for piece in episode.memory.made_of][:4] == ["cube", "cube", "cube", "cube"]


def test_attempt_without_success_ends_after_its_retries(found, monkeypatch):
    monkeypatch.setattr(AugmentPlanner, "holds", lambda self, state, stage: stage != 2)
    (episode,) = attempts(found, [25], 1, retries=1)
    assert not episode.success and episode.memory.retries == 2
    assert len(episode.memory.made_of) == 4


def test_noise_misses_and_is_corrected(task, found):
    """With noise, the path differs on the way, and ends at the same place."""
    state = found.sources[0].demo.states.select([0])
    reader, one = HandReader.of(task), found.sources[:1]
    noisy = AugmentPlanner(task, one, AugmentConfig(noise_m=0.03))
    exact = AugmentPlanner(task, one, EXACT)
    paths: list[Pose] = [
        reader.hands(planner.plan(state, channel_rng(0, "augment", 3), 0).targets.astype(float))
        for planner in (exact, noisy)
    ]
    piece = one[0].pieces[0]
    tail = len(piece.steps) - piece.free[1]
    missed = paths[1].pos[-tail:] - paths[0].pos[-tail:]  # from where the window ends
    assert np.linalg.norm(missed[0]) > 5e-3 and missed[0, 2] > -1e-3
    np.testing.assert_allclose(missed[-1], 0.0, atol=1e-3)


def test_hand_never_goes_lower_than_in_any_source(task, found):
    """A goal at the table: a source that came to its own from below would pass through the table."""
    planner, reader = AugmentPlanner(task, found.sources, EXACT), HandReader.of(task)
    source = found.sources[0]
    state = source.demo.states.select([int(source.pieces[2].steps[0])])
    flat = {key: value.clone() for key, value in state.flatten().items()}
    flat["objects/goal/pos"][:, 2] = 0.0
    plan = planner.plan(State.unflatten(flat), np.random.default_rng(0), stage=2)
    lowest = min(each.demo.commanded.pos[each.pieces[2].steps, 2].min() for each in found.sources)
    assert reader.hands(plan.targets.astype(float)).pos[:, 2].min() > lowest - 2e-3


def test_expert_episodes_are_what_they_were(found):
    """The sources' own expert is not touched by augmentation."""
    env = EnvSpec(task="PickCube").make(1, observation="state", num_threads=1)
    (episode,) = expert_episodes(env, env.split_indices[:1].tolist(), record=())
    env.close()
    assert len(episode.actions) == found.sources[0].demo.num_steps
