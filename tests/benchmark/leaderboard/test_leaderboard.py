import json
import os
import re
from pathlib import Path

import pytest

from benchmark.leaderboard import build as leaderboard
from benchmark.protocol import Protocol
from benchmark.records import Checkpoint
from benchmark.results import result_path, write_result
from benchmark.statistics import wilson
from envs.core.errors import ResultError

GOLDEN = Path(__file__).parent / "golden_leaderboard.md"


def rows(tmp_path):
    return [row for section in leaderboard.build(tmp_path)["sections"] for row in section["rows"]]


def test_a_row_by_hand(publish, tmp_path):
    publish(rates=(1.0, 0.0, 1.0, 0.0), protocol=Protocol(episodes=10))
    (row,) = rows(tmp_path)
    first = next(cell for cell in row["cells"] if cell["level"] == 0 and cell["split"] == "test")
    assert (first["episodes"], first["successes"], first["success_rate"]) == (10, 10, 1.0)
    assert first["ci_low"] == pytest.approx(wilson(10, 10)[0], abs=1e-6)
    assert row["mean_test"]["success_rate"] == 0.5
    assert row["runs"][0]["path"] == "v2/PickCube/act/act-s0.json"


def test_seeds_are_one_row_and_other_methods_are_not(publish, tmp_path):
    for seed in range(3):
        publish(seed=seed)
    publish(seed=7, run="longer", checkpoint=Checkpoint(step=9000))
    publish(policy="diffusion")
    found = {row["label"]: row["seeds"] for row in rows(tmp_path)}
    assert found == {"act, 2000 steps": [0, 1, 2], "act, 9000 steps": [7], "diffusion": [0]}


def test_seeds_that_the_clock_stopped_are_one_row(publish, tmp_path):
    """They have different numbers of steps, and are the same method all the same."""
    config = {"policy": {}, "train": {"steps": 20_000, "time_limit_s": 480.0}}
    for seed, step in enumerate((1774, 1801)):
        publish(seed=seed, checkpoint=Checkpoint(step=step), config=config)
    publish(seed=2, run="all", checkpoint=Checkpoint(step=20_000), config=config)
    publish(seed=3, run="tested", checkpoint=Checkpoint(step=1790), config={"policy": {}, "run": config})
    found = {row["label"]: row["seeds"] for row in rows(tmp_path)}
    assert found == {"act": [0, 1, 3], "act, 20000 steps": [2]}


def test_sections_of_a_task_are_adjacent(publish, tmp_path):
    for task, simulator, horizon in (
        ("PickCube", "sapien", 200),
        ("CloseBox", "sapien", 50),
        ("PickCube", "mujoco", 100),
        ("CloseBox", "mujoco", 300),
    ):
        publish(run=simulator, task=task, simulator=simulator, max_episode_steps=horizon)
    sections = leaderboard.build(tmp_path)["sections"]
    assert [(section["task"], section["simulator"]) for section in sections] == [
        ("CloseBox", "mujoco"),
        ("CloseBox", "sapien"),
        ("PickCube", "mujoco"),
        ("PickCube", "sapien"),
    ]


def test_the_same_seed_twice_is_no_new_sample(publish, tmp_path):
    publish(run="first")
    publish(run="again", created="2026-04-01T00:00:00Z")
    assert sorted((row["label"], row["seeds"]) for row in rows(tmp_path)) == [
        ("act, again", [0]),
        ("act, first", [0]),
    ]


def test_only_three_runs_have_an_interquartile_mean(publish, tmp_path):
    publish(seed=0)
    publish(seed=1)
    assert rows(tmp_path)[0]["iqm_test"] is None
    publish(seed=2)
    iqm = rows(tmp_path)[0]["iqm_test"]
    assert iqm["ci_low"] <= iqm["success_rate"] <= iqm["ci_high"]


@pytest.mark.parametrize(
    "change",
    [
        {"renderer": "gl"},
        {"simulator": "sapien"},
        {"task_kwargs": {"success": "lift"}},
        {"simulator_settings": {"impratio": 5}},
        {"robot": "ur5e"},
        {"scenario": {"cameras": {"front": {"fovy_deg": 30.0}}}},
        {"max_episode_steps": 100},
    ],
)
def test_what_is_not_comparable_is_another_section(publish, tmp_path, change):
    publish()
    publish(policy="diffusion", **change)
    sections = leaderboard.build(tmp_path)["sections"]
    assert [len(section["rows"]) for section in sections] == [1, 1]
    assert not any(section["comparisons"] for section in sections)


