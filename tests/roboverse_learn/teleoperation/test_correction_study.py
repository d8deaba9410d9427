"""The study of corrections: its rounds with made collections and policies, and once as small as it gets."""

import logging
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from roboverse_learn.commands.tested_checkpoint import protocol_of
from roboverse_learn.data.dataset.info import DatasetInfo
from roboverse_learn.teleoperation import correction_study
from roboverse_learn.teleoperation.correction_study import CorrectionStudy, StudySettings, main
from roboverse_learn.teleoperation.recording import (
    SUFFIX,
    Recording,
    open_recordings,
    recordings_in,
    scene_of,
)


class World:
    """Stands in for collection, teleoperation and training; a dataset is its number of demonstrations.

    Args:
        corrected: Of each episode that a policy acts in, whether the expert takes over.
    """

    def __init__(self, corrected=()):
        self.corrected, self.sizes = corrected, {}
        self.collections, self.steered, self.trainings = [], [], []

    def collect_dataset(self, config):
        count = config.collect.num_demos
        if config.source == "teleop":
            files = recordings_in(Path(config.path))
            count = min(count, sum(Recording.read(file).taken_over is not None for file in files))
        self.collections.append(config)
        self.sizes[Path(config.dataset)] = count

    def teleoperate(self, config):
        self.steered.append(config)
        folder = Path(config.recordings)
        folder.mkdir(parents=True, exist_ok=True)
        for index in range(len(recordings_in(folder)), config.num_demos):
            Recording(
                states={"x": np.zeros((3, 1))},
                actions=np.zeros((2, 1), np.float32),
                hand_actions=np.zeros((2, 7), np.float32),
                successes=np.array([False, True]),
                interventions=np.array([False, self.corrected[index]]),
                facts={"scene": scene_of(config.env), "episode": index, "mark": "success"},
            ).write(folder / f"{index:06d}{SUFFIX}")

    def merge(self, parts, root):
        self.sizes[root] = sum(self.sizes[part] for part in parts)
        return SimpleNamespace(num_episodes=self.sizes[root])

    def train_run(self, config):
        self.trainings.append(config)
        size = self.sizes[Path(config.dataset)]
        where = config.env.only or config.env.level
        tested = [cell for cell in protocol_of(config.evaluate).cells() if cell.instruction_test is None]
        rates = [size / 100 if where in (cell.only, cell.level) else 1.0 for cell in tested]
        cells = [SimpleNamespace(cell=c, success_rate=rate) for c, rate in zip(tested, rates, strict=True)]
        evaluation = SimpleNamespace(result=SimpleNamespace(cells=lambda: cells))
        return SimpleNamespace(folder=Path(config.run), evaluations=[evaluation])


@pytest.fixture
def world(monkeypatch):
    made = World()
    for name in ("collect_dataset", "teleoperate", "merge", "train_run"):
        monkeypatch.setattr(correction_study, name, getattr(made, name))
    return made


def study(folder, *more, **settings):
    sizes = {"start": 10, "per_round": 5, "rounds": 1, "out": folder / "study"}
    return CorrectionStudy(StudySettings(**sizes | settings), [f"runs_dir={folder / 'runs'}", *more])


def test_a_success_without_the_expert_is_no_correction(world, tmp_path):
    world.corrected = [True, False, False, True, False, *[True, False, False, False, False]]
    rows = study(tmp_path, rounds=2).run()
    assert rows == [(10, 10.0, 10.0), (12, 12.0, 12.0), (13, 13.0, 13.0)]
    sizes = {f"{path.parent.name}/{path.name}": size for path, size in world.sizes.items()}
    assert sizes == {
        **{"round0/corrections": 10},
        **{"round1/corrections-alone": 2, "round1/corrections": 12, "round1/plain": 12},
        **{"round2/corrections-alone": 3, "round2/corrections": 13, "round2/plain": 13},
    }


