"""Several tasks in one command: from its words to a result of each task."""

import re
import shutil
from importlib.util import find_spec

import pytest

import policies
from benchmark.results import read_result
from envs.core.errors import ConfigError, PolicyError, UnknownNameError
from envs.spec import EnvSpec
from envs.tasks.suites import suite_tasks
from policies.checkpoint import learned_tasks
from policies.mtact.policy import MtActPolicy
from roboverse_learn import cli
from roboverse_learn.collect import dataset_folder
from roboverse_learn.commands.collected import joined_hash, of_task
from roboverse_learn.commands.run_folder import read_facts
from roboverse_learn.commands.run_identity import identity
from roboverse_learn.config.compose import compose, configs_folder
from roboverse_learn.config.recipes import TASKS, find_recipes
from roboverse_learn.data import DatasetWriter
from roboverse_learn.data.sources import SOURCES
from roboverse_learn.training.learners import learner_of
from roboverse_learn.training.metrics import read_metrics
from roboverse_learn.training.reporter import Reporter
from tests.roboverse_learn.data.synthetic_episodes import FEATURES, make_episode

LIST = "task=[PickCube,StackCube]"
TINY = (
    *("preset=quick", "image_size=32", "device=cpu", "slow_ok=true", "cameras=[front]"),
    *("num_demos=2", "collect.num_workers=1", "collect.num_envs=2"),
    *("train.steps=4", "batch_size=4", "save_every=4", "log_every=1", "train.num_threads=1"),
    *("policy.dim_model=32", "policy.dim_feedforward=32", "policy.n_heads=2", "policy.conv_channels=[8,16]"),
    *("policy.chunk_size=50", "policy.n_action_steps=50", "policy.num_buckets=64"),
    *("levels=[0]", "splits=[test]", "episodes=1", "evaluate.num_envs=1", "videos=0"),
)


@pytest.mark.parametrize(
    "words",
    [[LIST], ["task=PickCube", "policy.tasks=[StackCube]"], ["task=[ PickCube , StackCube ]"]],
)
def test_a_list_of_tasks_is_the_first_and_those_that_are_learned_with_it(words):
    config = compose("train", ["policy=mtact", *words])
    assert config.tasks == ("PickCube", "StackCube")
    assert config.env.task == "PickCube" and config.policy.tasks == ("StackCube",)
    assert identity(config) == identity(compose("train", ["policy=mtact", LIST]))


def test_a_program_gives_a_list():
    config = compose("train", [], {"policy": "mtact", "task": ["PickCube", "StackCube", "CloseBox"]})
    assert config.tasks == ("PickCube", "StackCube", "CloseBox")


def test_one_task_in_brackets_is_one_task():
    assert compose("train", ["policy=act", "task=[PickCube]"]).tasks == ("PickCube",)


def test_each_task_is_collected_alone_into_the_dataset_that_it_has_without_the_others():
    from roboverse_learn.collect import dataset_folder

    config = compose("train", ["policy=mtact", LIST])
    for task in config.tasks:
        own = of_task(config, task)
        assert own.tasks == (task,)
        assert dataset_folder(own) == dataset_folder(compose("train", ["policy=mtact", f"task={task}"]))


def test_options_that_every_task_has_are_those_of_each():
    config = compose("train", ["policy=mtact", LIST, "task_kwargs.qpos_noise_rad=0.05"])
    for task in config.tasks:
        own = of_task(config, task)
        assert own.env.make_task().qpos_noise_rad == 0.05
        alone = compose("train", ["policy=mtact", f"task={task}", "task_kwargs.qpos_noise_rad=0.05"])
        assert dataset_folder(own) == dataset_folder(alone)
    assert not compose("train", ["policy=mtact", LIST, "task_kwargs.qpos_noise_rad=0.02"]).env.task_kwargs


def test_the_hash_of_several_datasets_depends_on_each_and_on_their_order():
    assert joined_hash(["a"]) == "a"
    assert len({joined_hash(["a", "b"]), joined_hash(["b", "a"]), joined_hash(["a", "c"])}) == 3


