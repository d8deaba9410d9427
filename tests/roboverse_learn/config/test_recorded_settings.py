"""``train dataset=`` and ``collect from=``: what nobody gives is taken from the dataset."""

from pathlib import Path

import pytest

from envs.core.atomic import write_json
from roboverse_learn.config.compose import compose
from roboverse_learn.data import DatasetWriter
from roboverse_learn.data.dataset.schema import COLLECTION_PATH
from tests.roboverse_learn.data.synthetic_episodes import FEATURES, SIZE, make_episode

SETTINGS = {
    "task": "StackCube",
    "task_kwargs": {},
    "level": 2,
    "only": None,
    "simulator": "mujoco",
    "renderer": "gl",
    "cameras": ["front"],
    "image_size": 48,
    "materials": None,
    "robot": "ur5e",
    "scenario": {"physics": {"decimation": 20}},
    "steps_per_look": 7,
    "source": "teleop",
}


@pytest.fixture
def write(tmp_path):
    def written(*metadata, settings=None):
        root = tmp_path / "dataset"
        with DatasetWriter(root, fps=20, features=FEATURES) as writer:
            for index, facts in enumerate(metadata):
                episode = make_episode(index)
                episode.metadata = {"split": "train", "episode": index, **facts}
                writer.add_episode(episode)
        if settings is not None:
            write_json(root / COLLECTION_PATH, {"settings": settings, "failed": []})
        return f"dataset={root}"

    return written


def test_the_settings_of_a_collection_are_taken_in_place_of_the_presets(write):
    config = compose("train", ["policy=act", "preset=quick", write({}, settings=SETTINGS)])
    env = config.env
    assert (env.task, env.robot, env.level, env.renderer) == ("StackCube", "ur5e", 2, "gl")
    assert (env.cameras, env.image_size) == (("front",), 48)
    assert env.scenario == {"physics": {"decimation": 20}}
    assert config.collect.steps_per_look == 7 and config.source == "expert"
    assert config.train.steps == 6000, "the preset still says how to train"


@pytest.mark.parametrize(
    ("recorded", "typed"), [({"level": 2}, "only=camera"), ({"only": "camera"}, "level=2")]
)
def test_what_varies_alone_takes_the_place_of_a_level_and_the_other_way(write, recorded, typed):
    settings = SETTINGS | {"level": 0} | recorded
    env = compose("train", ["policy=act", write({}, settings=settings), typed]).env
    assert (env.level, env.only) == ((0, "camera") if typed == "only=camera" else (2, None))


def test_words_and_arguments_win_over_the_dataset(write):
    dataset = write({}, settings=SETTINGS)
    typed = compose("train", ["policy=act", dataset, "image_size=64", "level=0"])
    assert (typed.env.image_size, typed.env.level, typed.env.robot) == (64, 0, "ur5e")
    given = {"dataset": dataset.removeprefix("dataset="), "task": "StackCube", "cameras": ["wrist"]}
    assert compose("train", (), given).env.cameras == ("wrist",)


def test_a_recipe_wins_over_the_dataset(write):
    recipe = compose("train", ["recipe=act_v1", "task=StackCube"])
    beside = compose("train", ["recipe=act_v1", write({}, settings=SETTINGS)])
    assert (beside.env.image_size, beside.env.cameras) == (recipe.env.image_size, recipe.env.cameras)
    assert beside.env.task == "StackCube"


def test_nothing_is_taken_from_a_dataset_of_another_task(write):
    dataset = write({}, settings=SETTINGS)
    for words in (["task=PickCube"], ["policy=mtact", "task=[PickCube,StackCube]"]):
        env = compose("train", [*words, dataset]).env
        assert (env.task, env.robot, env.image_size) == ("PickCube", "", 256)
    env = compose(
        "train",
        ["policy=mtact", "task=[StackCube,PickCube]", write({}, settings={**SETTINGS, "scenario": {}})],
    ).env
    assert (env.task, env.robot) == ("StackCube", "ur5e")


