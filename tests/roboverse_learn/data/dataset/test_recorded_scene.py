"""What is said where an environment is not the scene of recorded states."""

import pytest

from envs.core.errors import ConfigError
from envs.spec import EnvSpec
from roboverse_learn.data.dataset.recorded_scene import check_same_scene


@pytest.mark.parametrize(
    ("recorded", "given", "said"),
    [
        (
            {},
            "ur5e",
            "recorded with the task's own robot, and robot=ur5e was requested. Its states belong to their "
            "own scene alone: leave out robot=. For demonstrations of 'ur5e': source=retarget from=demos "
            "robot=ur5e.",
        ),
        (
            {"robot": "ur5e"},
            "",
            "recorded with robot=ur5e, and the task's own robot was requested. Its states belong to their "
            "own scene alone: add robot=ur5e. For demonstrations of 'franka': source=retarget from=demos "
            "robot=franka.",
        ),
    ],
)
def test_another_robot_is_named_with_what_to_do(recorded, given, said):
    metadata = {"task": "PickCube"} | recorded
    with pytest.raises(ConfigError) as refused:
        check_same_scene("demos", metadata, EnvSpec(robot=given), ("task", "robot"))
    assert str(refused.value) == f"The dataset 'demos' was {said}"
    check_same_scene("demos", metadata, EnvSpec(robot=recorded.get("robot", "")), ("task", "robot"))