@pytest.mark.parametrize(
    ("words", "error", "said"),
    [
        (
            ["policy=act", LIST],
            ConfigError,
            r"\[PickCube,StackCube\] are several, and policy=act learns",
        ),
        (["policy=mtact", "task=[PickCube,PickCube]"], ConfigError, "'PickCube' is learned twice"),
        (["policy=mtact", "task=[PickCub,StackCube]"], UnknownNameError, "Did you mean 'PickCube'"),
        (["policy=mtact", "task=[]"], UnknownNameError, "task ''"),
        (["policy=mtact", "task=[PickCube,StackCub]"], UnknownNameError, "Did you mean 'StackCube'"),
        (
            ["policy=mtact", LIST, "scenario.physics.decimation=5"],
            ConfigError,
            r"scenario.\* change one task, and 2 are",
        ),
        (
            ["policy=mtact", LIST, "task_kwargs.detour_m=0.02"],
            UnknownNameError,
            "Unknown option of PickCube 'detour_m'",
        ),
        (
            ["policy=mtact", "task=[StackCube,PickCube]", "task_kwargs.detour_m=0.02"],
            UnknownNameError,
            "Unknown option of PickCube 'detour_m'",
        ),
        (
            ["policy=mtact", LIST, "task_kwargs.approach_noise_m=0.01"],
            ConfigError,
            r"task_kwargs.approach_noise_m=0.01 is the default of StackCube and not of PickCube",
        ),
        (
            ["policy=mtact", LIST, "task_kwargs.approach_noise_m=0.015"],
            ConfigError,
            r"task_kwargs.approach_noise_m=0.015 is the default of PickCube and not of StackCube",
        ),
    ],
)
def test_tasks_that_cannot_be_learned_together_are_errors(words, error, said):
    with pytest.raises(error, match=said):
        compose("train", words)


def test_demonstrations_of_one_task_are_no_source_of_several():
    config = compose("train", ["policy=mtact", LIST, "source=augment", "from=x"])
    with pytest.raises(ConfigError, match=r"source=augment gives demonstrations of one task.*dataset merge"):
        learner_of(config, "cpu").check()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ["suite=calvin", "cameras=[front,wrist]"],
            r"cameras=\[front,wrist\] must be .* calvin/D/rotate_red_block_right has static, gripper\. Name",
        ),
        (
            ["suite=calvin", "cameras=[front]"],
            r"Name those that all have, as in cameras=\[static,gripper\]\.",
        ),
        (
            ["task=[PickCube,calvin/D/open_drawer]", "cameras=[front]"],
            r"calvin/D/open_drawer has static, gripper\. The tasks have no camera in common: learn",
        ),
        (
            ["task=[PickCube,calvin/D/open_drawer]"],
            r"PickCube and calvin/D/open_drawer cannot .* front of 64 × 64, the other static of 64 × 64",
        ),
        (
            ["task=[PickCube,so101/pick_cube]", "cameras=[front]"],
            r"images front of 64 × 64, the other front of 86 × 64",
        ),
    ],
)
def test_tasks_of_other_images_are_refused_before_demonstrations_are_collected(words, said):
    config = compose("train", ["policy=mtact", "image_size=64", *words])
    with pytest.raises(ConfigError, match=said):
        learner_of(config, "cpu").check()


def test_tasks_of_the_same_images_can_be_learned_together():
    learner_of(compose("train", ["policy=mtact", "suite=calvin", "cameras=[all]"]), "cpu").check()


def test_a_dataset_of_one_task_is_none_of_several(tmp_path):
    root = tmp_path / "dataset"
    with DatasetWriter(root, fps=20, features=FEATURES) as writer:
        writer.add_episode(make_episode(0))
    config = compose("train", ["policy=mtact", LIST, f"dataset={root}"])
    with pytest.raises(ConfigError, match=r"has demonstrations of PickCube alone, and the run is of P"):
        learner_of(config, "cpu").check()


