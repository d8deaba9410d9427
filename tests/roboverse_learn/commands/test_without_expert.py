"""Tasks without an expert, where demonstrations are requested."""

import pytest

from envs.core.errors import ConfigError
from roboverse_learn.collect import collect_dataset
from roboverse_learn.config.compose import compose


def test_collecting_says_how_such_a_task_is_learned():
    config = compose("collect", ["task=humanoid/stand"])
    with pytest.raises(ConfigError, match=r"humanoid/stand has no scripted expert.*policy=ppo task="):
        collect_dataset(config)
