"""The rankings: one set of tasks, the two protocols apart, a minimum of episodes. All numbers by hand."""

import pytest

from benchmark.leaderboard import build as leaderboard
from benchmark.leaderboard import headline
from benchmark.leaderboard.html import render_html, render_markdown
from benchmark.leaderboard.labels import within
from benchmark.leaderboard.standings import standings
from benchmark.protocol import Protocol
from benchmark.statistics import wilson
from envs.core.registry import Registry

SIX = ("PickCube", "StackCube", "CloseBox", "MoveSliderLeft", "PickChocolatePudding", "NutAssembly")
ONE_LEVEL = Protocol(levels=(0,), splits=("test",))
ALL = (1.0, 1.0, 1.0, 1.0)
NONE = (0.0, 0.0, 0.0, 0.0)


def tables(tmp_path, protocol="A"):
    return leaderboard.build(tmp_path)["headline"][0]["protocols"][protocol]


def named(board, rows):
    return [(board["entries"][row["entry"]]["name"], row["rank"]) for row in rows]


@pytest.fixture
def two_entries(publish):
    """ACT solves the first three tasks, Diffusion Policy the first five; each task once, at level 0."""
    for index, task in enumerate(SIX):
        publish(task=task, protocol=ONE_LEVEL, rates=ALL if index < 3 else NONE)
        publish(task=task, protocol=ONE_LEVEL, rates=ALL if index < 5 else NONE, policy="diffusion")


def test_means_are_over_all_tasks_of_the_table_and_rank_the_entries(two_entries, tmp_path):
    board = leaderboard.build(tmp_path)
    (table,) = board["headline"]
    assert tuple(table["tasks"]) == SIX and table["suite"] == "RoboVerse"
    rows = table["protocols"]["A"]["0"]
    assert named(board, rows) == [("diffusion_v1", 1), ("act_v1", 2)]
    assert [row["mean"]["success_rate"] for row in rows] == [round(5 / 6, 6), 0.5]
    # Six cells of 100 episodes, all or none solved: each interval is of the same width, and three of ACT's
    # reach down and three up (Zou & Donner 2008).
    width = 1.0 - wilson(100, 100)[0]
    assert rows[1]["mean"]["ci_low"] == pytest.approx(0.5 - (3 * width**2) ** 0.5 / 6, abs=1e-6)
    assert rows[1]["mean"]["ci_high"] == pytest.approx(0.5 + (3 * width**2) ** 0.5 / 6, abs=1e-6)


def test_without_one_task_there_is_no_mean_and_the_task_is_named(two_entries, tmp_path):
    (tmp_path / "v2/NutAssembly/diffusion/diffusion-s0.json").unlink()
    board = leaderboard.build(tmp_path)
    first, second = board["headline"][0]["protocols"]["A"]["0"]
    assert named(board, [first, second]) == [("act_v1", 1), ("diffusion_v1", None)]
    assert second["mean"] is None and second["missing"] == ["NutAssembly"]
    assert len(second["cells"]) == 5


def test_a_cell_of_few_episodes_is_shown_and_not_ranked(two_entries, publish, tmp_path):
    (tmp_path / "v2/PickCube/act/act-s0.json").unlink()
    few = Protocol(levels=(0,), splits=("test",), episodes=99)
    publish(task="PickCube", protocol=few, rates=ALL)
    _, row = tables(tmp_path)["0"]
    assert (row["rank"], row["mean"], row["too_few"]) == (None, None, ["PickCube"])
    assert row["cells"]["PickCube"]["episodes"] == 99


def test_episodes_of_seeds_count_together(two_entries, publish, tmp_path):
    (tmp_path / "v2/PickCube/act/act-s0.json").unlink()
    fifty = Protocol(levels=(0,), splits=("test",), episodes=50)
    for seed in range(2):
        publish(task="PickCube", protocol=fifty, rates=ALL, seed=seed)
    _, row = tables(tmp_path)["0"]
    assert (row["rank"], row["cells"]["PickCube"]["episodes"]) == (2, 100)


def test_equal_means_share_a_rank(two_entries, publish, tmp_path):
    for index, task in enumerate(SIX):
        publish(task=task, protocol=ONE_LEVEL, rates=ALL if index > 2 else NONE, policy="third")
    board = leaderboard.build(tmp_path)
    rows = board["headline"][0]["protocols"]["A"]["0"]
    assert [row["rank"] for row in rows] == [1, 2, 2]