def test_a_round_without_a_correction_keeps_the_policies(world, tmp_path, caplog):
    world.corrected = [False] * 5 + [True] * 5
    with caplog.at_level(logging.INFO):
        rows = study(tmp_path, rounds=2).run()
    assert rows == [(10, 10.0, 10.0), (10, 10.0, 10.0), (15, 15.0, 15.0)]
    assert "Round 1: the policy needed no correction" in caplog.text and "Round 2" not in caplog.text
    assert len({config.checkpoint for config in world.steered}) == 1, "the first policy acts in both rounds"


def test_a_continued_study_takes_no_corrections_of_later_rounds(world, tmp_path):
    world.corrected = [True, False, False, False, False, *[True] * 5]
    first = study(tmp_path, rounds=2)
    assert first.run() == first.run() == [(10, 10.0, 10.0), (11, 11.0, 11.0), (16, 16.0, 16.0)]


def test_every_collection_and_policy_has_the_same_environment(world, tmp_path):
    world.corrected = [True] * 5
    words = ["robot=ur5e", "simulator=mujoco_warp", "simulator_settings.njmax=99", "cameras=[wrist]"]
    words += ["scenario.physics.decimation=7", "only=camera", "image_size=48"]
    words += ["materials=images", "device=cpu", "collect.num_envs=3", "collect.num_workers=2"]
    study(tmp_path, *words, level=0).run()
    env = world.trainings[0].env
    assert (env.robot, env.only, env.materials, env.level) == ("ur5e", "camera", "images", 0)
    assert (env.simulator, dict(env.simulator_settings)) == ("mujoco_warp", {"njmax": 99})
    assert (env.cameras, env.image_size, env.renderer) == (("wrist",), 48, "warp")
    assert [config.source for config in world.collections] == ["expert", "teleop", "expert"]
    for config in [*world.trainings, *world.collections, *world.steered]:
        assert config.env == env
    for config in world.collections:
        assert (config.collect.num_envs, config.collect.num_workers) == (3, 2)
    assert world.steered[0].device == "cpu" and world.steered[0].actor == "expert"


@pytest.mark.parametrize(
    ("word", "advice"),
    [
        ("evaluate.levels=[0,3]", "give level=<level>"),
        ("levels=[0,3]", "give level=<level>"),
        ("evaluate.splits=[train]", "leave it out"),
        ("splits=[train]", "leave it out"),
        ("dataset=datasets/mine", "give out=<folder>"),
        ("run=runs/mine", "give runs_dir=<folder>"),
        ("num_demos=50", "give start=<number> and per_round=<number>"),
        ("collect.num_demos=50", "give start=<number> and per_round=<number>"),
        ("source=augment", "leave it out"),
    ],
)
def test_words_that_the_study_sets_itself_are_refused(word, advice, world, tmp_path, caplog):
    assert main([f"out={tmp_path / 'study'}", word]) == 2
    assert f"{word} is not for a study: " in caplog.text and advice in caplog.text
    assert not world.collections


def test_more_demonstrations_than_there_are_end_before_the_first_collection(world, tmp_path, caplog):
    assert main(["start=200", "per_round=1000000", "rounds=1", f"out={tmp_path / 'study'}"]) == 2
    assert "given 1,000,200" in caplog.text and not world.collections


def test_the_level_is_read_where_channels_are_tested_alone_too(world, tmp_path):
    world.corrected = [True] * 5
    assert study(tmp_path, "evaluate.alone=[camera]").run() == [(10, 10.0, 10.0), (15, 15.0, 15.0)]


@pytest.mark.parametrize(
    ("words", "evaluated"),
    [
        (["only=camera"], ((), ("camera",))),
        (["only=camera+lighting", "evaluate.alone=[camera]"], ((), ("camera+lighting", "camera"))),
        (["only=camera", "evaluate.alone=[lighting,camera]"], ((), ("camera", "lighting"))),
        (["only=camera", "evaluate.instructions=[wrong]"], ((0,), ("camera",))),
    ],
)
def test_a_channel_that_varies_alone_is_tested_alone(words, evaluated, world, tmp_path):
    world.corrected = [True] * 5
    assert study(tmp_path, *words, level=0).run() == [(10, 10.0, 10.0), (15, 15.0, 15.0)]
    for config in world.trainings:
        assert (config.evaluate.levels, config.evaluate.alone) == evaluated
        assert config.evaluate.splits == ("test",)
        assert Path(config.run).name.startswith(f"study-{config.env.only}-alone-seed0-")


