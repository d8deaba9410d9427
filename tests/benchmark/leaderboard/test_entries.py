"""Which results are entries, which are studies, and that success decides none of it."""

import pytest

from benchmark.leaderboard import build as leaderboard
from benchmark.protocol import Protocol
from benchmark.records import Checkpoint

TEN = Protocol(episodes=10)


def settings(preset="gpu", steps=2000, **train):
    values = {"steps": steps, "time_limit_s": None, "lr": 1e-4, **train}
    return {"preset": preset, "policy": {"chunk_size": 20}, "train": values, "cameras": ["front"]}


def kinds(tmp_path):
    return {
        run["run"]: row["kind"]
        for section in leaderboard.build(tmp_path)["sections"]
        for row in section["rows"]
        for run in row["runs"]
    }


def changed(**more):
    """What a result of a preset has whose command changed a value of it."""
    command = "python roboverse_learn/train.py policy=act preset=gpu train.steps=2000"
    return {"recipe": "", "config": settings(), "command": command} | more


def test_a_recipe_is_an_entry_and_its_seeds_are_one_row(publish, tmp_path):
    for seed in range(2):
        publish(seed=seed)
    board = leaderboard.build(tmp_path)
    (entry,) = board["entries"].values()
    assert (entry["kind"], entry["name"], entry["learned_from"]) == ("recipe", "act_v1", "demonstrations")
    (row,) = board["sections"][0]["rows"]
    assert (row["kind"], row["entry"], row["seeds"]) == ("entry", entry["id"], [0, 1])


def test_networks_of_several_tasks_name_their_family_in_place_of_a_variant(publish, tmp_path):
    for family in ("libero/goal", "libero/object"):
        publish(run=family[7:], task=f"{family}/a", train_tasks=(f"{family}/a", f"{family}/b"))
    publish(run="mixed", task="PickCube", train_tasks=("PickCube", "libero/goal/a"))
    publish(run="own", task="PickCube", train_tasks=("PickCube", "StackCube"))
    entries = leaderboard.build(tmp_path)["entries"].values()
    assert sorted((each["label"], each["variant"]) for each in entries) == [
        ("act, 2 tasks in one", 1),
        ("act, 2 tasks in one", 2),
        ("act, 2 tasks of libero/goal in one", 0),
        ("act, 2 tasks of libero/object in one", 0),
    ]


def test_an_entry_keeps_its_id_when_training_gets_a_further_setting(publish, tmp_path):
    for task in ("PickCube", "StackCube"):
        publish(run=task, task=task, **changed())
    before = leaderboard.build(tmp_path, {"lr": 1e-5})["entries"]
    assert len(before) == 1
    assert leaderboard.build(tmp_path, {"lr": 1e-5, "mixing": 0.0})["entries"] == before
    publish(run="other", task="CloseBox", **changed(config=settings(lr=2e-4)))
    publish(run="another", task="PickCube", seed=1, **changed(config=settings(lr=2e-4)))
    assert len(leaderboard.build(tmp_path, {"lr": 1e-5})["entries"]) == 2, "a setting that differs counts"


def test_versions_of_a_recipe_are_different_entries(publish, tmp_path):
    publish()
    publish(run="two", recipe="act_v2")
    assert [each["name"] for each in leaderboard.build(tmp_path)["entries"].values()] == ["act_v1", "act_v2"]


@pytest.mark.parametrize(
    ("command", "kind"),
    [
        ("python roboverse_learn/train.py policy=act task=PickCube preset=quick seed=3", "entry"),
        (
            "python roboverse_learn/train.py policy=act preset=quick collect.num_workers=4 device=cuda",
            "entry",
        ),
        ("python roboverse_learn/train.py policy=act preset=quick 'evaluate.levels=[0]'", "entry"),
        ("python roboverse_learn/train.py policy=act preset=quick train.lr=1", "study"),
        ("python roboverse_learn/train.py policy=act preset=quick num_demos=9", "study"),
        ("python roboverse_learn/train.py policy=ppo preset=quick policy.num_envs=128", "study"),
        ("python roboverse_learn/evaluate.py checkpoint=x", "study"),
        ("an 'open quotation mark", "study"),
        ("", "study"),
    ],
)
def test_a_preset_counts_where_its_keys_were_left_as_they_are(publish, tmp_path, command, kind):
    publish(run="one", recipe="", config=settings("quick"), command=command)
    assert kinds(tmp_path) == {"one": kind}


def test_a_changed_preset_counts_where_two_tasks_learned_with_one_budget_at_one_level(publish, tmp_path):
    publish(run="cube", **changed())
    assert kinds(tmp_path) == {"cube": "study"}
    publish(run="box", task="CloseBox", train_level=3, **changed())
    assert kinds(tmp_path) == {"cube": "study", "box": "study"}, "of different levels"
    publish(run="stack", task="StackCube", **changed())
    assert kinds(tmp_path) == {"cube": "entry", "box": "study", "stack": "entry"}


@pytest.mark.parametrize(
    "other",
    [
        {"demonstrations": 900},
        {"config": settings(lr=1e-3)},
        {"config": settings("full")},
        {"checkpoint": Checkpoint(step=3000, hash="ab" * 32), "config": settings(steps=3000)},
        {"policy": "diffusion"},
        {"image_size": 64, "config": settings() | {"image_size": 64}},
        {"config": settings() | {"collect": {"steps_per_look": 1}}},
    ],
)
def test_another_budget_is_not_shared(publish, tmp_path, other):
    publish(run="cube", **changed())
    publish(run="stack", task="StackCube", **changed(**other))
    assert kinds(tmp_path) == {"cube": "study", "stack": "study"}


