"""Channels of other packages vary as those of the levels do."""

from dataclasses import replace

import pytest
import torch

from envs.core.errors import ConfigError, UnknownNameError
from envs.randomization import CHANNELS, NAMED_LEVELS, Channel, Scene, channels_of, divided
from envs.rotations import from_yaw
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


@pytest.fixture
def named_level(monkeypatch):
    monkeypatch.setattr(NAMED_LEVELS, "_entries", dict(NAMED_LEVELS._entries))
    return NAMED_LEVELS.add


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


class Slanted(TableYaw):
    """Turns the cube too, without a word more than its method."""

    def start(self, state, draw, scene):
        cube = state.objects["cube"]
        turned = replace(cube, rot=from_yaw(cube.pos.new_tensor([draw["yaw_rad"]])))
        return replace(state, objects={**state.objects, "cube": turned})


def test_a_channel_with_a_start_of_its_own_changes_starts(table_yaw):
    CHANNELS.add("slanted", Slanted)
    for only, changes in (("table_yaw", False), ("slanted", True)):
        env = EnvSpec(task="PickCube", only=only, image_size=16).make(1, num_threads=1)
        env.reset(seed=0)
        draw, rot = env.draws(0)[only]["yaw_rad"], env.get_states().objects["cube"].rot
        assert env.randomizer.changes_starts == changes
        assert torch.allclose(rot, from_yaw(rot.new_tensor([draw])), atol=1e-6) == changes
        env.close()


def test_what_the_splits_may_draw_is_disjoint_and_complete():
    train, test = divided(YAWS_RAD, "train"), divided(YAWS_RAD, "test")
    assert not {*train} & {*test} and {*train} | {*test} == {*YAWS_RAD} and len(test) == 2


def test_too_few_values_cannot_be_divided():
    with pytest.raises(ValueError, match="at least 10 values to divide, given 3"):
        divided((1, 2, 3), "train")


def test_a_named_level_is_its_channels(table_yaw, named_level):
    named_level("turned", ("table_yaw", "camera", "environment"))
    assert channels_of(only="turned") == ("task", "environment", "camera", "table_yaw")
    assert channels_of(only="turned+lighting") == (
        *("task", "environment", "camera", "lighting"),
        "table_yaw",
    )
    env = EnvSpec(task="PickCube", only="turned", image_size=16).make(1, split="test", num_threads=1)
    draws = env.randomizer.draws(int(env.split_indices[0]))
    env.close()
    assert list(draws) == ["environment", "camera", "table_yaw"]
    level_2 = EnvSpec(task="PickCube", level=2, image_size=16).make(1, split="test", num_threads=1)
    same = level_2.randomizer.draws(int(level_2.split_indices[0]))
    level_2.close()
    assert same == {name: draws[name] for name in same}, "a channel that is added changes no other's draw"


def test_an_unknown_channel_in_a_named_level_is_an_error(named_level):
    named_level("turned", ("camera", "table_yew"))
    said = r"channel of the level 'turned' 'table_yew'.*Valid: camera.*plugins=\[<package>\]"
    with pytest.raises(UnknownNameError, match=said):
        channels_of(only="turned")


def test_a_named_level_is_no_number(named_level):
    named_level("turned", ("camera",))
    with pytest.raises(ConfigError, match=r"Unknown level 'turned'.*only=turned"):
        channels_of("turned")
    with pytest.raises(ConfigError, match=r"Did you mean 'only=turned'"):
        channels_of("turnd")
    with pytest.raises(UnknownNameError, match=r"Did you mean 'turned'"):
        channels_of(only="turnd")


def test_an_unknown_channel_is_an_error_with_the_nearest():
    with pytest.raises(UnknownNameError, match=r"'cameras'.*Did you mean 'camera'"):
        channels_of(only="lighting+cameras")
