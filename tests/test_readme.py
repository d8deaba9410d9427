"""The README's Python, commands and numbers of levels work as printed."""

import json
import os
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from benchmark.protocol import LEVELS
from roboverse_learn import sweep
from roboverse_learn.config.compose import compose
from roboverse_learn.config.help import SUMMARIES

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)


def shown_commands() -> list[str]:
    return [text for text in re.findall(r"`(roboverse [^`]+)`", README) if "…" not in text.split("=")[0]]


def test_the_diff_of_a_task_is_that_task() -> None:
    text = (ROOT / "docs/adding_a_task.md").read_text(encoding="utf-8")
    added, sources = [], []
    for part in text.split("+++ b/")[1:]:
        name, *diff = part.splitlines()
        added.append([line[1:] for line in diff if line.startswith("+")])
        sources.append((ROOT / name).read_text(encoding="utf-8").splitlines())
    (registered,), task = added
    assert registered in sources[0], "one line registers it"
    assert task == sources[1]


@pytest.mark.slow
@pytest.mark.usefixtures("forked_workers")
@pytest.mark.parametrize("block", blocks("python"))
def test_a_python_block_runs_as_a_script_and_ends(block: str, tmp_path: Path) -> None:
    check = "assert image.shape == (128, 128, 3) and image.std() > 1"
    (tmp_path / "script.py").write_text(f"{block}\n{check}\n", encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "script.py"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr
    assert 0 <= float(done.stdout.split()[-1]) <= 1


@pytest.mark.slow
@pytest.mark.parametrize("text", shown_commands())
def test_a_command_takes_the_words_it_is_shown_with(text: str) -> None:
    _, command, *words = shlex.split(text)
    assert command in SUMMARIES
    words = [word for word in words if "=" in word]
    if words:
        sweep.plan(words) if command == "sweep" else compose(command, words)


def test_every_command_is_in_the_readme() -> None:
    assert {text.split()[1] for text in shown_commands()} >= set(SUMMARIES)


def recipe_cell(recipe: str, task: str, trained: int, tested: int) -> str:
    """Returns the success in % of a recipe's run with seed 0; nothing where there is none."""
    policy = recipe.partition("_")[0]
    runs = list((ROOT / "results/v2" / task / policy).glob(f"{recipe}-level{trained}-seed0-*.json"))
    if not runs:
        return ""
    (run,) = runs
    cells = json.loads(run.read_text())["cells"]
    (cell,) = (each for each in cells if (each["level"], each["split"]) == (tested, "test"))
    return f"{100 * cell['success_rate']:.0f}"


def test_the_table_of_results_is_that_of_the_recipes_runs() -> None:
    board = json.loads((ROOT / "results/leaderboard.json").read_text())
    reported = {
        (row["policy"], row["task"]): 100 * row["success_rate"]["0"] for row in board["reference"]["rows"]
    }
    table = [[cell.strip() for cell in line.split("|")[1:-1]] for line in README.splitlines()]
    rows = [cells for cells in table if len(cells) == 10 and ("act", cells[0]) in reported]
    assert len(rows) == 6
    runs = [(0, 0), (3, 3), (0, 3)]
    columns = [(recipe, *levels) for recipe in ("act_v1", "diffusion_v1") for levels in runs]
    columns.insert(0, ("act_v2", 0, 0))
    for task, *cells in rows:
        found = [recipe_cell(recipe, task, trained, tested) for recipe, trained, tested in columns]
        assert cells == [*found, *(f"{reported[policy, task]:.1f}" for policy in ("act", "diffusion"))]


def test_the_mean_over_seeds_is_that_of_the_recipes_runs() -> None:
    tasks: dict[str, list[int]] = {}
    for run in (ROOT / "results/v2").glob("*/act/act_v2-level0-seed?-*.json"):
        result = json.loads(run.read_text())
        (cell,) = (each for each in result["cells"] if (each["level"], each["split"]) == (0, "test"))
        assert cell["episodes"] == 100
        tasks.setdefault(run.parts[-3], []).append(cell["successes"])
    assert {len(seeds) for seeds in tasks.values()} == {3}
    means = [sum(seeds) / 3 for seeds in tasks.values()]
    assert len(means) == 6
    assert (
        f"Over three seeds, ACT v2 solves {sum(means) / 6:.1f} % of the six tasks' test episodes at level 0, "
        f"and {min(means):.0f} % of its worst task's." in README
    )


def test_every_level_has_a_row() -> None:
    assert all(re.search(rf"^\| {level} \|", README, re.MULTILINE) for level in LEVELS)


def test_the_commands_install_the_plugins_of_lerobot_and_gymnasium() -> None:
    plugin = tomllib.loads((ROOT / "envs/lerobot/plugin/pyproject.toml").read_text())
    # LeRobot compares names as they are written; with hyphens it would find nothing.
    assert plugin["project"]["name"].startswith("lerobot_env_")
    assert plugin["project"]["dependencies"] == ["roboverse-learn"]
    assert (ROOT / f"envs/lerobot/plugin/{plugin['project']['name']}.py").is_file()
    installs = [line for line in README.splitlines() if line.startswith("python3.12 -m venv ")]
    assert len(installs) == 2
    assert all(" -e envs/lerobot/plugin -e envs/gymnasium_plugin " in line for line in installs)


FIRST_COMMAND_IN_WORDS = ("README.md", "docs/index.md", "docs/getting_started.md")


@pytest.mark.parametrize("page", FIRST_COMMAND_IN_WORDS)
def test_pages_say_of_the_first_command_what_its_runs_are(page: str) -> None:
    """The table of runs is docs/results.md's; pages round it."""
    section = (ROOT / "docs/results.md").read_text().split("## README's first command")[1].split("\n## ")[0]
    rows = [line.split("|")[2:] for line in section.splitlines() if re.match(r"\| [0-9a-f]{8} \|", line)]
    rates = [int(row[3].split("%")[0]) for row in rows]
    minutes = [int(row[2].split(":")[0]) + int(row[2].split(":")[1]) / 60 for row in rows]
    assert len(rates) >= 3 and len(minutes) >= 3
    text = " ".join((ROOT / page).read_text().split())
    assert (round(min(minutes)), round(max(minutes))) == (6, 13)
    assert "six to thirteen minutes" in text
    assert f"{min(rates)} to {max(rates)} %" in text
