"""``python -m roboverse_learn.commands.inputs checkpoint=runs/<run>``: what a policy looks at.

For the first calls of the policy, it prints how far the actions move when one input is that of another
episode, in percent of how far they move when all inputs are; see :mod:`benchmark.inputs`. Nothing is written.
"""

import logging
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from envs.core.arguments import run_program
from envs.core.errors import ConfigError
from roboverse_learn.commands.columns import columns

if TYPE_CHECKING:
    from benchmark.inputs import Call

log = logging.getLogger(__name__)

_COMMAND = "python -m roboverse_learn.commands.inputs"


@dataclass(frozen=True, kw_only=True, slots=True)
class InputSettings:
    """Settings of the command.

    Attributes:
        checkpoint: Checkpoint folder, the folder of a run, or a name on the Hugging Face hub.
        task: Task to act in; by default the first that was learned.
        level: Level of the episodes.
        split: Split of the episodes; demonstrations are of the train split.
        episodes: Episodes, which run together, 4 or more.
        calls: Calls of the policy that are measured, until an episode ends.
        simulator: Simulator to act in; by default that of training.
        device: ``auto``, ``cpu``, ``cuda``.
    """

    checkpoint: str = ""
    task: str = ""
    level: int = 0
    split: str = "test"
    episodes: int = 32
    calls: int = 6
    simulator: str = ""
    device: str = "auto"


def main(words: Sequence[str] | None = None) -> int:
    """Prints what a policy looks at; returns the exit code."""
    return run_program(
        _COMMAND, InputSettings, lambda settings: log.info("%s", table(measured(settings))), words
    )


def measured(settings: InputSettings) -> "list[Call]":
    """Returns how far each input moves the actions, call by call.

    Raises:
        ConfigError: A setting is out of range, or the checkpoint is not named.
        PolicyError: The checkpoint is broken, or learned other tasks.
    """
    from benchmark.inputs import input_shares
    from envs.tasks.wrong_instructions import wrong_instructions
    from roboverse_learn.commands.tested_checkpoint import checkpoints_to_test
    from roboverse_learn.commands.tested_policy import load_policy, view_of
    from roboverse_learn.config.compose import compose

    if not settings.checkpoint:
        raise ConfigError("Name what was trained: checkpoint=runs/<run>.")
    if settings.calls < 1:
        raise ConfigError(f"calls must be 1 or more, given {settings.calls}.")
    words = [f"checkpoint={settings.checkpoint}", f"levels=[{settings.level}]", f"splits=[{settings.split}]"]
    words += [f"episodes={settings.episodes}", f"num_envs={settings.episodes}", f"device={settings.device}"]
    words += [f"{key}={getattr(settings, key)}" for key in ("task", "simulator") if getattr(settings, key)]
    config = compose("evaluate", words)
    tested = checkpoints_to_test(config)[0]
    policy, view = load_policy(tested), view_of(tested.checkpoint)
    spec = tested.env.replace(level=settings.level, only=None)
    env: Any = spec.make(settings.episodes, split=settings.split, protocol_seed=0, **view)
    try:
        return input_shares(policy, env, calls=settings.calls, instructions=wrong_instructions(env.task))
    finally:
        env.close()


def table(calls: "Sequence[Call]") -> str:
    """Returns rows of inputs and columns of calls, with the share of each in percent."""
    names = list(calls[0].moved)
    heading = ["input of another episode", *(f"step {call.step}" for call in calls), ""]
    rows = [[name, *(_percent(call.share(name)) for call in calls), ""] for name in names]
    scale = [
        "all but the instruction",
        *(f"{call.moved_by_all:.2g}" for call in calls),
        "in the action's unit",
    ]
    return "\n".join(columns([heading, *rows, scale], range(1, len(heading) - 1)))


def _percent(share: float) -> str:
    return "-" if math.isnan(share) else f"{100 * share:.0f} %"


if __name__ == "__main__":
    sys.exit(main())
