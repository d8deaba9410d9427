"""From recordings to a dataset: rendered afterwards, at any level, as often as wanted."""

import contextlib
import dataclasses
import shlex

import numpy as np
import pytest

from envs.core.errors import ConfigError, DatasetError, PolicyError
from envs.randomization.splits import load_split
from roboverse_learn.collect import collect_dataset, dataset_folder
from roboverse_learn.config.compose import compose
from roboverse_learn.data.dataset.info import DatasetInfo
from roboverse_learn.data.dataset.merge import merge
from roboverse_learn.data.dataset.raw import read_raw
from roboverse_learn.data.dataset.reader import ResidentDataset
from roboverse_learn.data.dataset.schema import ACTION_KEY, INTERVENTION_KEY, SUCCESS_KEY
from roboverse_learn.data.sources import SOURCES
from roboverse_learn.teleoperate import collect_command, recordings_folder, teleoperate
from roboverse_learn.teleoperation.recording import (
    Mark,
    Recording,
    RecordingFolder,
    recordings_in,
    scene_of,
)
from roboverse_learn.train import train_run

SMALL = ("task=PickCube", "image_size=32")


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with two episodes that the expert steered, and their dataset at level 0."""
    folder = tmp_path_factory.mktemp("teleoperation")
    words = [*SMALL, "actor=expert", "num_demos=2", f"datasets_dir={folder}", f"dataset={folder / 'level0'}"]
    report = teleoperate(compose("teleoperate", words))
    again = str(report.renderables[-1])
    assert "with other looks: roboverse collect " in again and " source=teleop path=" in again
    return folder


def collected(place, name, *words):
    path = f"path={place / 'PickCube' / 'recordings'}"
    given = [*SMALL, "source=teleop", path, f"dataset={place / name}", "num_workers=1", *words]
    return collect_dataset(compose("collect", given))


def recordings(place):
    return [Recording.read(path) for path in recordings_in(place / "PickCube" / "recordings")]


@pytest.mark.slow
def test_a_dataset_has_the_recorded_actions_states_and_marks(place):
    info = DatasetInfo.open(place / "level0")
    columns = info.read_columns()
    made = recordings(place)
    assert info.num_episodes == 2
    np.testing.assert_array_equal(columns[ACTION_KEY], np.concatenate([each.actions for each in made]))
    np.testing.assert_array_equal(columns[SUCCESS_KEY], np.concatenate([each.successes for each in made]))
    assert columns[INTERVENTION_KEY].all()
    for index, recording in enumerate(made):
        raw, metadata = read_raw(place / "level0", index)
        for key, values in recording.states.items():
            np.testing.assert_array_equal(raw[key], values, err_msg=key)
        assert metadata["source"] == "teleop" and metadata["device"] == "expert"
        assert metadata["seconds"] == pytest.approx(recording.length / 20)
        assert metadata["initial_state_hash"] == recording.facts["initial_state_hash"]
        assert info.episodes[index]["tasks"] == [recording.facts["instruction"]]


@pytest.mark.slow
def test_the_same_recordings_are_rendered_at_another_level(place):
    summary = collected(place, "level3", "level=3")
    assert summary.num_episodes == 2
    plain, varied = (DatasetInfo.open(place / name) for name in ("level0", "level3"))
    for key in (ACTION_KEY, "observation.state"):
        np.testing.assert_array_equal(plain.read_columns()[key], varied.read_columns()[key])
    camera = "observation.images.front"
    first, second = (ResidentDataset(info.root, keys=[camera]).frames[camera][0] for info in (plain, varied))
    assert (first.float() - second.float()).abs().mean() > 10
    assert all(metadata["level"] == 3 for metadata in varied.episode_metadata)


@pytest.mark.slow
def test_recorded_controls_succeed_in_physics(place):
    summary = collected(place, "controls", "replay=controls")
    assert (summary.num_episodes, summary.outcome) == (2, "2 of 2 recordings show a success")
    info = DatasetInfo.open(place / "controls")
    assert info.read_columns()[INTERVENTION_KEY].all()


@pytest.mark.slow
def test_a_folder_is_named_after_the_number_only_if_that_leaves_recordings_out(place):
    words = [*SMALL, "source=teleop", f"path={place / 'PickCube' / 'recordings'}"]
    names = {
        count: dataset_folder(compose("collect", [*words, f"num_demos={count}"])).name for count in (1, 2, 3)
    }
    rest = "level0-mujoco-warp-32px"
    assert names == {
        1: f"{rest}-1demos-teleop-recordings",
        2: f"{rest}-teleop-recordings",
        3: f"{rest}-teleop-recordings",
    }


@pytest.mark.slow
def test_corrections_alone_begin_where_the_person_took_over(place, tmp_path):
    by_person, corrected = recordings(place)[:2]
    acted = corrected.interventions.copy()
    acted[:20] = acted[25:30] = False  # the policy twice: a hand-back and a second correction
    dataclasses.replace(corrected, interventions=acted).write(tmp_path / "000000.teleop.safetensors")
    alone = dataclasses.replace(by_person, interventions=np.zeros_like(by_person.interventions))
    alone.write(tmp_path / "000001.teleop.safetensors")
    words = [*SMALL, "source=teleop", f"path={tmp_path}", "num_workers=1", f"dataset={tmp_path / 'part'}"]
    summary = collect_dataset(compose("collect", [*words, "only_corrections=true"]))
    assert summary.num_episodes == 1, "an episode that the policy solved alone corrects nothing"
    columns = DatasetInfo.open(tmp_path / "part").read_columns()
    np.testing.assert_array_equal(columns[ACTION_KEY], corrected.actions[30:])
    assert columns[INTERVENTION_KEY].all()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["source=expert"], "only_corrections=true was given, and source=expert has none"),
        (["source=teleop", "replay=controls", "path=recordings"], "begins in the middle of a recording"),
    ],
)
def test_corrections_are_of_recordings_by_states(words, message, tmp_path):
    with pytest.raises(ConfigError, match=message):
        collect_dataset(compose("collect", [*SMALL, "only_corrections=true", *words, f"dataset={tmp_path}"]))


@pytest.mark.slow
def test_an_episode_that_is_discarded_afterwards_is_named(place):
    folder = RecordingFolder(place / "PickCube" / "recordings", recordings(place)[0].facts["scene"])
    path = next(iter(folder.facts))
    try:
        folder.remark(path, Mark.DISCARDED)
        with pytest.raises(DatasetError, match=f"{path.name}', which is no success any more"):
            collected(place, "level0")
        assert collected(place, "rest").num_episodes == 1
    finally:
        folder.remark(path, Mark.SUCCESS)
        folder.close()


@pytest.mark.slow
def test_teleoperation_continues_where_it_was(place):
    words = [*SMALL, "actor=expert", "num_demos=3", f"datasets_dir={place}", "render=false"]
    teleoperate(compose("teleoperate", words))
    made = recordings(place)
    last = [int(episode) for episode in load_split("train").episodes[:-4:-1]]
    assert [each.facts["episode"] for each in made] == last
    assert collected(place, "more").num_episodes == 3
    assert collected(place, "level0").num_episodes == 3  # a dataset grows with its folder


@pytest.mark.slow
def test_a_session_that_is_continued_with_more_demonstrations_grows_one_dataset(tmp_path):
    for count in (1, 2):
        words = [*SMALL, "actor=expert", f"num_demos={count}", f"datasets_dir={tmp_path}"]
        teleoperate(compose("teleoperate", words))
    (dataset,) = (tmp_path / "PickCube").glob("*-teleop-recordings")
    assert DatasetInfo.open(dataset).num_episodes == 2
    assert sorted(path.name for path in dataset.parent.iterdir()) == [dataset.name, "recordings"]


@pytest.mark.long
def test_a_policy_learns_from_the_dataset_and_is_corrected_where_it_strays(place, tmp_path):
    words = [
        *("policy=act", "preset=quick", "train.steps=2", "train.batch_size=2", f"dataset={place / 'level0'}"),
        *("evaluate.episodes=1", "evaluate.levels=[0]", "evaluate.videos=0", "image_size=32", "cameras=[]"),
        *(f"runs_dir={tmp_path / 'runs'}", f"results_dir={tmp_path / 'results'}"),
    ]
    run = train_run(compose("train", words))
    words = [f"checkpoint={run.folder}", "actor=expert", "num_demos=1", f"datasets_dir={tmp_path}"]
    teleoperate(compose("teleoperate", [*words, f"dataset={tmp_path / 'corrections'}"]))
    (path,) = recordings_in(tmp_path / "PickCube" / "corrections")
    recording = Recording.read(path)
    acted = recording.interventions
    assert recording.mark is Mark.SUCCESS and not acted[0] and acted[-1]
    assert (recording.facts["policy"], recording.facts["device"]) == ("act", "expert")
    info = DatasetInfo.open(tmp_path / "corrections")
    np.testing.assert_array_equal(info.read_columns()[INTERVENTION_KEY], acted)
    assert info.shapes["observation.images.front"] == (32, 32, 3)  # as the policy sees
    collect_dataset(compose("collect", [*SMALL, "num_demos=2", f"dataset={tmp_path / 'expert'}"]))
    merged = merge([tmp_path / "expert", place / "level0", tmp_path / "corrections"], tmp_path / "all")
    of_person = DatasetInfo.open(place / "level0").num_episodes
    assert merged.num_episodes == 2 + of_person + 1 and INTERVENTION_KEY not in merged.features
    with pytest.raises(PolicyError, match="does not exist"):
        teleoperate(compose("teleoperate", ["task=PickCube", f"checkpoint={tmp_path / 'none'}"]))


@pytest.mark.slow
def test_other_scenes_and_no_recordings_are_reported(place, tmp_path):
    with pytest.raises(DatasetError, match="there is no recording of teleoperation"):
        words = [*SMALL, "source=teleop", f"path={tmp_path}", f"dataset={tmp_path / 'out'}"]
        collect_dataset(compose("collect", words))
    with pytest.raises(
        DatasetError, match=r"The folder of recordings .* was begun with task_kwargs=\{\}; now"
    ):
        collected(place, "other", "task_kwargs.variant=lift")
    with pytest.raises(ConfigError, match="source=teleop needs path="):
        compose("collect", [*SMALL, "source=teleop"])


@pytest.mark.parametrize(
    ("recorded", "given", "said"),
    [
        (["task=StackCube"], [], "of StackCube: give task=StackCube."),
        ([], ["task=StackCube"], "of PickCube: give task=PickCube."),
        (["robot=iiwa"], [], "of PickCube by the robot 'iiwa': give robot=iiwa."),
        ([], ["robot=iiwa"], "of PickCube by the robot 'franka': leave out robot=."),
        (["robot=iiwa"], ["robot=ur5e"], "of PickCube by the robot 'iiwa': give robot=iiwa."),
        (["robot=iiwa"], ["robot=franka"], "of PickCube by the robot 'iiwa': give robot=iiwa."),
        (
            ["task=StackCube", "robot=iiwa"],
            [],
            "of StackCube by the robot 'iiwa': give task=StackCube and give robot=iiwa.",
        ),
    ],
)
def test_recordings_of_another_task_or_robot_say_what_to_give(recorded, given, said, tmp_path):
    folder = tmp_path / "recordings"
    write_recording(folder, scene_of(compose("teleoperate", ["task=PickCube", *recorded]).env))
    source = SOURCES.get("teleop")(compose("collect", ["source=teleop", f"path={folder}", *given]))
    with pytest.raises(DatasetError) as refused:
        source.check()
    assert str(refused.value) == f"path={folder} holds recordings {said}"


@pytest.mark.parametrize(("recorded", "given"), [("", "franka"), ("franka", "")])
def test_the_tasks_own_robot_is_the_one_of_its_name(recorded, given, tmp_path):
    config = compose("collect", ["source=teleop", f"path={tmp_path}", "task=PickCube"])
    scene = scene_of(config.env.replace(robot=recorded))
    write_recording(tmp_path, scene)
    there = dataclasses.replace(config, env=config.env.replace(robot=given))  # a command names no own robot
    SOURCES.get("teleop")(there).check()
    there = dataclasses.replace(there, env=there.env.replace(task="StackCube"))
    with pytest.raises(DatasetError, match=r"recordings of PickCube: give task=PickCube\.$"):
        SOURCES.get("teleop")(there).check()


def test_recordings_that_do_not_say_their_task_are_refused(tmp_path):
    scene = scene_of(compose("teleoperate", ["task=PickCube"]).env)
    del scene["task"]
    write_recording(tmp_path, scene)
    with pytest.raises(DatasetError, match="was begun with task=None; now given: task='PickCube'"):
        SOURCES.get("teleop")(compose("collect", ["source=teleop", f"path={tmp_path}"])).check()


def write_recording(folder, scene):
    """Writes a success of one step in a scene."""
    recording = Recording(
        states={"time": np.zeros((2, 1))},
        actions=np.zeros((1, 8), np.float32),
        hand_actions=np.zeros((1, 7), np.float32),
        successes=np.ones(1, bool),
        interventions=np.ones(1, bool),
        facts={"scene": scene, "episode": 3, "mark": str(Mark.SUCCESS)},
    )
    with contextlib.closing(RecordingFolder(folder, scene)) as opened:
        opened.add(recording)


def test_a_task_without_an_arm_to_steer_is_reported(tmp_path):
    with pytest.raises(ConfigError, match="cannot be teleoperated: its actions are"):
        teleoperate(compose("teleoperate", ["task=control/cartpole", f"datasets_dir={tmp_path}"]))


def test_an_expert_that_never_succeeds_is_reported(tmp_path, monkeypatch):
    monkeypatch.setattr("envs.tasks.pick_cube.PickCube.expert", lambda *_: [])
    words = [*SMALL, "actor=expert", f"datasets_dir={tmp_path}"]
    with pytest.raises(ConfigError, match="solved none of 20 episodes by steering the hand"):
        teleoperate(compose("teleoperate", words))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["num_demos=0"], "num_demos must be above 0"),
        (["operators=9"], "operators must be 1 to 8"),
        (["port=70000"], "port must be 0 to 65535"),
        (["view_size=4"], "view_size must be 16 to 2048"),
        (["cert=a.pem"], "https needs both cert"),
        (["actor=robot"], "actor"),
    ],
)
def test_wrong_values_are_reported(words, message):
    with pytest.raises(ConfigError, match=message):
        compose("teleoperate", words)


def test_recordings_of_a_changed_scene_have_a_folder_of_their_own():
    def folder(*words):
        return recordings_folder(compose("teleoperate", ["task=PickCube", *words]))

    assert folder() == folder("level=3", "image_size=64", "cameras=[wrist]")
    lifted = folder("task_kwargs.variant=lift")
    assert lifted != folder() and lifted == folder("task_kwargs.variant=lift", "level=2")
    assert folder("robot=iiwa") != folder()


@pytest.mark.parametrize(
    "words",
    [
        ["task=PickCube", "level=1", "image_size=64"],
        ["task=StackCube", "robot=iiwa"],
        ["task_kwargs.variant=lift", "task_kwargs.cube_half_size_m=0.025", "only=camera"],
        ["scenario.physics.decimation=40", "simulator=mujoco_warp", "simulator_settings.njmax=768"],
    ],
    ids=" ".join,
)
def test_the_printed_command_renders_the_recordings_of_a_changed_scene(words, tmp_path):
    folder = tmp_path / "what I've recorded"
    config = compose("teleoperate", [*words, f"recordings={folder}", f"datasets_dir={tmp_path / 'my data'}"])
    write_recording(folder, scene_of(config.env))
    program, command, *typed = shlex.split(collect_command(config, recordings_folder(config)))
    again = compose(command, typed)
    SOURCES.get("teleop")(again).check()
    assert program == "roboverse" and again.env == config.env.replace(level=3, only=None)
    assert (again.datasets_dir, again.dataset) == (str(tmp_path / "my data"), "")
