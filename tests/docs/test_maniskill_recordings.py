"""Our experts in ManiSkill's physics, and what the importer makes of a file, without ManiSkill."""

import numpy as np
import pytest

from docs.generate import maniskill_recordings as recordings
from docs.generate.maniskill_recordings import judge, main
from envs.experts.actor import expert_episodes
from envs.spec import EnvSpec
from envs.state import State
from tests.roboverse_learn.data.importers.recordings import write_maniskill


def test_an_environment_that_no_task_is_like_is_refused(tmp_path, capsys):
    assert main(["env_id=TurnFaucet-v1", f"folder={tmp_path}"]) == 2
    assert "env_id is one of LiftPegUpright-v1" in capsys.readouterr().err


@pytest.mark.slow
def test_a_recording_is_judged_at_every_moment(tmp_path):
    env = EnvSpec(task="PickCube").make(1, observation="state", num_threads=1)
    (played,) = expert_episodes(env, env.split_indices[:1].tolist(), record=("states",))
    env.close()
    path = write_maniskill(tmp_path / "t", [played])
    words = judge("PickCube-v1", path)
    count = len(played.actions)
    # the file calls its last moment alone a success; a few before it are, too
    assert words.endswith("of 1 episodes pass 1 by states and 1 by controls")
    agree = int(words.split("agrees at ")[1].split()[0])
    assert f"of {count} moments" in words and count - 12 < agree < count


@pytest.mark.slow
def test_a_state_and_a_plan_are_the_same_in_maniskills_terms():
    """Two arms: a state of ours as ManiSkill gives it is read back, and targets become its actions."""
    env = EnvSpec(task="TwoRobotPickCube").make(1, observation="state", num_threads=1)
    env.reset_envs(np.array([0]), env.split_indices[:1])
    state: State = env.get_states()
    answer = {"articulations": {}, "actors": {}}
    for index, robot in enumerate(env.scenario.robots):
        own = state.robots[robot.name]
        base = [*robot.pos, *robot.rot, *[0.0] * 6]
        parts = [*base, *own.joint_pos[0].tolist(), *own.joint_vel[0].tolist()]
        answer["articulations"][f"panda_wristcam-agent-{index}"] = parts
    for theirs, ours in (("cube", "cube"), ("goal_site", "goal")):
        item = state.objects[ours]
        answer["actors"][theirs] = [*item.pos[0].tolist(), *item.rot[0].tolist(), *[0.0] * 6]
    read = recordings._ours(env, "TwoRobotPickCube-v1", answer, None)
    np.testing.assert_allclose(read.objects["cube"].pos, state.objects["cube"].pos, atol=1e-6)
    for name, robot in state.robots.items():
        np.testing.assert_allclose(read.robots[name].joint_pos, robot.joint_pos, atol=1e-6)
        np.testing.assert_allclose(read.robots[name].ee_pos, robot.ee_pos, atol=1e-6)
    plan = np.arange(18.0)[None] / 100.0
    (action,) = recordings._actions(env, plan)
    assert len(action) == 16
    np.testing.assert_allclose(action[:7], np.arange(7) / 100.0)
    np.testing.assert_allclose(action[7], 1.0)  # 7 cm is beyond an open gripper
    np.testing.assert_allclose(action[8:15], np.arange(9, 16) / 100.0)
    env.close()
