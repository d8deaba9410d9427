"""The validation split is refused where training uses its episodes."""

import pytest

from envs.core.errors import ConfigError
from roboverse_learn.config.compose import compose
from roboverse_learn.config.validation_split import check_validation


@pytest.mark.parametrize(
    ("policy", "num_demos", "said"),
    [
        ("act", 8000, ""),
        (
            "act",
            8001,
            r"of num_demos=8,001 more than 8,000 are of its episodes.*or give num_demos=8000 at most",
        ),
        ("ppo", 1000, r"policy=ppo learns from every episode of the train split\. Leave validation out of"),
    ],
)
def test_validation_is_of_episodes_that_training_leaves_out(policy, num_demos, said):
    check_validation(("train", "test"), policy, num_demos)
    if not said:
        check_validation(("validation",), policy, num_demos)
        return
    with pytest.raises(ConfigError, match=f"demonstrations leave out.*{said}"):
        check_validation(("test", "validation"), policy, num_demos)


def test_training_that_would_use_its_episodes_is_refused_before_it_starts():
    words = ["task=PickCube", "evaluate.splits=[validation]"]
    assert compose("train", ["policy=act", *words]).evaluate.splits == ("validation",)
    with pytest.raises(ConfigError, match="policy=ppo learns from every episode"):
        compose("train", ["policy=ppo", *words])
    with pytest.raises(ConfigError, match="at most 1,000, the validation split's episodes, given 1,001"):
        compose("train", ["policy=act", *words, "episodes=1001"])
