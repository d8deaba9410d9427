"""Tasks that small agents learn in seconds, with the interface of :class:`envs.torch_env.TorchVectorEnv`."""

import torch

from envs.torch_env import EnvStep, EpisodeStatistics

STEPS, DT, WALL = 25, 0.2, 2.0
RANDOM_RETURN, GOOD_RETURN = 7.0, 17.0


class PointMass:
    """A point on a line that is pushed to its middle: the nearer, the more reward; a wall ends it.

    Pushing to the middle at once and braking there returns about 19; random pushes about 7.
    """

    observation_size, action_size, max_episode_steps = 2, 1, STEPS

    def __init__(self, num_envs, seed=0):
        self.num_envs, self.device = num_envs, torch.device("cpu")
        self.seed(seed)
        self.position, self.speed = torch.zeros(num_envs), torch.zeros(num_envs)
        self.elapsed_steps, self.returns = torch.zeros(num_envs), torch.zeros(num_envs)
        self.ended, self.closed = [], False

    def seed(self, seed):
        self.generator = torch.Generator().manual_seed(seed)

    def random_state(self):
        return self.generator.get_state()

    def set_random_state(self, state):
        self.generator.set_state(state)

    def reset(self, mask=None):
        mask = torch.ones(self.num_envs, dtype=torch.bool) if mask is None else mask
        start = torch.rand(self.num_envs, generator=self.generator) * 2.0 - 1.0
        self.position = torch.where(mask, start, self.position)
        for name in ("speed", "elapsed_steps", "returns"):
            setattr(self, name, torch.where(mask, 0.0, getattr(self, name)))
        return self._observe()

    def _observe(self):
        return torch.stack([self.position, self.speed], dim=-1)

    def step(self, actions):
        self.speed = (self.speed + 2.0 * DT * actions[:, 0].clamp(-1, 1)).clamp(-2, 2)
        self.position = self.position + DT * self.speed
        self.elapsed_steps = self.elapsed_steps + 1
        reward = torch.exp(-4.0 * self.position.square())
        terminated = self.position.abs() > WALL
        truncated = (self.elapsed_steps >= STEPS) & ~terminated
        self.returns = self.returns + reward
        over, last = terminated | truncated, self._observe()
        self.ended += list(zip(self.returns[over].tolist(), self.elapsed_steps[over].tolist(), strict=True))
        observation = self.reset(over) if over.any() else last
        return EnvStep(observation, reward, terminated, truncated, last, truncated)

    def pop_statistics(self):
        ended, self.ended = torch.tensor(self.ended).reshape(-1, 2), []
        means = ended.mean(0).tolist()
        return EpisodeStatistics(len(ended), means[0], means[1], float("nan") if not len(ended) else 1.0)

    def state_dict(self):
        names = ("position", "speed", "elapsed_steps", "returns")
        return {name: getattr(self, name).clone() for name in names}

    def load_state_dict(self, state):
        for name, value in state.items():
            setattr(self, name, value.clone())
        return self._observe()

    def close(self):
        self.closed = True


class Mirrored(PointMass):
    """A point mass that moves against its push; a second push does nothing, time is observed."""

    observation_size, action_size = 3, 2

    def _observe(self):
        return torch.cat([super()._observe(), self.elapsed_steps[:, None] / STEPS], dim=-1)

    def step(self, actions):
        return super().step(-actions)