def test_the_tasks_of_one_dataset_are_mixed_by_their_frames(tmp_path):
    with DatasetWriter(tmp_path, fps=20, features=FEATURES) as writer:
        for index in range(4):
            episode = make_episode(index, length=5)
            episode.metadata["task"] = "PickCube" if index else "StackCube"
            writer.add_episode(episode)
    words = ["policy=mtact", "task=PickCube", f"dataset={tmp_path}", "train.mixing=1"]
    learner_of(compose("train", [*words, "train.batch_size=4"]), "cpu").check()
    with pytest.raises(ConfigError, match=r"batch_size=3 must .* of 2 tasks, .* a share of 0\.75\. Give"):
        learner_of(compose("train", [*words, "train.batch_size=3"]), "cpu").check()


@pytest.mark.parametrize(
    ("mixing", "said"), [("0", "batch_size=2 or more"), ("1", "batch_size of at least 2: with")]
)
def test_a_batch_that_is_too_small_is_refused_before_lengths_are_known(mixing, said):
    words = ["policy=mtact", LIST, "train.batch_size=1", f"train.mixing={mixing}"]
    with pytest.raises(ConfigError, match=rf"batch_size=1 must .* of 2 tasks, .* Give train\.{said}"):
        learner_of(compose("train", words), "cpu").check()


@pytest.mark.slow
def test_a_merged_dataset_is_learned_by_the_tasks_that_its_episodes_name(tmp_path, monkeypatch):
    root = tmp_path / "merged"
    with DatasetWriter(root, fps=20, features=FEATURES) as writer:
        for index, task in enumerate(("StackCube", "PickCube")):
            episode = make_episode(index, task=f"do {task}")
            episode.metadata["task"] = task
            writer.add_episode(episode)
    heard, learn = [], MtActPolicy.learn_instructions
    monkeypatch.setattr(
        MtActPolicy, "learn_instructions", lambda self, given: heard.append(given) or learn(self, given)
    )
    words = ["policy=mtact", LIST, f"dataset={root}", *TINY, "swap_wordings=true", "bank_wordings=true"]
    learner = learner_of(compose("train", words), "cpu")
    learner.check()
    result = learner.learn(tmp_path / "run", str(root), 0, Reporter())
    assert learned_tasks(result.checkpoint) == ("StackCube", "PickCube")
    assert heard[-1].texts[:2] == ("do StackCube", "do PickCube") and len(heard[-1].texts) > 200
    row = read_metrics(tmp_path / "run")[-1]
    assert row["loss"] == pytest.approx((row["l1_loss/StackCube"] + row["l1_loss/PickCube"]) / 2, rel=1e-4)


def test_the_recipe_of_the_papers_tasks_is_no_recipe_of_the_table():
    config = compose("train", ["recipe=mtact_paper"])
    assert config.tasks == TASKS and config.recipe == "mtact_paper"
    assert config.train.batch_size % len(config.tasks) == 0
    assert "mtact_paper" not in find_recipes("v1", configs_folder() / "recipe")
    alone = compose("train", ["recipe=mtact_paper", "task=CloseBox"])
    assert alone.tasks == ("CloseBox",)


def test_the_recipe_of_the_papers_tasks_learns_from_the_datasets_of_the_table():
    config = compose("train", ["recipe=mtact_paper", "level=3"])
    for task in config.tasks:
        own = of_task(config, task)
        table = compose("train", ["recipe=act_v1", "level=3", f"task={task}"])
        assert dataset_folder(own) == dataset_folder(table)
        assert SOURCES.get(own.source)(own).settings() == SOURCES.get(table.source)(table).settings()


LIBERO_CAMERAS = ("agentview", "robot0_eye_in_hand")
NEEDS_LIBERO = pytest.mark.skipif(find_spec("libero") is None, reason="needs the extra libero")