def test_a_changed_scene_is_in_the_title_and_in_the_name_of_the_section(publish, tmp_path):
    publish(scenario={"physics": {"decimation": 50}, "cameras": {"front": {"fovy_deg": 30.0}}})
    (section,) = leaderboard.build(tmp_path)["sections"]
    assert "(cameras.front.fovy_deg=30.0, physics.decimation=50)" in section["title"]
    assert re.fullmatch(r"v2-pickcube-mujoco-warp-scenario-[0-9a-f]{8}", section["id"])


def test_sections_that_differ_in_a_sign_alone_have_names_of_their_own(publish, tmp_path):
    for run, offset in (("right", [0.01, 0.02]), ("left", [0.01, -0.02]), ("other", [0.03, 0.02])):
        publish(run=run, task_kwargs={"hole_offset_m": offset})
    sections = leaderboard.build(tmp_path)["sections"]
    ids = {str(section["task_kwargs"]["hole_offset_m"]): section["id"] for section in sections}
    name = "v2-pickcube-hole-offset-m-0-0{}-0-02-mujoco-warp"
    assert ids.pop("[0.03, 0.02]") == name.format(3), "it is unique without more"
    assert len(set(ids.values())) == 2
    for each in ids.values():
        assert re.fullmatch(name.format(1) + "-250-steps-20-hz-[0-9a-f]{6}", each)


def test_another_robot_is_in_the_title_and_in_the_name_of_the_section(publish, tmp_path):
    for name in ("robots.json", "tasks.json"):
        (tmp_path / name).write_text('{"cells": []}')  # tables that lie beside the results
    publish(robot="ur5e")
    (section,) = leaderboard.build(tmp_path)["sections"]
    assert "(robot=ur5e)" in section["title"] and section["id"] == "v2-pickcube-robot-ur5e-mujoco-warp"


def test_a_policy_in_another_simulator_is_a_row_of_that_simulator(publish, tmp_path):
    """Sim to sim: tested where it was not trained, beside what was trained there."""
    home, away = {"simulator": "mujoco", "renderer": "warp"}, {"simulator": "sapien", "renderer": "sapien"}
    publish(config={"policy": {}, **home}, **home)
    publish(run="moved", config={"command": {}, "policy": {}, "run": home}, **away)
    publish(run="drawn", config={"command": {}, "policy": {}, "run": home}, **(home | {"renderer": "sapien"}))
    publish(run="native", config={"policy": {}, **away}, **away)
    found = {
        (section["simulator"], section["renderer"]): {row["label"] for row in section["rows"]}
        for section in leaderboard.build(tmp_path)["sections"]
    }
    assert found == {
        ("mujoco", "warp"): {"act"},
        ("mujoco", "sapien"): {"act, trained in mujoco, rendered with warp"},
        ("sapien", "sapien"): {"act", "act, trained in mujoco, rendered with warp"},
    }


def test_policies_are_paired_on_their_episodes(publish, tmp_path):
    publish(rates=(1.0,) * 4, protocol=Protocol(episodes=12))
    publish(policy="diffusion", rates=(0.0,) * 4, protocol=Protocol(episodes=8))
    (section,) = leaderboard.build(tmp_path)["sections"]
    assert [test["level"] for test in section["comparisons"]] == [0, 1, 2, 3]
    test = section["comparisons"][0]
    assert (test["num_episodes"], test["only_a"], test["only_b"]) == (8, 8, 0)
    assert test["p_value"] == pytest.approx(2 / 2**8, abs=1e-6)
    assert test["a"].startswith("act")
    # Four cells with the same p: the smallest counts four times, and none less than it.
    assert [test["p_holm"] for test in section["comparisons"]] == pytest.approx([8 / 2**8] * 4, abs=1e-6)


def test_episodes_that_begin_differently_are_not_paired(publish, make_result, tmp_path):
    from dataclasses import replace

    publish()
    other = make_result(policy="diffusion")
    odd = tuple(
        replace(record, initial_state_hash="f" * 16) if record.episode == 9001 else record
        for record in other.records
    )
    write_result(result_path(tmp_path, other), replace(other, records=odd))
    (section,) = leaderboard.build(tmp_path)["sections"]
    assert section["comparisons"][0]["num_episodes"] == 3
    assert "4 test episodes of act and diffusion begin differently" in section["notes"][0]