def test_the_task_alone_is_tested_at_level_0(world, tmp_path):
    world.corrected = [True] * 5
    study(tmp_path, "only=task", level=0).run()
    assert {(each.evaluate.levels, each.evaluate.alone) for each in world.trainings} == {((0,), ())}


def test_studies_of_other_settings_have_other_runs_in_one_folder(world, tmp_path):
    world.corrected = [True] * 9
    studies = [{}, {"start": 9}, {"per_round": 4}, {"rounds": 2, "per_round": 4}]
    for number, settings in enumerate(studies):
        study(tmp_path, **settings, out=tmp_path / f"study{number}").run()
    runs = [{each.run for each in world.trainings if f"study{i}/" in each.dataset} for i in range(4)]
    assert len(runs[0] | runs[1] | runs[2]) == 9
    assert runs[2] < runs[3], "more rounds continue a study"


def test_another_study_in_the_same_folder_is_refused_before_its_collection(world, tmp_path, caplog):
    world.corrected = [True] * 5
    words = ["rounds=1", f"out={tmp_path / 'study'}", f"runs_dir={tmp_path / 'runs'}", "start=10"]
    assert main([*words, "per_round=5"]) == main([*words, "per_round=5", "device=cpu"]) == 0
    done = len(world.collections)
    assert main([*words, "per_round=4"]) == 2
    assert "was begun with per_round=5; now given: per_round=4" in caplog.text
    assert len(world.collections) == done


def words(folder):
    return [
        *("task=PickCube", "level=0", "start=2", "per_round=1", "rounds=1", f"out={folder / 'study'}"),
        *("image_size=32", "cameras=[front]", "device=cpu", "slow_ok=true", "collect.num_workers=1"),
        *("train.steps=2", "train.batch_size=2", "train.num_threads=1", "policy.dim_model=32"),
        *("policy.n_heads=2", "evaluate.episodes=1", "evaluate.videos=0", f"runs_dir={folder / 'runs'}"),
        f"results_dir={folder / 'results'}",
    ]


@pytest.mark.long
def test_a_round_of_corrections_is_compared_with_as_many_plain_demonstrations(tmp_path, caplog):
    with caplog.at_level(logging.INFO):
        assert main(words(tmp_path)) == 0
    lines = [record.message for record in caplog.records if "with corrections" in record.message]
    assert [line.split()[0] for line in lines] == ["2", "3"]
    rounds = tmp_path / "study/round1"
    merged, plain = (DatasetInfo.open(rounds / name) for name in ("corrections", "plain"))
    assert merged.num_episodes == plain.num_episodes == 3
    alone = DatasetInfo.open(rounds / "corrections-alone")
    assert alone.num_episodes == 1 and alone.read_columns()["intervention"].all()
    (facts,) = open_recordings(tmp_path / "study/recordings").values()
    assert facts["policy"] and facts["mark"] == "success"
    weights = {path: path.read_bytes() for path in (tmp_path / "runs").rglob("model.safetensors")}
    assert len(list((tmp_path / "runs/PickCube/act").iterdir())) == 3
    assert main(words(tmp_path)) == 0, "what is done is done"
    assert {path: path.read_bytes() for path in (tmp_path / "runs").rglob("model.safetensors")} == weights


def test_wrong_words_end_before_the_first_collection(tmp_path, caplog):
    assert main([*words(tmp_path), "train.stepz=2"]) == 2
    assert "train.stepz" in caplog.text and not (tmp_path / "study").exists()