@pytest.mark.parametrize(
    ("recipe", "suite", "cameras"),
    [
        ("mtact_calvin", "calvin", ("static", "gripper")),
        pytest.param("mtact_libero", "libero_10_expert", LIBERO_CAMERAS, marks=NEEDS_LIBERO),
        pytest.param("mtact_libero_short", "libero_object", LIBERO_CAMERAS, marks=NEEDS_LIBERO),
    ],
)
def test_the_recipes_of_suites_see_all_cameras_and_every_task_in_each_batch(recipe, suite, cameras):
    config = compose("train", [f"recipe={recipe}", f"suite={suite}"])
    assert config.tasks == suite_tasks(suite) and config.env.cameras == cameras
    assert config.train.batch_size % len(config.tasks) == 0
    assert config.env.task_kwargs == ({"starts": "chain"} if suite == "calvin" else {})
    learner_of(config, "cpu").check()


@pytest.mark.parametrize(
    ("recipe", "sets"),
    [("mtact_grasp", ["few", "many"]), ("mtact_grasp_colours", ["few", "many", "colours"])],
)
def test_a_recipe_of_grasping_has_all_tasks_of_its_sets_and_none_of_the_unseen(recipe, sets):
    config = compose("train", [f"recipe={recipe}"])
    assert config.tasks == tuple(task for name in sets for task in suite_tasks(f"grasp/{name}"))
    assert not set(config.tasks) & set(suite_tasks("grasp/unseen"))
    assert config.train.batch_size % len(config.tasks) == 0
    assert recipe not in find_recipes("v1", configs_folder() / "recipe")


@pytest.mark.slow
def test_one_command_trains_and_evaluates_each_task(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["train", "policy=mtact", LIST, *TINY, "evaluate.instructions=[known,new_words]"]) == 0
    (run,) = (tmp_path / "runs/PickCube/mtact").iterdir()
    checkpoint = run / "checkpoints/last/pretrained_model"
    assert learned_tasks(checkpoint) == ("PickCube", "StackCube")
    facts = read_facts(run, "collect")
    assert list(facts["folder"]) == ["PickCube", "StackCube"] and facts["num_episodes"] == 4
    for task in learned_tasks(checkpoint):
        result = read_result(tmp_path / "results/v2" / task / "mtact" / f"{run.name}.json")
        assert result.train_tasks == ("PickCube", "StackCube")
        assert (result.env.task, result.demonstrations) == (task, 4)
        assert result.dataset_hash == facts["dataset_hash"]
        asked = {record.instruction_test: record.instruction for record in result.records}
        bank = EnvSpec(task=task).make_task().wordings(asked[None])
        assert asked["known"] in bank.known and asked["new_words"] in bank.new_words
    said = capsys.readouterr().out
    assert "together with StackCube" in said and "Demonstrations of 2 tasks" in said
    assert "mtact: success with known wordings and with held-out ones" in said
    over_all = next(line for line in said.splitlines() if re.search(r"\ball\b.*new words", line))
    assert over_all.count(" %") == 2

    # One of its tasks by itself, with the checkpoint at another place; and one that it did not learn.
    moved = tmp_path / "moved" / "checkpoint"
    moved.parent.mkdir()
    shutil.copytree(checkpoint, moved)
    words = ["levels=[0]", "splits=[test]", "episodes=1", "videos=0", "device=cpu"]
    assert cli.main(["evaluate", f"checkpoint={moved}", "task=StackCube", *words]) == 0
    policy = policies.load(moved)
    assert {name: sizes["action"] for name, sizes in policy.model.config.tasks.items()}.keys() == {
        "PickCube",
        "StackCube",
    }
    with pytest.raises(PolicyError, match="learned the tasks PickCube and StackCube, not CloseBox"):
        from roboverse_learn.evaluate import evaluate_all

        evaluate_all(compose("evaluate", [f"checkpoint={checkpoint}", "task=CloseBox", *words]))
