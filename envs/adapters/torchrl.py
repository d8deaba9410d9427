"""The Torch environment as a TorchRL ``EnvBase``."""

from typing import Any, override

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from envs.torch_env import TorchEnv


class TorchRlEnv(EnvBase):
    """TorchRL's interface: terminated, truncated and done, and true last observations.

    A step returns the last observation of an episode that is over. The reset that TorchRL calls next returns
    the first observation of the next episode, which the environment has already started.

    Args:
        env: The environment.
    """

    def __init__(self, env: TorchEnv) -> None:
        count = env.num_envs
        super().__init__(device=env.device, batch_size=torch.Size([count]))
        self.env = env
        device: Any = env.device
        seen = Unbounded(torch.Size((count, env.observation_size)), device=device, dtype=torch.float32)
        flag = Binary(n=1, shape=torch.Size((count, 1)), device=device, dtype=torch.bool)
        self.observation_spec = Composite(observation=seen, success=flag.clone(), shape=torch.Size((count,)))
        self.action_spec = Bounded(
            -1.0, 1.0, torch.Size((count, env.action_size)), device=device, dtype=torch.float32
        )
        self.reward_spec = Unbounded(torch.Size((count, 1)), device=device, dtype=torch.float32)
        self.done_spec = Composite(
            {key: flag.clone() for key in ("done", "terminated", "truncated")}, shape=torch.Size((count,))
        )
        self._next: Tensor | None = None
        self._started = torch.ones(count, dtype=torch.bool, device=device)

    @override
    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        step = self.env.step(tensordict["action"])
        self._next, self._started = step.obs, step.terminated | step.truncated
        return self._outputs(
            observation=step.final_obs,
            success=step.success,
            reward=step.reward,
            terminated=step.terminated,
            truncated=step.truncated,
            done=self._started,
        )

    @override
    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDictBase:
        mask = None if tensordict is None else tensordict.get("_reset", None)
        if mask is None or self._next is None:
            self._next = self.env.reset()
        else:
            others = mask.reshape(-1) & ~self._started
            if others.any():
                self._next = self.env.reset(others)
        self._started = torch.zeros_like(self._started)
        none = torch.zeros_like(self._started)
        return self._outputs(observation=self._next, success=none, terminated=none, truncated=none, done=none)

    @override
    def _set_seed(self, seed: int | None) -> None:
        if seed is not None:
            self.env.seed(seed)

    def _outputs(self, **values: Tensor) -> TensorDict:
        columns = {key: value if value.ndim == 2 else value[:, None] for key, value in values.items()}
        return TensorDict(columns, batch_size=self.batch_size, device=self.device)

    @override
    def close(self, *, raise_if_closed: bool = True) -> None:
        if not self.is_closed:
            self.env.close()
        super().close(raise_if_closed=raise_if_closed)
