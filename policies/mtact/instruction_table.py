"""Instructions of a dataset on the device, looked up by their index: no text in a gradient step."""

import torch
from torch import Tensor, nn
from torch.nn import functional

from policies.learned_tasks import UNRELATED, Instructions


class InstructionTable(nn.Module):
    """The numbers of each instruction, and which entries of states and actions its task has.

    Its buffers are part of no checkpoint.

    Attributes:
        names: The tasks.
        language: Numbers of the instructions (N, ...).
        task: Which of N instructions is of which of M tasks, one-hot float32 (N, M); 0 of an unrelated one.
        is_state: Entries of the state that an instruction's task has, bool (N, J).
        is_action: Entries of an action that it has, bool (N, A).
    """

    language: Tensor
    task: Tensor
    is_state: Tensor
    is_action: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.names: tuple[str, ...] = ()

    def reworded(self, index: Tensor) -> Tensor:
        """Returns for each instruction (B,) a random one of the same task, which may be itself."""
        is_alike = (self.task[index] @ self.task.T) > 0.0
        return torch.where(is_alike, torch.rand_like(is_alike, dtype=torch.float32), -1.0).argmax(1)

    def fill(self, instructions: Instructions, language: Tensor, state_size: int, action_size: int) -> None:
        """Takes the instructions of a dataset.

        Args:
            instructions: The instructions, in the order of their indices.
            language: Their numbers, on the device of training.
            state_size: J.
            action_size: A.
        """
        tasks, device = instructions.tasks, language.device
        index = torch.tensor(instructions.task_of, device=device)
        sizes = {
            "is_state": ([task.state_size for task in tasks], state_size),
            "is_action": ([task.action_size for task in tasks], action_size),
        }
        self.names = tuple(task.name for task in tasks)
        self.register_buffer("language", language, persistent=False)
        of_task = functional.one_hot(index - UNRELATED, len(tasks) + 1)[:, 1:]
        self.register_buffer("task", of_task.float(), persistent=False)
        for name, (own, size) in sizes.items():
            is_own = torch.arange(size, device=device) < torch.tensor(own, device=device)[index, None]
            self.register_buffer(name, is_own, persistent=False)
