"""Two states, A and B, whose values are known in closed form; the observation is one-hot."""

import torch
from torch import Tensor

from envs.torch_env import EnvStep

GAMMA = 0.9
REWARD = 1.0


class Chain:
    """A leads to B and B to A; the reward of leaving A is 1.

    Episodes begin at A. They are cut off after ``max_episode_steps``; if ``terminates``, they end for good
    there instead. Cut off or not, the value of A is 1 / (1 - γ²) and of B γ / (1 - γ²).
    """

    observation_size, action_size = 2, 1
    device = torch.device("cpu")

    def __init__(self, num_envs: int = 4, max_episode_steps: int = 3, terminates: bool = False) -> None:
        self.num_envs, self.max_episode_steps, self.terminates = num_envs, max_episode_steps, terminates
        self.elapsed_steps = torch.zeros(num_envs, dtype=torch.long)
        self.at_b = torch.zeros(num_envs, dtype=torch.bool)
        self.seeds: list[int] = []
        self.closed = False

    def seed(self, seed: int) -> None:
        self.seeds.append(seed)

    def reset(self, mask: Tensor | None = None) -> Tensor:
        mask = torch.ones_like(self.at_b) if mask is None else mask
        self.at_b &= ~mask
        self.elapsed_steps[mask] = 0
        return self.observe()

    def observe(self) -> Tensor:
        return torch.stack((~self.at_b, self.at_b), -1).float()

    def step(self, actions: Tensor) -> EnvStep:
        assert actions.shape == (self.num_envs, 1)
        reward = REWARD * (~self.at_b).float()
        self.at_b = ~self.at_b
        self.elapsed_steps += 1
        final = self.observe()
        over = self.elapsed_steps >= self.max_episode_steps
        obs = self.reset(over)
        ended = over & self.terminates
        return EnvStep(obs, reward, ended, over & ~ended, final, ended)

    def close(self) -> None:
        self.closed = True


def value_of(observation: Tensor, gamma: float = GAMMA) -> Tensor:
    """The value of an infinite chain, (…, 1)."""
    both = torch.tensor([1.0, gamma]) / (1 - gamma**2)
    return (observation * both).sum(-1, keepdim=True)
