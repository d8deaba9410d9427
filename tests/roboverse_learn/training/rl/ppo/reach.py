"""A point that is to go to a goal in the plane: learned in seconds."""

import torch
from torch import Tensor

from envs.torch_env import EnvStep, EpisodeStatistics

REACHED = 0.1


class Reach:
    """An action moves the point by a tenth of it; the reward is the distance, negative.

    Args:
        num_envs: Environments.
        breaks_after: Steps after which the reward is NaN, or None.
    """

    observation_size, action_size, max_episode_steps = 4, 2, 30
    device = torch.device("cpu")

    def __init__(self, num_envs: int = 64, breaks_after: int | None = None) -> None:
        self.num_envs, self.breaks_after, self.steps = num_envs, breaks_after, 0
        self.elapsed_steps = torch.zeros(num_envs, dtype=torch.long)
        self.pos, self.goal = torch.zeros(num_envs, 2), torch.zeros(num_envs, 2)
        self.returns, self.sums = torch.zeros(num_envs), torch.zeros(4)
        self.seed(0)
        self.closed = False

    def seed(self, seed: int) -> None:
        self.generator = torch.Generator().manual_seed(seed)

    def reset(self, mask: Tensor | None = None) -> Tensor:
        ids = torch.arange(self.num_envs) if mask is None else mask.nonzero()[:, 0]
        drawn = torch.rand(len(ids), 4, generator=self.generator) * 2 - 1
        self.pos[ids], self.goal[ids] = drawn[:, :2], drawn[:, 2:]
        self.elapsed_steps[ids], self.returns[ids] = 0, 0.0
        return torch.cat((self.pos, self.goal), -1)

    def step(self, actions: Tensor) -> EnvStep:
        self.steps += 1
        self.pos = self.pos + 0.1 * actions.clamp(-1, 1)
        self.elapsed_steps += 1
        gap = (self.pos - self.goal).norm(dim=-1)
        if self.breaks_after is not None and self.steps > self.breaks_after:
            gap = gap * float("nan")
        self.returns -= gap
        solved = gap < REACHED
        cut_off = (self.elapsed_steps >= self.max_episode_steps) & ~solved
        over = solved | cut_off
        rows = (over, over * self.returns, over * self.elapsed_steps, solved)
        self.sums += torch.stack([row.sum().float() for row in rows])
        final = torch.cat((self.pos, self.goal), -1)
        return EnvStep(self.reset(over), -gap, solved, cut_off, final, solved)

    def pop_statistics(self) -> EpisodeStatistics:
        count, *sums = self.sums.tolist()
        self.sums.zero_()
        return EpisodeStatistics(int(count), *[value / count if count else float("nan") for value in sums])

    def close(self) -> None:
        self.closed = True