def test_the_protocols_are_apart(publish, tmp_path):
    """A has what was trained at level 0, at each level; B has each level of what was trained there."""
    for level in range(4):
        rates = tuple(float(tested <= level) for tested in range(4))
        publish(run=f"l{level}", train_level=level, rates=rates, protocol=Protocol(episodes=10))
    a, b = (tables(tmp_path, protocol) for protocol in "AB")
    rates = {
        name: [row["cells"]["PickCube"]["success_rate"] for (row,) in of.values()]
        for name, of in (("a", a), ("b", b))
    }
    assert list(a) == list(b) == ["0", "1", "2", "3"]
    assert rates == {"a": [1.0, 0.0, 0.0, 0.0], "b": [1.0, 1.0, 1.0, 1.0]}
    (section,) = leaderboard.build(tmp_path)["sections"]
    (of_a,), (of_b,) = standings(section).values()
    assert [len(of_a["rows"]), len(of_b["rows"])] == [1, 4]


@pytest.mark.parametrize(
    "change",
    [
        {"recipe": ""},  # a study
        {"task_kwargs": {"success": "lift"}},
        {"scenario": {"cameras": {"front": {"fovy_deg": 30.0}}}},
        {"config": {"policy": {}, "run": {"simulator": "sapien", "renderer": "sapien", "train": {}}}},
    ],
)
def test_results_that_are_not_comparable_are_in_no_ranking(publish, tmp_path, change):
    publish()
    publish(policy="diffusion", **change)
    board = leaderboard.build(tmp_path)
    shown = {
        row["entry"]
        for table in board["headline"]
        for of in table["protocols"].values()
        for rows in of.values()
        for row in rows
    }
    assert [board["entries"][entry]["name"] for entry in shown] == ["act_v1"]


def test_places_sources_and_families_are_ranked_apart(publish, tmp_path):
    publish()
    publish(run="there", simulator="sapien", renderer="sapien")
    publish(policy="ppo", demonstrations=None, dataset_hash=None)
    publish(policy="ppo", task="humanoid/walk", demonstrations=None, dataset_hash=None)
    publish(policy="ppo", task="DoorOpen", demonstrations=None, dataset_hash=None)
    found = [
        (table["suite"], table["learned_from"], table["simulator"], len(table["tasks"]))
        for table in leaderboard.build(tmp_path)["headline"]
    ]
    assert found == [
        ("RoboVerse", "demonstrations", "mujoco", 6),
        ("RoboVerse", "demonstrations", "sapien", 6),
        ("RoboVerse", "reward", "mujoco", 6),
        ("humanoid", "reward", "mujoco", 1),
        ("other tasks", "reward", "mujoco", 1),
    ]


def test_the_newest_result_dates_the_board(publish, tmp_path):
    publish()
    publish(run="later", seed=1, created="2026-05-02T03:04:05Z")
    assert leaderboard.build(tmp_path)["latest"] == "2026-05-02T03:04:05Z"
    assert "results of 2 May 2026" in render_html(leaderboard.build(tmp_path))


def test_the_page_ranks_and_names_what_is_missing(two_entries, tmp_path):
    (tmp_path / "v2/NutAssembly/diffusion/diffusion-s0.json").unlink()
    board = leaderboard.build(tmp_path)
    assert "lacks NutAssembly |\n" in render_markdown(board)
    assert 'title="not tested: NutAssembly"' in render_html(board)


def test_a_changed_horizon_is_another_section_and_the_newest_is_ranked(publish, tmp_path):
    publish(max_episode_steps=100)
    publish(policy="diffusion", created="2026-04-01T00:00:00Z", max_episode_steps=250)
    board = leaderboard.build(tmp_path)
    assert [section["id"] for section in board["sections"]] == [
        "v2-pickcube-mujoco-warp-100-steps-20-hz",
        "v2-pickcube-mujoco-warp-250-steps-20-hz",
    ]
    (table,) = board["headline"]
    assert [name for name, _ in named(board, table["protocols"]["A"]["0"])] == ["diffusion_v1"]
    page = render_html(board)
    assert ">MuJoCo, 100 steps</label>" in page and ">MuJoCo, 250 steps</label>" in page


def suites_of(board):
    return {table["suite"]: table["tasks"] for table in board["headline"]}


