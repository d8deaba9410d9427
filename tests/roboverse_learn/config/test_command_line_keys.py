"""Keys of the command line, and what stands for those of another command."""

import re

import pytest

from envs.core.errors import ConfigError, UnknownNameError
from roboverse_learn.config.compose import compose
from roboverse_learn.sweep import plan


@pytest.mark.parametrize(
    ("command", "key", "meant"),
    [
        ("view", "out", "file"),
        ("collect", "out", "dataset"),
        ("collect", "recordings", "path"),
        ("teleoperate", "path", "recordings"),
        ("train", "out", "run"),
        ("sweep", "out", "runs_dir"),
        ("evaluate", "level", "levels"),
    ],
)
def test_a_key_of_another_command_names_what_stands_for_it(command: str, key: str, meant: str) -> None:
    with pytest.raises(
        UnknownNameError, match=rf"Unknown key '{key}' of {command}. Did you mean '{meant}'\?"
    ):
        plan([f"{key}=x"]) if command == "sweep" else compose(command, [f"{key}=x"])


@pytest.mark.parametrize(
    ("key", "meant"),
    [
        ("batch", "train.batch_size"),
        ("sim", "simulator"),
        ("dir", "runs_dir"),
        ("direction", "scenario.appearance.lights.<number>.direction"),
    ],
)
def test_a_part_of_a_key_suggests_it(key: str, meant: str) -> None:
    with pytest.raises(UnknownNameError, match=rf"'{key}' of train\. Did you mean '{re.escape(meant)}'\?"):
        compose("train", [f"{key}=1"])


def test_a_word_that_is_near_to_nothing_suggests_nothing() -> None:
    with pytest.raises(UnknownNameError, match=r"Unknown key 'epochs' of train\. Valid: "):
        compose("train", ["epochs=3"])


@pytest.mark.parametrize(
    ("command", "words", "said"),
    [
        ("train", ["policy=mtact"], "Write several tasks as a list: task=[PickCube,StackCube]."),
        ("evaluate", ["checkpoint=x"], "Write several tasks as a list: task=[PickCube,StackCube]."),
        ("collect", [], "names several tasks, and one is taken here."),
    ],
)
def test_tasks_without_brackets_are_no_unknown_task(command: str, words: list[str], said: str) -> None:
    with pytest.raises(ConfigError, match=f"^task=PickCube,StackCube .*{re.escape(said)}"):
        compose(command, [*words, "task=PickCube,StackCube"])
