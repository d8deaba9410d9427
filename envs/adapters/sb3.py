"""The Torch environment as a Stable-Baselines3 ``VecEnv``."""

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
import torch
from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvIndices, VecEnvObs, VecEnvStepReturn

from envs.torch_env import TorchEnv


class Sb3VecEnv(VecEnv):
    """Stable-Baselines3's interface: NumPy arrays, and one info per environment.

    ``info["terminal_observation"]`` is an episode's last observation; Stable-Baselines3 bootstraps its value
    where ``info["TimeLimit.truncated"]`` is true. ``info["episode"]`` holds return and length as ``Monitor``
    gives them, of the agent's reward.

    Args:
        env: The environment.
    """

    def __init__(self, env: TorchEnv) -> None:
        self.env = env
        shape = (env.observation_size,)
        seen = gymnasium.spaces.Box(-np.inf, np.inf, shape, np.float32)
        super().__init__(env.num_envs, seen, gymnasium.spaces.Box(-1.0, 1.0, (env.action_size,), np.float32))
        self._actions = torch.zeros((env.num_envs, env.action_size), device=env.device)
        self._returns, self._lengths = np.zeros(env.num_envs), np.zeros(env.num_envs, int)

    def reset(self) -> VecEnvObs:
        """Starts an episode everywhere."""
        if self._seeds and self._seeds[0] is not None:
            self.env.seed(self._seeds[0])
        self._reset_seeds()
        self._reset_options()
        self.reset_infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        self._returns[:], self._lengths[:] = 0.0, 0
        return self.env.reset().cpu().numpy()

    def step_async(self, actions: np.ndarray) -> None:
        """Takes the actions (N, A) of the next step."""
        self._actions = torch.as_tensor(actions, dtype=torch.float32, device=self.env.device)

    def step_wait(self) -> VecEnvStepReturn:
        """Steps every environment."""
        step = self.env.step(self._actions)
        obs, reward, terminated, truncated, success = (
            value.cpu().numpy()
            for value in (step.obs, step.reward, step.terminated, step.truncated, step.success)
        )
        dones = terminated | truncated
        self._returns += reward
        self._lengths += 1
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        ids = np.flatnonzero(dones)
        if len(ids):
            last = step.final_obs.cpu().numpy()
            for i in ids:
                infos[i] = {
                    "terminal_observation": last[i],
                    "TimeLimit.truncated": bool(truncated[i]),
                    "is_success": bool(success[i]),
                    "episode": {"r": float(self._returns[i]), "l": int(self._lengths[i]), "t": 0.0},
                }
            self._returns[ids], self._lengths[ids] = 0.0, 0
        return obs, reward, dones, infos

    def close(self) -> None:
        """Frees the simulator."""
        self.env.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Returns an attribute of the batch, once per environment."""
        return [getattr(self.env, attr_name, None)] * len(self._ids(indices))

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Sets an attribute of the batch, which all environments share."""
        setattr(self.env, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Calls a method of the batch once; returns its result once per environment."""
        answer = getattr(self.env, method_name)(*method_args, **method_kwargs)
        return [answer] * len(self._ids(indices))

    def env_is_wrapped(self, wrapper_class: type, indices: VecEnvIndices = None) -> list[bool]:
        """Returns False for each: a batch has no wrappers."""
        return [False] * len(self._ids(indices))

    def _ids(self, indices: VecEnvIndices) -> Sequence[int]:
        if indices is None:
            return range(self.num_envs)
        return [indices] if isinstance(indices, int) else [int(index) for index in indices]
