"""Words and numbers of the leaderboard's pages: names of policies and simulators, budgets, rates, dates."""

import re
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from benchmark.leaderboard.curve_chart import thousands
from envs.core.json_values import flat
from envs.spec import EnvSpec

LEVELS = {
    0: ("object poses", "Only the task space varies: where objects and goals are."),
    1: ("+ materials", "Table, walls and ground get other materials, too."),
    2: ("+ camera", "The camera looks from another of 59 poses, too."),
    3: ("+ light", "Lights, their colour, and how surfaces reflect vary, too."),
}
"""Channel that each level adds, for the head of its column."""

_FEWEST_SHARED = 3
"""Words that names share before they are left out: ``turn_on_led`` stays beside ``turn_on_lightbulb``."""

_NAMES = {
    "act": "ACT",
    "diffusion": "Diffusion Policy",
    "ppo": "PPO",
    "tdmpc2": "TD-MPC2",
    "fasttd3": "FastTD3",
    "openvla": "OpenVLA",
    "octo": "Octo",
    "smolvla": "SmolVLA",
    "multi_task_dit": "Multi-Task DiT",
    "pi0": "π0",
    "pi05": "π0.5",
    "pi0_fast": "π0-FAST",
    "xvla": "X-VLA",
    "groot": "GR00T",
    "wall_x": "WALL-OSS",
    "eo1": "EO-1",
    "vqbet": "VQ-BeT",
    "mujoco": "MuJoCo",
    "mujoco_warp": "MuJoCo Warp",
    "newton": "Newton",
    "sapien": "SAPIEN",
    "pybullet": "PyBullet",
    "genesis": "Genesis",
}

_MONTHS = [
    "January",
    "February",
    "March",
    "April",
    "May",
    "June",
    "July",
    "August",
    "September",
    "October",
    "November",
    "December",
]

_MARKDOWN = str.maketrans({character: f"\\{character}" for character in "|[]`*"})


def name_of(word: str) -> str:
    """Returns how a policy or a simulator is written, its own name where it has no other."""
    return _NAMES.get(word, word)


def entry_name(entry: Mapping[str, Any]) -> str:
    """Returns an entry's policy: ``PPO by rsl_rl``."""
    return name_of(entry["policy"]) + entry["label"].removeprefix(entry["policy"])


def options_of(env: EnvSpec) -> list[str]:
    """Returns what an environment is given beside its task and its scene: ``["starts=libero"]``."""
    options = [*sorted(env.task_kwargs.items()), *sorted(env.simulator_settings.items())]
    options += [("robot", env.robot)] if env.robot else []
    return [f"{name}={value}" for name, value in options]


def settings_of(env: EnvSpec) -> list[str]:
    """Returns what an environment is given beside its task, of its scene, too."""
    return [*options_of(env), *(f"{name}={value}" for name, value in sorted(flat(env.scenario).items()))]


def budget(entry: Mapping[str, Any]) -> str:
    """Returns what an entry was trained with: ``1,000 demos · 10k steps``; or seconds of a clock."""
    parts = [f"{entry['demonstrations']:,} demos"] if entry["demonstrations"] else []
    if entry["steps"]:
        parts.append(f"{thousands(entry['steps'])} steps")
    elif entry["time_s"]:
        parts.append(f"{entry['time_s']:.0f} s")
    return " · ".join(parts)


def origin(entry: Mapping[str, Any]) -> str:
    """Returns what fixes an entry's budget: ``recipe act_v1``."""
    variant = f", variant {entry['variant']}" if entry["variant"] else ""
    return f"{entry['kind']} {entry['name']}{variant}"


def date(created: str | None) -> str:
    """Returns a result's date for people: ``24 November 2026``."""
    if not created:
        return "no results yet"
    year, month, day = created[:10].split("-")
    return f"{int(day)} {_MONTHS[int(month) - 1]} {year}"


def words_of_task(task: str) -> list[str]:
    """Returns a task's name where it may break: ``PickCube`` as ``Pick``, ``Cube``."""
    return re.split(r"(?<=[a-z])(?=[A-Z])|(?<=[/_])", task)


def breakable(task: str) -> str:
    """Returns a task's name with a space of no width where it may break."""
    return "\u200b".join(words_of_task(task))