@pytest.mark.slow
def test_bytes_do_not_depend_on_the_order_of_writing(publish, make_result, tmp_path):
    for policy in ("act", "diffusion"):
        publish(policy=policy)
    names = (leaderboard.JSON_NAME, leaderboard.MARKDOWN_NAME, leaderboard.HTML_NAME)
    leaderboard.write(tmp_path)
    before = [(tmp_path / name).read_bytes() for name in names]
    plot = (tmp_path / "plots" / "v2-pickcube-mujoco-warp.png").read_bytes()
    for policy in ("diffusion", "act"):
        path = result_path(tmp_path, make_result(policy=policy))
        path.unlink()
        publish(policy=policy)
    leaderboard.write(tmp_path)
    assert [(tmp_path / name).read_bytes() for name in names] == before
    assert (tmp_path / "plots" / "v2-pickcube-mujoco-warp.png").read_bytes() == plot


@pytest.mark.slow
def test_golden_markdown(publish, tmp_path):
    """Regenerate with ``REGENERATE_GOLDEN=1``, and read the difference."""
    publish(protocol=Protocol(episodes=10, only=("camera",)))
    publish(policy="diffusion", protocol=Protocol(episodes=10, only=("camera",)), rates=(0.8, 0.8, 0.5, 0.1))
    written = leaderboard.write(tmp_path)
    if "REGENERATE_GOLDEN" in os.environ:
        GOLDEN.write_text(written["markdown"].read_text())
    assert written["markdown"].read_text() == GOLDEN.read_text()


def test_bad_files_are_all_named_and_nothing_is_written(publish, tmp_path):
    publish()
    cut = publish(policy="diffusion")
    cut.write_bytes(cut.read_bytes()[:300])
    stray = tmp_path / "notes.json"
    stray.write_text("{}")
    with pytest.raises(ResultError) as caught:
        leaderboard.write(tmp_path)
    assert "No leaderboard was written, because of 2 results file(s)" in str(caught.value)
    assert str(cut) in str(caught.value)
    assert str(stray) in str(caught.value)
    assert not (tmp_path / leaderboard.JSON_NAME).exists()


def test_a_file_in_the_wrong_place_is_refused(publish, tmp_path):
    path = publish()
    moved = path.with_name("other.json")
    path.rename(moved)
    with pytest.raises(
        ResultError, match=r"other.json' is in the wrong place; it belongs at '.*act-s0.json'"
    ):
        leaderboard.build(tmp_path)


def test_a_task_of_a_family_has_a_folder_of_its_own(publish, tmp_path):
    path = publish(task="humanoid/walk", policy="fasttd3")
    assert path.relative_to(tmp_path).parts == ("v2", "humanoid", "walk", "fasttd3", "fasttd3-s0.json")
    (section,) = leaderboard.build(tmp_path)["sections"]
    assert (section["title"], section["id"]) == ("humanoid/walk", "v2-humanoid-walk-mujoco-warp")


@pytest.mark.slow
@pytest.mark.parametrize("damaged", [None, "{", "[]", '{"sections": [{}]}'])
def test_a_plot_is_removed_with_its_results(publish, tmp_path, damaged):
    """But images of others stay, and so do all if the last leaderboard cannot be read."""
    publish(task="CloseBox")
    gone = publish(task="PickCube")
    written = leaderboard.write(tmp_path)
    plots = {kind: path for kind, path in written.items() if kind.startswith("plot")}
    (tmp_path / "plots" / "mine.png").touch()
    gone.unlink()
    if damaged is not None:
        written["json"].write_text(damaged)
    leaderboard.write(tmp_path)
    left = {path.name for path in (tmp_path / "plots").iterdir()}
    assert {path.name for path in plots.values()} - left == (
        set() if damaged else {"v2-pickcube-mujoco-warp.png"}
    )
    assert "mine.png" in left


def test_no_folder_says_what_to_run(tmp_path):
    with pytest.raises(ResultError, match="Evaluate a checkpoint first: roboverse evaluate"):
        leaderboard.build(tmp_path / "nowhere")


def test_an_empty_folder_is_an_empty_page(tmp_path):
    written = leaderboard.write(tmp_path)
    assert json.loads(written["json"].read_text())["sections"] == []
    assert "No results yet" in written["html"].read_text()


@pytest.mark.parametrize("key", ["channels", "not_shown"])
def test_names_of_cells_are_checked(publish, tmp_path, key):
    path = publish()
    document = json.loads(path.read_text())
    document["cells"][0][key] = ["<script>"]
    path.write_text(json.dumps(document))
    with pytest.raises(ResultError, match=f"does not follow schema 3: at cells/0/{key}/0: .*<script>"):
        leaderboard.write(tmp_path)