def test_seconds_are_the_budget_where_a_clock_ended_the_training(publish, tmp_path):
    for task, step in (("PickCube", 900), ("StackCube", 1400)):
        publish(
            run=task,
            task=task,
            checkpoint=Checkpoint(step=step, hash="ab" * 32),
            **changed(config=settings(time_limit_s=60.0)),
        )
    (entry,) = leaderboard.build(tmp_path)["entries"].values()
    assert (entry["steps"], entry["time_s"]) == (None, 60.0)


def test_a_time_limit_that_was_not_reached_is_no_budget(publish, tmp_path):
    for task, limit in (("PickCube", 60.0), ("StackCube", 90.0)):
        config = settings(time_limit_s=limit)
        publish(
            run=task, task=task, checkpoint=Checkpoint(step=2048, hash="ab" * 32), **changed(config=config)
        )
    (entry,) = leaderboard.build(tmp_path)["entries"].values()
    assert (entry["steps"], entry["time_s"]) == (2048, None)


def test_what_is_trained_elsewhere_is_foreign_and_what_is_not_trained_is_a_baseline(publish, tmp_path):
    publish(run="theirs", recipe="", config={"command": {}, "policy": {"type": "act"}}, train_level=None)
    publish(
        run="random", policy="random", recipe="", config={"command": {}}, train_level=None, dataset_hash=None,
        demonstrations=None, checkpoint=Checkpoint(),
    )  # fmt: skip
    publish(run="ours", recipe="", config=settings(), command="x")
    (section,) = leaderboard.build(tmp_path)["sections"]
    found = {row["runs"][0]["run"]: (row["kind"], row["foreign"]) for row in section["rows"]}
    assert found == {"theirs": ("study", True), "random": ("baseline", False), "ours": ("study", False)}


@pytest.mark.parametrize("preset", [None, 3, "", "<script>", ["gpu"]])
def test_a_preset_without_a_valid_name_is_none(publish, tmp_path, preset):
    command = "python roboverse_learn/train.py policy=act"
    publish(run="one", recipe="", config=settings(preset), command=command)
    assert kinds(tmp_path) == {"one": "study"}


def test_a_run_that_is_repeated_does_not_replace_the_first(publish, tmp_path):
    publish(run="first", rates=(0.0,) * 4, protocol=TEN)
    publish(run="again", rates=(1.0,) * 4, protocol=TEN, created="2026-04-01T00:00:00Z")
    assert kinds(tmp_path) == {"first": "entry", "again": "study"}


def test_an_entry_shows_the_runs_with_most_seeds_then_most_episodes(publish, tmp_path):
    publish(run="few", protocol=Protocol(episodes=4))
    publish(run="many", protocol=TEN, created="2026-04-01T00:00:00Z")
    assert kinds(tmp_path) == {"few": "study", "many": "entry"}
    publish(run="few-1", seed=1, protocol=Protocol(episodes=4))
    assert kinds(tmp_path) == {"few": "entry", "few-1": "entry", "many": "study"}


def test_only_what_asks_the_same_is_compared(publish, tmp_path):
    publish()
    publish(policy="diffusion")
    publish(policy="third", train_level=3)
    publish(policy="fourth", recipe="")
    (section,) = leaderboard.build(tmp_path)["sections"]
    assert {(test["a"], test["b"]) for test in section["comparisons"]} in (
        {("act", "diffusion")},
        {("diffusion", "act")},
    )


@pytest.mark.parametrize(
    "unlearned",
    [
        {"train_tasks": ("PickCube",)},
        {"config": settings() | {"task": "PickCube"}},  # as older results have it
        {"config": {"run": settings() | {"task": "PickCube"}}},
        {"train_tasks": ("PickCube", "CloseBox")},
    ],
)
def test_a_task_that_was_not_learned_is_a_study_and_makes_no_entry_of_another(publish, tmp_path, unlearned):
    publish(run="cube", **changed())
    publish(run="moved", task="StackCube", **changed(**unlearned))
    assert kinds(tmp_path) == {"cube": "study", "moved": "study"}
    as_it_is = "python roboverse_learn/train.py policy=act preset=gpu"
    publish(run="again", task="StackCube", **changed(**unlearned, command=as_it_is))
    assert kinds(tmp_path) == {"cube": "study", "moved": "study", "again": "study"}


def test_a_recipe_is_no_entry_of_another_task_but_in_the_set_of_its_several(publish, tmp_path):
    publish(run="cube")
    publish(run="moved", task="StackCube", train_tasks=("PickCube",))
    publish(run="several", task="grasp/unseen/a", train_tasks=("grasp/few/a", "grasp/few/b"))
    publish(run="elsewhere", task="StackCube", train_tasks=("PickCube", "CloseBox"))
    publish(run="of_another_set", task="libero/a", train_tasks=("grasp/few/a", "grasp/few/b"))
    expected = {"cube": "entry", "moved": "study", "several": "entry"}
    assert kinds(tmp_path) == expected | {"elsewhere": "study", "of_another_set": "study"}


def test_the_task_of_a_run_of_a_given_dataset_is_not_known_to_be_learned(publish, tmp_path):
    publish(
        run="given", task="StackCube", **changed(config=settings() | {"task": "PickCube", "dataset": "d"})
    )
    ((row,),) = [section["rows"] for section in leaderboard.build(tmp_path)["sections"]]
    assert row["kind"] == "study" and "PickCube" not in row["label"]
