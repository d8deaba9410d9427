"""Recipes: one set of training values per policy, the same for every task, level and seed.

A recipe is ``configs/recipe/<name>.yaml``, or a YAML file that is given by its path. The last part of its
name, after an underscore, is its version: ``act_v1`` is version ``v1``. Results record the name.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from envs.core.errors import ConfigError, unknown_name
from envs.tasks.suites import PAPER

TASKS = PAPER
"""Tasks of the leaderboard's table."""

LEVELS = (0, 3, 1, 2)
"""Training levels in the order of a sweep: an interruption leaves the headline levels first."""

SEEDS = (0, 1, 2)

_ONE_SEED_LEVELS = (1, 2)
"""Training levels of seed 0 alone."""

_BESIDE = {
    "policy_name", "task", "suite", "level", "seed", "recipe", "device", "run", "resume", "slow_ok",
    "dry_run", "dataset", "datasets_dir", "runs_dir", "results_dir", "tasks_at_once",
    "collect.num_workers", "collect.num_envs", "evaluate.num_envs", "evaluate.videos", "train.num_threads",
    "train.save_every", "train.log_every", "train.wandb",
}  # fmt: skip
"""Keys that may be typed beside a recipe: none changes how it trains or what it is evaluated on."""


def read_recipe(recipe: str, folder: Path) -> tuple[str, dict[str, Any]]:
    """Reads a recipe.

    Args:
        recipe: Name, or path of a YAML file.
        folder: Folder of the named ones.

    Returns:
        Its name, and its nested values, ``policy_name`` among them.

    Raises:
        UnknownNameError: There is no such recipe.
        ConfigError: The file cannot be read, or names no policy.
    """
    import yaml

    path = Path(recipe) if recipe.endswith(".yaml") else folder / f"{recipe}.yaml"
    if not path.is_file():
        raise unknown_name("recipe", recipe, recipe_names(folder))
    try:
        values = yaml.safe_load(path.read_text())
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ConfigError(f"Recipe '{path}' cannot be read: {' '.join(str(error).split())}.") from error
    if not isinstance(values, dict) or "policy_name" not in values:
        raise ConfigError(f"Recipe '{path}' names no policy: add a line such as policy_name: act.")
    return path.stem, values


def recipe_names(folder: Path) -> list[str]:
    """Returns the names of the recipes in a folder, sorted."""
    return sorted(path.stem for path in folder.glob("*.yaml"))


def find_recipes(text: str, folder: Path) -> list[str]:
    """Returns the recipes of ``act_v1,diffusion_v1``, of a path, or of a version such as ``v1``.

    Raises:
        UnknownNameError: There is no recipe of a name or version.
    """
    names = recipe_names(folder)
    versions = {version for name in names if (version := name.rpartition("_")[2]).startswith("v")}
    chosen: list[str] = []
    for part in map(str.strip, text.strip("[]").split(",")):
        of_version = [name for name in names if name.rpartition("_")[2] == part]
        if not of_version and part not in names and not part.endswith(".yaml"):
            raise unknown_name("recipe", part, [*versions, *names])
        chosen += of_version or [part]
    return list(dict.fromkeys(chosen))


def check_beside(recipe: str, its_policy: str, policy: str, keys: Sequence[str]) -> None:
    """Checks that no typed key changes a recipe.

    Args:
        recipe: Its name; empty checks nothing.
        its_policy: The policy that it trains.
        policy: The policy of the command line.
        keys: Full names of the typed keys.

    Raises:
        ConfigError: One does.
    """
    if not recipe:
        return
    if policy != its_policy:
        raise ConfigError(f"recipe={recipe} trains policy={its_policy}, given policy={policy}. Leave it out.")
    wrong = [key for key in keys if key != "policy" and key not in _BESIDE]
    if wrong:
        raise ConfigError(
            f"{', '.join(wrong)} would change recipe={recipe}, whose results are compared. Leave it out, "
            "leave out the recipe, or write a recipe of another version in configs/recipe."
        )


def runs_in_order(
    recipes: Sequence[str], tasks: Sequence[str], levels: Sequence[int], seeds: Sequence[int]
) -> Iterator[tuple[str, ...]]:
    """Yields the words of every run, so that an interruption leaves a balanced table.

    The seed varies slowest, then the level, the task, and the recipe. An empty choice of tasks, levels or
    seeds takes those of the table; levels 1 and 2 have seed 0 alone, unless seeds are named.
    """
    for seed in seeds or SEEDS:
        for level in [each for each in LEVELS if not levels or each in levels]:
            if seed != 0 and not seeds and level in _ONE_SEED_LEVELS:
                continue
            for task in tasks or TASKS:
                for recipe in recipes:
                    yield (f"recipe={recipe}", f"task={task}", f"level={level}", f"seed={seed}")
