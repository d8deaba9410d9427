"""The channel ``language`` in environments, and channels of others that change the instruction."""

import numpy as np
import pytest

from envs.core.errors import ConfigError
from envs.randomization import CHANNELS, Channel, Randomizer, divided
from envs.randomization.language import WordingBank, bank_of
from envs.spec import EnvSpec
from envs.tasks import TASKS
from envs.tasks.pick_cube import PickCube

SPEC = EnvSpec(task="PickCube", image_size=16)
BANK = bank_of(PickCube.instructions)


@pytest.fixture
def make():
    """Returns a function that makes an environment without images."""
    made = []

    def make(spec, num_envs=1, split="test"):
        made.append(spec.make(num_envs, split=split, observation="state", num_threads=1))
        return made[-1]

    yield make
    for env in made:
        env.close()


@pytest.mark.parametrize("split", ["train", "test"])
def test_the_drawn_wording_is_everywhere_and_of_its_split(make, split):
    env = make(SPEC.replace(only="language"), 4, split)
    env.reset_envs(range(4), env.split_indices[:4])
    own = [env.instruction(i) for i in range(4)]
    assert {*own} <= {*BANK.of(split)} and len({*own}) > 1
    assert list(env.observe()["task"]) == own == list(env.call("task_description"))
    assert env.call("task") == ("PickCube",) * 4
    draw = env.draws(0)["language"]
    assert draw == {"wording": own[0], "kind": BANK.kind(own[0]), "bank": BANK.digest}


def test_many_episodes_draw_most_of_the_bank(make):
    env = make(SPEC.replace(only="language"), split="train")
    drawn = [env.randomizer.instruction(int(i)) for i in env.split_indices[:600]]
    assert len(set(drawn)) > 0.9 * len(BANK.known)
    test = make(SPEC.replace(only="language"))
    held_out = {test.randomizer.instruction(int(i)) for i in test.split_indices[:200]}
    assert held_out == {*BANK.test}


def test_an_episode_has_one_wording_for_any_number_of_envs(make):
    one, four = make(SPEC.replace(only="language")), make(SPEC.replace(only="language+camera"), 4)
    episodes = one.split_indices[:4]
    four.reset_envs(range(4), episodes)
    for row, episode in enumerate(episodes):
        one.reset_envs([0], [episode])
        assert one.instruction(0) == four.instruction(row)


def test_the_channel_changes_nothing_else_and_levels_keep_their_words(make):
    """The instruction of level 0 is the task's own draw, from the stream that it always had."""
    level, alone = make(SPEC), make(SPEC.replace(only="language"))
    for episode in level.split_indices[:6]:
        for env in (level, alone):
            env.reset_envs([0], [episode])
        rng = np.random.default_rng(
            np.random.SeedSequence(0, spawn_key=(0x7BBAE156, int(episode)))  # crc32 of "instruction"
        )
        assert level.instruction(0) == PickCube.instructions[int(rng.integers(3))]
        assert level.initial_state_hash(0) == alone.initial_state_hash(0)


def test_hashes_of_episodes_stay(make):
    env = make(SPEC)
    env.reset_envs([0], env.split_indices[:1])
    assert env.initial_state_hash(0) == "c89dcd3e67e8ae39"


def test_another_instruction_is_observed_from_then_on(make):
    env = make(SPEC, 2)
    env.reset_envs([0, 1], env.split_indices[:2])
    before = env.instruction(1)
    env.set_instruction(0, "dance")
    assert list(env.observe()["task"]) == ["dance", before]
    env.reset_envs([0], env.split_indices[:1])
    assert env.instruction(0) in PickCube.instructions


class Shouted(Channel):
    """Changes the instruction after other channels did."""

    def split(self, scene):
        return divided(tuple("!" * n for n in range(1, 21)), scene.split.name)

    def sample(self, rng, allowed, scene):
        return {"mark": allowed[int(rng.integers(len(allowed)))]}

    def apply(self, appearance, draw, scene):
        return appearance

    def instruct(self, instruction, draw, scene):
        return instruction.upper() + draw["mark"]


def test_channels_of_others_change_the_instruction_in_order(make, monkeypatch):
    monkeypatch.setattr(CHANNELS, "_entries", dict(CHANNELS._entries))
    CHANNELS.add("shouted", Shouted)
    alone, both = (make(SPEC.replace(only=only)) for only in ("shouted", "language+shouted"))
    episode = int(alone.split_indices[0])
    mark = alone.randomizer.draws(episode)["shouted"]["mark"]
    drawn = both.randomizer.draws(episode)["language"]["wording"]
    assert alone.randomizer.instruction(episode).removesuffix(mark).lower() in PickCube.instructions
    assert both.randomizer.instruction(episode) == drawn.upper() + mark


class OwnBank(PickCube):
    """A task that lists its wordings itself."""

    def wordings(self, instruction):
        return WordingBank(PickCube.instructions, ("seize the cube",))


def test_a_task_may_have_a_bank_of_its_own(make, monkeypatch):
    monkeypatch.setattr(TASKS, "_entries", dict(TASKS._entries))
    OwnBank.name = "OwnBank"
    TASKS.add("OwnBank", OwnBank)
    env = make(SPEC.replace(task="OwnBank", only="language"))
    assert env.randomizer.instruction(int(env.split_indices[0])) == "seize the cube"


def test_without_a_task_there_is_nothing_to_reword():
    scenario = PickCube().scenario
    bare = Randomizer(scenario.appearance, scenario.cameras, channels=("language",), split="test", seed=0)
    with pytest.raises(ConfigError, match=r"randomizer has no task\. Make the environment with EnvSpec"):
        bare.draws(int(bare.split.episodes[0]))
