"""Tasks as ``roboverse list`` shows them."""

import json

import pytest

from envs.experts.counts import ExpertCount
from envs.tasks import TASKS
from envs.tasks.suites import SUITES
from roboverse_learn import cli
from roboverse_learn.commands import task_list


def dataset(folder, task, name, count):
    info = folder / task / name / "meta" / "info.json"
    info.parent.mkdir(parents=True)
    info.write_text(count if isinstance(count, str) else json.dumps({"total_episodes": count}))


def test_demonstrations_of_all_datasets_of_a_task_count(tmp_path):
    dataset(tmp_path, "PickCube", "level0", 700)
    dataset(tmp_path, "PickCube", "level3", 30)
    dataset(tmp_path, "PickCube", "broken", "{")
    dataset(tmp_path, "metaworld/push", "level0", 5)
    assert task_list.count_demos(tmp_path, "PickCube") == 730
    assert task_list.count_demos(tmp_path, "metaworld/push") == 5
    assert task_list.count_demos(tmp_path / "none", "PickCube") == 0


def test_every_fact_of_a_task_is_in_its_row(tmp_path, monkeypatch):
    dataset(tmp_path, "PickCube", "level0", 700)
    monkeypatch.setattr(task_list, "read_counts", lambda: {"PickCube": ExpertCount(500, 0.996, 60.0)})
    rows = task_list.tasks_in_detail(tmp_path).splitlines()
    assert rows[0].split() == ["task", "source", "expert", "demos", "what", "to", "do"]
    row = next(row for row in rows if row.startswith("  PickCube "))
    cells = [cell for cell in row.split("  ") if cell.strip()]
    assert [cell.strip() for cell in cells] == [
        "PickCube",
        "ManiSkill 3",
        "99.6 % of 500",
        "700",
        TASKS.entry("PickCube").summary,
    ]
    other = next(row for row in rows if row.startswith("  StackCube "))
    assert " -  " in other and "  0  " in other
    assert " none  " in next(row for row in rows if row.startswith("  humanoid/walk "))


def test_a_single_task_is_shown_with_licence_horizon_and_extra(tmp_path):
    text = task_list.tasks_with(["libero/goal/turn_on_the_stove"], tmp_path)
    facts = dict(line.split(None, 1) for line in text.splitlines() if line.startswith("    "))
    assert facts["horizon"] == "600" and facts["extra"] == "libero" and facts["paper"] == "arXiv:2306.03310"
    assert facts["licence"].startswith("MIT; objects of HOPE")
    assert not [line for line in task_list.tasks_with(["stove"], tmp_path).splitlines() if "licence" in line]


def test_every_task_is_named_once_and_families_are_paragraphs(tmp_path):
    text = task_list.tasks_in_detail(tmp_path)
    words = text.split()
    for name in TASKS:
        assert words.count(name) == 1 or name.startswith(("libero/", "libero_pro/")), name
    assert "roboverse list tasks libero-90" in text
    paragraph = [line for line in text.splitlines() if line.startswith("    ") and len(line.split()) > 1]
    assert max(map(len, paragraph)) <= task_list.WIDTH


@pytest.mark.parametrize("words", [["--help"], ["train", "--help"], ["evaluate", "--help"]])
def test_a_help_text_counts_tasks_and_suites(words, capsys):
    assert cli.main(words) == 0
    said = capsys.readouterr().out
    tasks, _, rest = said.partition("\nTasks:\n")[2].partition("\nSuites:\n")
    assert tasks.startswith(f"  {len(TASKS.names())} in all, such as PickCube, StackCube, CloseBox. ")
    assert tasks.endswith("roboverse list tasks") and "\n" not in tasks
    assert rest.startswith(f"  {len(SUITES.names())} in all, such as paper, libero, metaworld. ")
    assert "libero_pro/10_lan" not in said


def test_the_command_counts_in_the_folder_it_is_given(tmp_path, capsys):
    dataset(tmp_path, "PickCube", "level0", 4321)
    assert cli.main(["list", f"datasets_dir={tmp_path}"]) == 0
    said = capsys.readouterr().out
    assert "  4321  " in said and "\nPolicies:\n" in said


def test_the_command_lists_the_kinds_it_is_given(tmp_path, capsys):
    dataset(tmp_path, "PickCube", "level0", 4321)
    assert cli.main(["list", "tasks", f"datasets_dir={tmp_path}"]) == 0
    said = capsys.readouterr().out
    assert "  4321  " in said and "Policies:" not in said
    assert cli.main(["list", "robots", "policies"]) == 0
    said = capsys.readouterr().out
    assert said.startswith("Robots:\n") and "\nPolicies:\n" in said and "Tasks:" not in said


def test_words_choose_tasks(capsys):
    assert cli.main(["list", "tasks", "LIBERO-goal", "drawer", "middle"]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[0] == "Tasks:" and said[1].split()[0] == "task"
    rows = [line.split()[0] for line in said[2:] if not line.startswith("    ")]
    assert rows == ["libero/goal/open_the_middle_drawer_of_the_cabinet"]


def test_the_last_count_of_an_expert_is_beside_the_name(tmp_path, monkeypatch):
    name = "libero/goal/open_the_middle_drawer_of_the_cabinet"
    monkeypatch.setattr(task_list, "read_counts", lambda: {name: ExpertCount(20, 0.85, 300.0)})
    assert "  85 % of 20  " in task_list.tasks_with([name], tmp_path)
    assert "expert 85.0 to 85.0 %, 1 measured" in task_list.tasks_in_detail(tmp_path)


def test_words_that_no_task_has_are_named(capsys):
    assert cli.main(["list", "tasks", "libero", "submarine"]) == 2
    assert "No task has the words libero and submarine; none has 'submarine'." in capsys.readouterr().err
    assert cli.main(["list", "tasks", "humanoid", "drawer"]) == 2
    assert "though some have each of them" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("dataset_dir=x", "Unknown key of list 'dataset_dir'. Did you mean 'datasets_dir'?"),
        ("datasets_dir=", "datasets_dir= is empty, and names a file or folder: give one, or leave"),
        ("task", "Unknown kind of thing to list 'task'. Did you mean 'tasks'?"),
        ("verbose", "Valid: channels, launchers, levels, policies, presets, protocols, "),
    ],
)
def test_another_word_of_list_is_a_mistake(word, message, capsys):
    assert cli.main(["list", word]) == 2
    assert message in capsys.readouterr().err
