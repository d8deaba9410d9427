"""Keys of the command line, and what stands for those of another command."""

import pytest

from envs.core.errors import UnknownNameError
from roboverse_learn.config.compose import compose


@pytest.mark.parametrize(
    ("command", "key", "meant"),
    [
        ("view", "out", "file"),
        ("collect", "out", "dataset"),
        ("collect", "recordings", "path"),
        ("teleoperate", "path", "recordings"),
        ("train", "out", "run"),
    ],
)
def test_a_key_of_another_command_names_what_stands_for_it(command: str, key: str, meant: str) -> None:
    with pytest.raises(
        UnknownNameError, match=rf"Unknown key '{key}' of {command}. Did you mean '{meant}'\?"
    ):
        compose(command, [f"{key}=x"])