def within(task: str, board: Mapping[str, Any]) -> str:
    """Returns the name of a task of a board without what all of its tasks share.

    That is the suite or the suite's family that it begins with, and three or more words at either end.
    ``grasp/few/milk`` is ``milk`` in ``grasp/few``, ``grasp/colours_1/milk`` is ``colours_1/milk`` in
    ``grasp/colours``, and ``pick_up_the_milk_and_place_it_in_the_basket`` of LIBERO-object is ``milk``.
    Names that keep a scene keep all of their words.
    """
    suite = board["suite"]

    def short(name: str) -> str:
        start = suite if name.startswith(f"{suite}/") else suite.rpartition("/")[0]
        return name.removeprefix(f"{start}/")

    names = [short(name) for name in board["tasks"]]
    if len(names) == 1 or any("/" in name for name in names):
        return short(task)
    words = [name.split("_") for name in names]
    first = _num_shared(words)
    last = _num_shared([each[first:][::-1] for each in words])
    own = short(task).split("_")
    return "_".join(own[first : len(own) - last])


def _num_shared(names: Sequence[Sequence[str]]) -> int:
    """Returns how many first words all of several names have, 0 if they are few; each keeps a word."""
    most = min(map(len, names)) - 1
    shared = next((n for n in range(most) if len({name[n] for name in names}) > 1), most)
    return shared if shared >= _FEWEST_SHARED else 0


def percent(rate: float) -> str:
    """Returns a rate in percent, without the sign."""
    return f"{100 * rate:.0f}"


def interval(cell: Mapping[str, Any]) -> str:
    """Returns an interval in percent: ``85–96``."""
    return f"{percent(cell['ci_low'])}–{percent(cell['ci_high'])}"


def p_value(value: float) -> str:
    """Returns a p-value with three decimals."""
    return "< 0.001" if value < 0.001 else f"{value:.3f}"


def words_of_test(test: str) -> str:
    """Returns how an instruction test is called: ``new frame``, ``wrong instruction``."""
    return {
        "known": "known wording",
        "wrong": "wrong instruction",
        "empty": "empty instruction",
        "switched": "switched to a wrong one",
    }.get(test, test.replace("_", " "))


def difference(score: Mapping[str, Any]) -> str:
    """Returns a difference in points of percent: ``+12``."""
    return _signed(f"{round(100 * score['difference']):+d}")


def difference_interval(score: Mapping[str, Any]) -> str:
    """Returns the interval of a difference in points of percent: ``5 to 19``."""
    low, high = (round(100 * score[name]) for name in ("ci_low", "ci_high"))
    return _signed(f"{low} to {high}")


def points(score: Mapping[str, Any]) -> str:
    """Returns a difference in points of percent and its interval: ``+12, 5 to 19``."""
    return f"{difference(score)}, {difference_interval(score)}"


def _signed(numbers: str) -> str:
    return numbers.replace("-", "−")


def trained_on(row: Mapping[str, Any]) -> str:
    """Returns what a run was trained on: ``level 0 · 1,000 demos · 10k steps · recipe act_v1``."""
    if row["train_level"] is None and not row["train_only"]:
        return "nothing"
    where = f"{row['train_only']} alone" if row["train_only"] else f"level {row['train_level']}"
    sizes = {"demonstrations": row["demonstrations"], "steps": row["training_steps"]}
    trained = budget({**sizes, "time_s": row["training_time_s"]})
    return " · ".join(filter(None, [where, trained, row["recipe"] and f"recipe {row['recipe']}"]))


def markdown(value: Any) -> Any:
    """Escapes what Markdown would pass through or read as more than text: HTML, links, ends of cells."""
    if not isinstance(value, str):
        return value
    return escape(" ".join(value.splitlines()), quote=False).translate(_MARKDOWN)


FILTERS = {
    "budget": budget,
    "date": date,
    "difference": difference,
    "difference_interval": difference_interval,
    "entry_name": entry_name,
    "interval": interval,
    "name_of": name_of,
    "origin": origin,
    "p_value": p_value,
    "percent": percent,
    "points": points,
    "trained_on": trained_on,
    "within": within,
    "words_of_test": words_of_test,
    "breakable": breakable,
    "words_of_task": words_of_task,
}
"""Filters of the templates."""