def test_a_merged_dataset_names_its_scene_and_robot_and_one_of_others_neither(write, tmp_path):
    usual = compose("train", []).env
    assert compose("train", [f"dataset={tmp_path / 'absent'}"]).env == usual
    facts = {"task": "PickCube", "task_kwargs": {"variant": "lift"}, "robot": "ur5e", "level": 1}
    env = compose("train", [write(facts, facts | {"level": 3})]).env
    assert (env.task, env.task_kwargs, env.robot, env.level) == ("PickCube", {"variant": "lift"}, "ur5e", 0)


def test_a_dataset_of_others_changes_nothing_but_once_collected_here(write):
    dataset = write({})
    assert compose("train", [dataset]).env == compose("train", []).env
    write_json(Path(dataset.removeprefix("dataset=")) / COLLECTION_PATH, {"settings": SETTINGS, "failed": []})
    assert compose("train", [dataset]).env.task == "StackCube"


def test_what_merged_episodes_differ_in_is_not_taken(write):
    robots = [{"task": "StackCube", "robot": "ur5e"}, {"task": "StackCube"}]
    env = compose("train", [write(*robots)]).env
    assert (env.task, env.robot) == ("StackCube", "")


def test_of_several_tasks_the_robot_alone_is_taken(write):
    tasks = [{"task": task, "task_kwargs": {}, "robot": "ur5e"} for task in ("StackCube", "CloseBox")]
    env = compose("train", [write(*tasks)]).env
    assert (env.task, env.robot) == ("PickCube", "ur5e")


def test_a_run_that_goes_on_keeps_its_own_settings(write, tmp_path):
    from roboverse_learn.commands.run_folder import RunFolder

    dataset, run = write({}, settings=SETTINGS), f"run={tmp_path / 'run'}"
    first = compose("train", ["policy=act", dataset, "cameras=[front,wrist]", run])
    with RunFolder.open(first, []):
        pass
    assert first.env.image_size == 48
    assert compose("train", [run, dataset]).env == first.env


@pytest.mark.parametrize("command", ["collect", "train"])
@pytest.mark.parametrize("source", ["augment", "retarget", "rerender"])
def test_what_is_made_of_demonstrations_has_their_images_and_no_other_setting_of_theirs(
    write, command, source
):
    origin = write({}, settings=SETTINGS | {"scenario": {}}).replace("dataset=", "from=")
    words = [f"source={source}", origin, "task=StackCube"]
    made, usual = compose(command, words).env, compose(command, ["task=StackCube"]).env
    assert (made.cameras, made.image_size) == (("front",), SIZE)
    assert (made.robot, made.level, made.renderer) == ("", 0, usual.renderer)
    other = compose(command, [*words, "cameras=[wrist]", "image_size=48"]).env
    assert (other.cameras, other.image_size) == (("wrist",), 48)
    of_preset = compose(command, ["task=StackCube", "preset=quick"]).env
    chosen = compose(command, [*words, "preset=quick"]).env
    assert (chosen.cameras, chosen.image_size) == (of_preset.cameras, of_preset.image_size)


def test_images_of_a_merged_dataset_are_taken_too_and_those_of_none_are_the_usual(write, tmp_path):
    words = ["source=augment", "task=StackCube"]
    merged = compose("collect", [*words, write({}).replace("dataset=", "from=")]).env
    assert (merged.cameras, merged.image_size) == (("front",), SIZE)
    absent = compose("collect", [*words, f"from={tmp_path / 'absent'}"]).env
    assert (absent.cameras, absent.image_size) == ((), 256)


def test_a_program_names_the_demonstrations_by_the_fields_name(write):
    given = {"from_dataset": write({}, settings=SETTINGS).removeprefix("dataset=")}
    assert compose("collect", ["source=augment", "task=StackCube"], given).env.image_size == SIZE
