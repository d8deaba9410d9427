"""Labels that distinguish the rows of one section."""

import pytest

from benchmark.leaderboard import build as leaderboard
from benchmark.protocol import Protocol


def rows(tmp_path):
    return [row for section in leaderboard.build(tmp_path)["sections"] for row in section["rows"]]


def settings_of(chunk=20, shift=0, **train):
    return {"policy": {"chunk_size": chunk}, "train": {"lr": 1e-4, "augment": {"shift_px": shift}, **train}}


def test_row_labels_name_the_setting_that_differs(publish, tmp_path):
    """Also where both have the same seed, or where each is the only run of its seed."""
    publish(run="plain", config=settings_of())
    publish(run="shifted", config={"policy": {"chunk_size": 20}, "run": settings_of(shift=4)})
    publish(run="both", seed=1, config=settings_of(shift=4, chunk=10))
    found = {row["label"]: [run["run"] for run in row["runs"]] for row in rows(tmp_path)}
    assert found == {
        "act, chunk_size 20, shift_px 0": ["plain"],
        "act, chunk_size 20, shift_px 4": ["shifted"],
        "act, chunk_size 10": ["both"],
    }


def test_a_policy_of_another_robot_is_a_row_of_its_own(publish, tmp_path):
    """Beside what was trained on the robot that is tested, and never a further seed of that."""
    trained = {"simulator": "mujoco", "renderer": "warp"}
    config = {"policy": {}, "run": trained, "learned_robots": ["franka", "ur5e"]}
    publish(run="native", robot="iiwa", config={"policy": {}, **trained})
    publish(run="moved", seed=1, robot="iiwa", config=config)
    publish(run="from_afar", robot="iiwa", config={**config, "run": {**trained, "simulator": "sapien"}})
    publish(run="of_no_run", robot="iiwa", config={"policy": {}, "learned_robots": ["franka"]})
    assert {row["label"]: row["runs"][0]["run"] for row in rows(tmp_path)} == {
        "act": "native",
        "act, trained in scenes with franka and ur5e": "moved",
        "act, trained in sapien, rendered with warp, with franka and ur5e": "from_afar",
        "act, trained in scenes with franka": "of_no_run",
    }


def test_an_evaluation_of_single_channels_is_marked(publish, tmp_path):
    publish(run="levels", protocol=Protocol(episodes=10))
    publish(run="channels", protocol=Protocol(episodes=10, only=("camera", "lighting")))
    assert {row["label"] for row in rows(tmp_path)} == {"act", "act, tested on single channels too"}


def test_settings_of_one_name_are_labelled_with_their_keys(publish, tmp_path):
    for lr in (1, 2):
        for batch in (8, 16):
            config = {"policy": {"lr": lr}, "train": {"lr": batch, "name": "x"}}
            publish(run=f"{lr}-{batch}", config=config)
    assert {row["label"] for row in rows(tmp_path)} == {
        f"act, policy.lr {lr}, train.lr {batch}" for lr in (1, 2) for batch in (8, 16)
    }


def test_a_setting_that_is_younger_than_a_run_had_its_default(publish, tmp_path):
    younger = settings_of()
    younger["train"] |= {"ema": None, "betas": [0.9, 0.95]}
    younger["train"]["augment"] |= {"contrast": 0.0}
    younger["policy"] |= {"dropout": 0.1}
    publish(seed=0, run="older", config=settings_of())
    publish(seed=1, run="younger", config=younger)
    publish(seed=2, run="tested", config={"policy": settings_of()["policy"], "run": younger})
    publish(seed=3, run="other", config=settings_of(betas=[0.9, 0.99]))
    train = {"ema": None, "betas": (0.9, 0.95), "augment": {"contrast": 0.0, "shift_px": 8}}
    (section,) = leaderboard.build(tmp_path, train)["sections"]
    assert {row["label"]: row["seeds"] for row in section["rows"]} == {
        "act, betas [0.9,0.95]": [0, 1, 2],
        "act, betas [0.9,0.99]": [3],
    }


def test_irrelevant_settings_do_not_split_rows(publish, tmp_path):
    """Nor does a setting that an older run did not record: it may have had it."""
    publish(run="first", config=settings_of(save_every=5, num_threads=1))
    publish(run="again", config=settings_of(save_every=7, num_threads=2), created="2026-04-01T00:00:00Z")
    publish(run="other", seed=1, config=settings_of(log_every=3, compile=True))
    publish(run="newer", seed=2, config=settings_of(ema=True))
    found = {row["label"]: row["seeds"] for row in rows(tmp_path)}
    assert found == {"act, first": [0, 1], "act, again": [0], "act, newer": [2]}


@pytest.mark.parametrize(
    ("trained", "said"),
    [
        ({"materials": "+images"}, "training materials +images"),
        ({"scenario": {"room": None}}, 'training scenario {"room":null}'),
        ({"collect": {"steps_per_look": 4}}, "steps_per_look 4"),
    ],
)
def test_what_was_trained_in_another_scene_is_a_row_of_its_own(publish, tmp_path, trained, said):
    publish(config={"policy": {}})
    publish(run="other", config={"policy": {}, **trained})
    assert any(row["label"].endswith(said) for row in rows(tmp_path))


def test_row_labels_name_evaluation_materials(publish, tmp_path):
    publish()
    publish(run="images", materials="+images-1a2b3c4d")
    assert sorted(row["label"] for row in rows(tmp_path)) == [
        "act, materials +images-1a2b3c4d",
        "act, materials built-in",
    ]


def test_multi_task_row_names_other_tasks_in_any_order(publish, tmp_path):
    publish(config={"policy": {"tasks": []}})
    for seed, tasks in enumerate([("PickCube", "b", "a"), ("b", "PickCube", "a")]):
        config = {"policy": {"tasks": list(tasks[1:])}}
        publish(run=f"together{seed}", seed=seed, config=config, train_tasks=tasks)
    publish(run="many", train_tasks=("PickCube", *"abcd"), config={"policy": {"tasks": list("abcd")}})
    found = {row["label"]: (row["seeds"], row.get("learned_with")) for row in rows(tmp_path)}
    assert found == {
        "act": ([0], None),
        "act, learned with a and b": ([0, 1], ["a", "b"]),
        "act, learned with 4 further tasks": ([0], ["a", "b", "c", "d"]),
    }


@pytest.mark.parametrize("unlearned", [{"train_tasks": ("PickCube",)}, {"config": {"task": "PickCube"}}])
def test_a_row_in_a_task_that_was_not_learned_names_the_one_that_was(publish, tmp_path, unlearned):
    publish(task="StackCube", **unlearned)
    ((label, learned),) = [(row["label"], row["learned_with"]) for row in rows(tmp_path)]
    assert (label, learned) == ("act, trained on PickCube", ["PickCube"])


def test_a_row_in_a_task_beside_those_that_were_learned_says_on_which(publish, tmp_path):
    publish(task="StackCube", train_tasks=("PickCube", "CloseBox"))
    assert [row["label"] for row in rows(tmp_path)] == ["act, trained on CloseBox and PickCube"]


def test_a_row_in_a_task_beside_many_that_were_learned_says_how_many(publish, tmp_path):
    publish(task="StackCube", train_tasks=("PickCube", "CloseBox", "NutAssembly", "DoorClose"))
    assert [row["label"] for row in rows(tmp_path)] == ["act, trained on 4 other tasks"]
