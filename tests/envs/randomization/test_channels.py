"""Channels of other packages vary as those of the levels do."""

from dataclasses import replace

import pytest

from envs.core.errors import UnknownNameError
from envs.randomization import CHANNELS, Channel, Scene, channels_of, divided
from envs.spec import EnvSpec

YAWS_RAD = tuple(0.01 * i for i in range(20))


class TableYaw(Channel):
    """Turns the table's texture."""

    def split(self, scene: Scene):
        return divided(YAWS_RAD, scene.split.name)

    def sample(self, rng, allowed, scene):
        return {"yaw_rad": allowed[int(rng.integers(len(allowed)))]}

    def apply(self, appearance, draw, scene):
        return replace(appearance, table_yaw_rad=draw["yaw_rad"])


@pytest.fixture
def table_yaw(monkeypatch):
    monkeypatch.setattr(CHANNELS, "_entries", dict(CHANNELS._entries))
    CHANNELS.add("table_yaw", TableYaw)


@pytest.mark.parametrize("split", ["train", "test"])
def test_a_registered_channel_varies_alone_and_with_others(table_yaw, split):
    own = set(divided(YAWS_RAD, split))
    for only, names in (("table_yaw", {"table_yaw"}), ("table_yaw+camera", {"camera", "table_yaw"})):
        env = EnvSpec(task="PickCube", only=only, image_size=16).make(1, split=split, num_threads=1)
        draws = [env.randomizer.draws(int(index)) for index in env.split_indices[:20]]
        assert {*draws[0]} == names and env.channels == channels_of(only=only)
        drawn = {each["table_yaw"]["yaw_rad"] for each in draws}
        assert drawn <= own and (len(drawn) > 1)
        env.close()


def test_what_the_splits_may_draw_is_disjoint_and_complete():
    train, test = divided(YAWS_RAD, "train"), divided(YAWS_RAD, "test")
    assert not {*train} & {*test} and {*train} | {*test} == {*YAWS_RAD} and len(test) == 2


def test_too_few_values_cannot_be_divided():
    with pytest.raises(ValueError, match="at least 10 values to divide, given 3"):
        divided((1, 2, 3), "train")


def test_an_unknown_channel_is_an_error_with_the_nearest():
    with pytest.raises(UnknownNameError, match=r"'cameras'.*Did you mean 'camera'"):
        channels_of(only="lighting+cameras")
