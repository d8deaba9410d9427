"""The Torch environment as an rsl_rl ``VecEnv``."""

from typing import Any

from rsl_rl.env import VecEnv
from tensordict import TensorDict
from torch import Tensor

from envs.torch_env import TorchEnv

GROUP = "policy"
"""Name of the only group of observations."""


class RslRlVecEnv(VecEnv):
    """rsl_rl's interface: TensorDict observations, tensors on the device.

    ``extras["time_outs"]`` are the truncated episodes. rsl_rl's PPO bootstraps them with the value of the
    observation before the last step; the last observation is ``extras["final_obs"]``.

    Args:
        env: The environment.
    """

    def __init__(self, env: TorchEnv) -> None:
        self.env = env
        self.num_envs, self.num_actions = env.num_envs, env.action_size
        self.max_episode_length = env.max_episode_steps
        self.device = env.device
        self.cfg = {}
        self._obs = env.reset()

    @property
    def episode_length_buf(self) -> Tensor:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Control steps of the present episodes, (N,) int64."""
        return self.env.elapsed_steps

    @episode_length_buf.setter
    def episode_length_buf(self, steps: Tensor) -> None:  # pyright: ignore[reportIncompatibleVariableOverride]
        # The runner sets it, so that not all episodes end at once.
        self.env.elapsed_steps = steps.to(self.env.elapsed_steps)

    def get_observations(self) -> TensorDict:
        """Returns the present observations."""
        return self._grouped(self._obs)

    def step(self, actions: Tensor) -> tuple[TensorDict, Tensor, Tensor, dict[str, Any]]:
        """Steps every environment."""
        step = self.env.step(actions)
        self._obs = step.obs
        extras = {"time_outs": step.truncated, "final_obs": self._grouped(step.final_obs)}
        return self._grouped(step.obs), step.reward, step.terminated | step.truncated, extras

    def _grouped(self, obs: Tensor) -> TensorDict:
        return TensorDict({GROUP: obs}, batch_size=[self.num_envs], device=obs.device)
