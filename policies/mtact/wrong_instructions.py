"""Training samples that are shown an instruction that is wrong in their scene, and hold still.

Scenes of different tasks look different, so a network learns their demonstrations at no loss while it ignores
the sentence. These samples make it read: only the sentence says whether there is anything to do.

Shape legend: B = samples, J = entries of the state, A = entries of an action, N = instructions, M = tasks.
"""

import torch
from lerobot.utils.constants import ACTION, OBS_STATE
from torch import Tensor, nn

from policies.learned_tasks import LAST, UNRELATED, ZERO, Instructions
from policies.normalization import KeyNormalizer


class WrongInstructions(nn.Module):
    """Draws wrong instructions, and says what holding still is.

    Half of those that it draws are of other learned tasks and half are unrelated, where there are both. They
    are drawn with torch's global generator, which the training loop seeds at every step. They are not those
    of other samples: a batch has few sentences, and none that is unrelated.

    Args:
        share: Share of the samples that get a wrong instruction, where their task has any.
        instructions: Those of the dataset.
        normalizer: Normalizes states and actions.
        action_size: A, with padding.
        device: Torch device.

    Attributes:
        cumulative: Probability that a wrong instruction of a task is one of the first n + 1, (M, N).
        shares: Share of each task's samples, (M,).
        source: Entry of the state that an entry of a still action equals, ``ZERO`` or ``LAST``, (M, A).
    """

    cumulative: Tensor
    shares: Tensor
    source: Tensor

    def __init__(
        self,
        share: float,
        instructions: Instructions,
        normalizer: KeyNormalizer,
        action_size: int,
        device: torch.device,
    ) -> None:
        super().__init__()
        self.normalizer = normalizer
        tasks, num = instructions.tasks, len(instructions.texts)
        weights = torch.zeros(len(tasks), num, dtype=torch.float64)
        for task, wrong in enumerate(instructions.wrong):
            unrelated = [index for index in wrong if instructions.task_of[index] == UNRELATED]
            for of_kind in (sorted({*wrong} - {*unrelated}), unrelated):
                weights[task, of_kind] = 1.0 / max(1, len(of_kind))
        has_wrong = weights.any(1) & torch.tensor([bool(task.still) for task in tasks])
        total = weights.sum(1, keepdim=True)
        cumulative = torch.where(total > 0.0, weights.cumsum(1) / total.clamp_min(1e-9), 1.0)
        cumulative[:, -1] = 1.0
        source = torch.full((len(tasks), action_size), ZERO)
        for row, task in zip(source, tasks, strict=True):
            row[: len(task.still)] = torch.tensor(task.still, dtype=torch.int64)
        self.register_buffer("cumulative", cumulative.float().to(device), persistent=False)
        self.register_buffer("shares", (share * has_wrong).float().to(device), persistent=False)
        self.register_buffer("source", source.to(device), persistent=False)

    def draw(self, task: Tensor) -> tuple[Tensor, Tensor]:
        """Returns for samples of tasks (B,) whether each is asked wrongly, bool (B,), and then what (B,)."""
        chance, place = torch.rand(2, len(task), device=task.device)
        drawn = (self.cumulative[task] <= place[:, None]).sum(1)
        return chance < self.shares[task], drawn

    def still(self, task: Tensor, state: Tensor, last: Tensor) -> Tensor:
        """Returns the normalized actions (B, A) that keep robots still.

        Args:
            task: (B,).
            state: Normalized states (B, J).
            last: Normalized actions of the step before (B, A).
        """
        source = self.source[task]
        state = self.normalizer.restore(OBS_STATE, state)
        held = state.gather(1, source.clamp_min(0)) * (source >= 0)
        return torch.where(source == LAST, last, self.normalizer({ACTION: held})[ACTION])
