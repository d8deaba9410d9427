"""The tasks and instructions of demonstrations, as a policy that reads instructions takes them."""

from dataclasses import dataclass

from envs.core.errors import PolicyError

TASK_INDEX = "task_index"
"""Column of a LeRobot dataset: which instruction, counted from 0, a frame was recorded under."""


ZERO, LAST = -1, -2
"""Of :attr:`LearnedTask.still`: an entry that is 0, and one that stays as in the action before."""

UNRELATED = -1
"""Of :attr:`Instructions.task_of`: an instruction that asks for no learned task."""


@dataclass(frozen=True, kw_only=True, slots=True)
class LearnedTask:
    """A task of a mixture.

    Attributes:
        name: Its registered name; empty where nothing says it.
        state_size: Entries of its ``observation.state``, without padding.
        action_size: Entries of its actions, without padding.
        state_names: Names of the entries of its state, where the dataset has them.
        action_names: Those of its actions.
        still: An action that holds still: for each entry the entry of the state that it equals, :data:`ZERO`
            or :data:`LAST`; empty where it is unknown.
    """

    name: str
    state_size: int
    action_size: int
    state_names: tuple[str, ...] = ()
    action_names: tuple[str, ...] = ()
    still: tuple[int, ...] = ()


@dataclass(frozen=True, kw_only=True, slots=True)
class Instructions:
    """The instructions of a dataset, in the order of its column ``task_index``.

    Attributes:
        texts: The wordings; several may mean one task.
        tasks: The tasks.
        task_of: For each wording its task, counted in ``tasks``, or :data:`UNRELATED`.
        wrong: For each task the wordings, counted in ``texts``, that are wrong in its scenes: nothing there
            is to be done. Empty where they are unknown.

    Raises:
        PolicyError: if the lists do not fit each other.
    """

    texts: tuple[str, ...]
    tasks: tuple[LearnedTask, ...]
    task_of: tuple[int, ...]
    wrong: tuple[tuple[int, ...], ...] = ()

    def __post_init__(self) -> None:
        fits = len(self.texts) == len(self.task_of) and set(self.task_of) <= {
            UNRELATED,
            *range(len(self.tasks)),
        }
        if not (self.texts and fits):
            raise PolicyError(
                f"{len(self.texts)} instructions of {len(self.tasks)} tasks do not fit task_of="
                f"{list(self.task_of)}: name the task of each instruction by its position."
            )
