"""Every expert of ours solves a start; ``test_tasks.py`` tries most of them on more, with ``-m long``."""

import pytest

from envs.core.errors import MissingExtraError
from envs.spec import EnvSpec
from envs.tasks import TASKS
from roboverse_learn.checks.checked_task import CheckedTask
from roboverse_learn.checks.contract import NotApplicableError
from roboverse_learn.checks.task_solving import expert_solves

SUITES = {"adapted", "calvin", "libero"}
"""Tags of tasks that share one expert."""

OF_CALVIN = (
    "calvin/A/open_drawer",
    "calvin/B/move_slider_right",
    "calvin/C/turn_on_lightbulb",
    "calvin/D/lift_red_block_drawer",
    "calvin/D/place_in_drawer",
    "calvin/D/push_into_drawer",
    "calvin/D/rotate_red_block_right",
    "calvin/D/unstack_block",
)
NAMES = [name for name in TASKS if not (SUITES | {"same_scene"}) & TASKS.entry(name).tags]


@pytest.mark.slow
@pytest.mark.parametrize("name", [*NAMES, *OF_CALVIN])
def test_an_expert_solves_a_start(name: str) -> None:
    checked = CheckedTask(EnvSpec(task=name, image_size=32), num_envs=1, episodes=1, required=1.0)
    try:
        expert_solves.check(checked)
    except (MissingExtraError, NotApplicableError) as reason:
        pytest.skip(str(reason))
    finally:
        checked.close()