def test_suites_of_a_family_are_ranked_apart_and_columns_leave_out_the_suite(publish, tmp_path):
    for task in ("grasp/few/milk", "grasp/few/butter", "grasp/many/milk", "calvin/D/turn_on_led"):
        publish(task=task)
    board = leaderboard.build(tmp_path)
    assert suites_of(board) == {
        "grasp/few": ["grasp/few/butter", "grasp/few/milk"],
        "grasp/many": ["grasp/many/milk"],
        "calvin/D": ["calvin/D/turn_on_led"],
    }
    assert "| tested at | rank | policy | budget | butter | milk | mean |" in render_markdown(board)


def test_scenes_that_are_one_registered_suite_are_ranked_together(publish, tmp_path):
    tasks = ("grasp/colours_1/milk", "grasp/colours_2/butter", "calvin/A/turn_on_led", "calvin/B/turn_on_led")
    for task in tasks:
        publish(task=task)
    board = leaderboard.build(tmp_path)
    assert suites_of(board) == {
        "grasp/colours": ["grasp/colours_1/milk", "grasp/colours_2/butter"],
        "calvin_abc": ["calvin/A/turn_on_led", "calvin/B/turn_on_led"],
    }
    head = "| tested at | rank | policy | budget | colours_1/milk | colours_2/butter | mean |"
    assert head in render_markdown(board)


@pytest.mark.parametrize(
    ("suite", "names", "columns"),
    [
        ("a/b", ["a/b/pick_up_the_milk_now"], ["pick_up_the_milk_now"]),
        ("a/b", ["a/b/pick_up_the_milk_now", "a/b/pick_up_the_bbq_sauce_now"], ["milk_now", "bbq_sauce_now"]),
        ("a/b", ["a/b/milk_to_the_left", "a/b/bbq_sauce_to_the_left"], ["milk", "bbq_sauce"]),
        ("a/b", ["a/b/turn_on_led", "a/b/turn_on_bulb"], ["turn_on_led", "turn_on_bulb"]),
        ("a/b", ["a/b/go_to_the_door", "a/b/go_to_the_door_and_back"], ["door", "door_and_back"]),
        (
            "all",
            ["a/A/turn_on_the_led", "a/B/turn_on_the_led"],
            ["a/A/turn_on_the_led", "a/B/turn_on_the_led"],
        ),
        ("other tasks", ["PickCube", "go"], ["PickCube", "go"]),
    ],
)
def test_names_of_columns_leave_out_the_words_that_all_share(suite, names, columns):
    board = {"suite": suite, "tasks": names}
    assert [within(name, board) for name in names] == columns


def test_shortened_columns_say_the_name_of_their_task(publish, tmp_path):
    names = [f"libero/object/pick_up_the_{each}_and_place_it_in_the_basket" for each in ("milk", "bbq_sauce")]
    for name in names:
        publish(task=name)
    board = leaderboard.build(tmp_path)
    assert "| budget | bbq_sauce | milk | mean |" in render_markdown(board)
    assert all(f'title="{name}"' in render_html(board) for name in names)


def test_tasks_without_a_family_are_ranked_in_the_largest_suite_that_has_them(publish, tmp_path):
    for task in ("DoorClose", "DrawerOpen", "Lift", "Coffee"):
        publish(task=task)
    assert suites_of(leaderboard.build(tmp_path)) == {
        "metaworld": ["DoorClose", "DrawerOpen"],
        "robosuite": ["Lift"],
        "other tasks": ["Coffee"],
    }


@pytest.mark.parametrize(
    ("names", "joined"),
    [
        (
            ["theirs/a/x", "theirs/b/y"],
            {"theirs/a": "all_of_theirs", "theirs/b": "all_of_theirs", "PickCube": "more_of_theirs"},
        ),
        (["theirs/a/x"], {"PickCube": "more_of_theirs"}),
        (lambda: "theirs/a/x", {"PickCube": "more_of_theirs"}),  # no list
    ],
)
def test_a_family_is_joined_to_a_suite_that_has_all_of_it_and_more(monkeypatch, names, joined):
    tasks, suites = Registry("task"), Registry("suite")
    for task in ("theirs/a/x", "theirs/b/y", "PickCube"):
        tasks.add(task, "theirs:Task")
    suites.add("all_of_theirs", names)
    every = ["theirs/a/x", "theirs/b/y", "PickCube"]
    suites.add("more_of_theirs", every if "theirs/a" in joined else ["PickCube"])
    if "theirs/a" in joined:
        suites.add("a_selection", ["PickCube"])
    monkeypatch.setattr("benchmark.leaderboard.headline.TASKS", tasks)
    for module in ("benchmark.leaderboard.headline", "envs.tasks.suites"):
        monkeypatch.setattr(f"{module}.SUITES", suites)
    assert headline._suites_of_families() == joined
