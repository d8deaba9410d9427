import dataclasses

import numpy as np
import pytest

from envs.core.errors import ConfigError, UnknownNameError
from envs.playback import HOLD_STEPS
from envs.tasks.plan_following import TAIL_STEPS
from roboverse_learn.data.importers.maniskill import ManiSkillFile
from roboverse_learn.data.importers.replayer import Replayer
from tests.roboverse_learn.data.importers.recordings import write_maniskill


@pytest.fixture(scope="module")
def demonstrations(tmp_path_factory, played, pick_env):
    file = write_maniskill(tmp_path_factory.mktemp("files") / "two", played)
    opened = ManiSkillFile(file, pick_env.task)
    return [opened.read(name) for name in opened.names]


@pytest.fixture
def looks(pick_env):
    return pick_env.split_indices[:2].tolist()


def test_episodes_of_our_expert_pass_by_states_and_by_controls(pick_env, demonstrations, looks):
    replayer = Replayer(pick_env)
    assert replayer.passes(demonstrations, looks, "states") == [True, True]
    assert replayer.passes(demonstrations, looks, "controls") == [True, True]
    assert replayer.passes([], [], "states") == []


@pytest.mark.parametrize("by", ["states", "controls"])
def test_replay_is_recorded_like_an_episode_of_the_expert(pick_env, demonstrations, played, looks, by):
    done = list(Replayer(pick_env).replay(demonstrations, looks, by))
    for outcome, demonstration, original, episode in zip(done, demonstrations, played, looks, strict=True):
        steps = len(outcome.actions)
        assert outcome.success and outcome.episode == episode
        assert outcome.instruction in pick_env.task.instructions
        assert steps <= len(original.actions)
        np.testing.assert_allclose(outcome.actions, demonstration.targets[:steps], atol=1e-6)
        assert outcome.observation_state.shape == (steps, 9) and outcome.rewards.shape == (steps,)
        assert {len(values) for values in outcome.raw.values()} == {steps + 1}
        assert outcome.rewards[-1 - TAIL_STEPS] == 1.0 and outcome.rewards[: -1 - TAIL_STEPS].max() < 1.0
        # Both reproduce the recording of our own simulator: exactly, or to the precision of float32.
        for key in ("robots/franka/joint_pos", "objects/cube/pos", "objects/goal/pos"):
            np.testing.assert_allclose(
                outcome.raw[key], original.raw[key][: steps + 1], atol=2e-3, err_msg=key
            )


def test_replay_by_states_runs_no_physics(pick_env, demonstrations, looks):
    """The cube hangs in the air, and stays there: no physics runs."""
    states = demonstrations[0].states.select(np.arange(12))
    states.objects["cube"].pos[:] = states.objects["goal"].pos + 0.1
    hanging = dataclasses.replace(demonstrations[0], states=states, targets=demonstrations[0].targets[:11])
    (outcome,) = Replayer(pick_env).replay([hanging], looks[:1], "states")
    assert not outcome.success and len(outcome.actions) == 11
    assert np.ptp(outcome.raw["objects/cube/pos"], axis=0).max() == 0.0


def test_replay_by_controls_runs_physics(pick_env, demonstrations, looks):
    """The recording with an open gripper: by states it is what it was, by controls nothing is grasped."""
    targets = demonstrations[0].targets.copy()
    targets[:, 7:] = 0.04
    open_hand = dataclasses.replace(demonstrations[0], targets=targets)
    replayer = Replayer(pick_env)
    assert replayer.passes([open_hand, demonstrations[1]], looks, "states") == [True, True]
    assert replayer.passes([open_hand, demonstrations[1]], looks, "controls") == [False, True]
    (outcome,) = replayer.replay([open_hand], looks[:1], "controls")
    assert len(outcome.actions) == len(targets) + HOLD_STEPS
    assert (outcome.actions[-HOLD_STEPS:] == outcome.actions[-HOLD_STEPS - 1]).all()


def test_replay_by_states_starts_at_first_state(pick_env, demonstrations, looks):
    jumping = dataclasses.replace(demonstrations[0], first_state=7)
    (outcome,) = Replayer(pick_env).replay([jumping], looks[:1], "states")
    recorded = demonstrations[0].states.robots["franka"].joint_pos[7].numpy()
    np.testing.assert_allclose(outcome.observation_state[0], recorded, atol=1e-6)
    np.testing.assert_allclose(outcome.actions[0], demonstrations[0].targets[7], atol=1e-6)


def test_missing_states_and_unknown_replay_are_refused(pick_env, demonstrations, looks):
    replayer = Replayer(pick_env)
    blind = dataclasses.replace(demonstrations[0], states=demonstrations[0].states.select([0]))
    with pytest.raises(
        ConfigError, match="'traj_0' has no recorded states: only replay=controls is possible"
    ):
        replayer.passes([blind], looks[:1], "states")
    assert replayer.passes([blind], looks[:1], "controls") == [True]
    with pytest.raises(UnknownNameError, match="Did you mean 'states'"):
        replayer.passes(demonstrations, looks, "state")


def test_episode_of_another_split_is_refused(pick_env, demonstrations):
    from envs.randomization import load_split

    with pytest.raises(ConfigError):
        Replayer(pick_env).passes(demonstrations[:1], load_split("test").episodes[:1].tolist(), "states")
