"""What a policy is asked in an instruction test, and when."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from benchmark.records import EpisodeRecord
from envs.core.errors import ConfigError
from envs.randomization import channel_rng

if TYPE_CHECKING:
    from envs.rollout import Episode
    from envs.tasks.base import Task

_KINDS = ("known", "new_frame", "new_words")


@dataclass(frozen=True, slots=True)
class Script:
    """The instructions of one episode.

    Attributes:
        instruction: The first.
        switched_at: The control step before which it is switched, or None.
        switched_to: What it is switched to.
    """

    instruction: str
    switched_at: int | None = None
    switched_to: str | None = None

    @classmethod
    def of(cls, record: EpisodeRecord) -> "Script | None":
        """Returns what the policy was asked in a recorded episode; None where the file does not say it."""
        if record.instruction is None:
            return None
        return cls(record.instruction, record.switched_at, record.switched_to)


class Prompter:
    """Gives the environment of each episode its instructions: what ``rollout`` calls after every step.

    Args:
        env: The environment.
        script_of: Returns the script of an episode, called once when it has started.
    """

    def __init__(self, env: Any, script_of: "Callable[[Episode], Script]") -> None:
        self._env, self._script_of = env, script_of
        self._scripts: dict[int, Script] = {}

    def __call__(self, episode: "Episode") -> None:
        """Gives the episode what it is asked from now on."""
        if episode.length == 0:
            self._scripts[episode.position] = self._script_of(episode)
            episode.instruction = self._scripts[episode.position].instruction
            self._env.set_instruction(episode.env_id, episode.instruction)
        script = self._scripts[episode.position]
        if script.switched_at is not None and episode.length == script.switched_at:
            self._env.set_instruction(episode.env_id, script.switched_to)

    def facts(self, episode: "Episode") -> dict[str, Any]:
        """Returns what a record says of a finished episode's instructions."""
        script = self._scripts[episode.position]
        if script.switched_at is None or script.switched_at >= episode.length:
            return {}
        return {"switched_at": script.switched_at, "switched_to": script.switched_to}


class Scripts:
    """The scripts of an instruction test: a pure function of the task, the seed and the episode.

    A switched instruction also needs the lengths of the same episodes with the right instruction: it changes
    after half as many steps, in the middle of what the policy does.

    Args:
        test: One of :data:`~benchmark.protocol.INSTRUCTION_TESTS`.
        task: The task.
        seed: The protocol's seed.
        lengths: Episode to its control steps at level 0.

    Raises:
        ConfigError: The task has no instruction for this test.
    """

    def __init__(self, test: str, task: "Task", seed: int, lengths: Mapping[int, int]) -> None:
        self._test, self._task, self._seed, self._lengths = test, task, seed, lengths
        self._wrong = _wrong_of(task) if test in ("wrong", "switched") else ()
        if test in _KINDS and not task.wordings(task.description).of_kind(test):
            raise ConfigError(
                f"The instruction of {task.name}, '{task.description}', has no wording of the kind '{test}'. "
                f"Leave {test} out of instructions, or give the task a bank of its own (Task.wordings)."
            )

    def __call__(self, episode: "Episode") -> Script:
        """Returns the script of an episode that has started, whose instruction is still the task's own."""
        own = episode.instruction
        if self._test == "empty":
            return Script("")
        rng = channel_rng(self._seed, f"instruction/{self._test}", episode.episode)
        options = self._task.wordings(own).of_kind(self._test) if self._test in _KINDS else self._wrong
        drawn = options[int(rng.integers(len(options)))]
        if self._test == "switched":
            return Script(own, max(1, self._lengths[episode.episode] // 2), drawn)
        return Script(drawn)


def check_instruction_tests(task: "Task", tests: tuple[str, ...]) -> None:
    """Checks that a task has instructions for every test, before hours are spent on the first ones.

    Raises:
        ConfigError: It has not.
    """
    for test in tests:
        Scripts(test, task, 0, {})


def _wrong_of(task: "Task") -> tuple[str, ...]:
    from envs.tasks.wrong_instructions import wrong_instructions

    return wrong_instructions(task)
