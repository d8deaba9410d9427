import pytest

from envs.core.errors import ConfigError, UnknownNameError
from envs.randomization.levels import LEVEL_CHANNELS, LEVELS, channels_of, parse_level


def test_levels_are_cumulative():
    assert [channels_of(level) for level in LEVELS] == [
        ("task",),
        ("task", "environment"),
        ("task", "environment", "camera"),
        ("task", "environment", "camera", "lighting"),
    ]


@pytest.mark.parametrize("only", LEVEL_CHANNELS)
def test_a_channel_alone_still_varies_the_task(only):
    assert set(channels_of(only=only)) == {"task", only}


def test_a_level_may_be_text():
    assert parse_level("2") == parse_level(" 2 ") == parse_level(2) == 2


@pytest.mark.parametrize("level", [4, -1, "three", 1.5, True, None, ""])
def test_a_bad_level_lists_the_levels_and_what_they_mean(level):
    with pytest.raises(ConfigError, match=rf"Unknown level '{level}'. Valid levels: 0: task; 1: task \+ env"):
        channels_of(level)


def test_a_bad_channel_suggests_the_nearest():
    with pytest.raises(UnknownNameError, match=r"Unknown channel 'cameras'. Did you mean 'camera'\? Valid"):
        channels_of(only="cameras")


def test_an_unknown_channel_names_the_key_that_makes_one_of_another_package_known():
    with pytest.raises(UnknownNameError, match=r"Unknown channel 'my_axis'\. Valid: .*plugins=\[<package>\]"):
        channels_of(only="camera+my_axis")


def test_a_level_and_a_channel_together_are_refused():
    with pytest.raises(ConfigError, match=r"Given level=2 and only='camera'.*give one of them"):
        channels_of(2, only="camera")
