"""One environment with the interface of ``gymnasium.Env``, and the functions behind ``gymnasium.make``."""

from typing import Any

import gymnasium
import numpy as np

from envs.lazy_images import row_of
from envs.spec import EnvSpec, split_options
from envs.step_checks import check_reset_options, wrong_shape
from envs.vector_env import RoboVerseVectorEnv


def make_vec(task: str, num_envs: int = 1, **options: Any) -> RoboVerseVectorEnv:
    """Makes ``num_envs`` environments of a task.

    Args:
        task: Name of the task.
        num_envs: Number of environments.
        **options: Fields of :class:`~envs.spec.EnvSpec` and options of :meth:`~envs.spec.EnvSpec.make`.

    Raises:
        UnknownNameError: An option or a name does not exist.
        ConfigError: A value is out of range.
    """
    fields, runtime = split_options(options)
    return EnvSpec.from_json({"task": task, **fields}).make(num_envs, **runtime)


class RoboVerseEnv(gymnasium.Env):
    """One environment, with the interface of ``gymnasium.Env`` and the keys that LeRobot expects.

    Args:
        task: Name of the task.
        render_mode: ``"rgb_array"`` or None.
        **options: As of :func:`make_vec`.

    Attributes:
        task: The task's name.
        task_description: The present instruction.
        batch: The environment of a batch of one behind this interface.
        env_spec: The :class:`~envs.spec.EnvSpec` that made it.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}  # noqa: RUF012 (Gymnasium's interface)

    def __init__(self, task: str, *, render_mode: str | None = "rgb_array", **options: Any) -> None:
        self.batch = make_vec(task, 1, autoreset_mode="Disabled", **options)
        self.env_spec = self.batch.env_spec
        self.task = task
        self.render_mode = render_mode
        self.observation_space = self.batch.single_observation_space
        self.action_space = self.batch.single_action_space
        self.metadata = {**self.metadata, "render_fps": self.batch.metadata["render_fps"]}
        self._max_episode_steps = self.batch.max_episode_steps

    @property
    def task_description(self) -> str:
        """The present instruction."""
        return self.batch.instruction(0)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Starts an episode; equal seeds give equal episodes. ``options["episode"]`` names one.

        Raises:
            ConfigError: The episode is not in the environment's split.
            UnknownNameError: There is no such option.
        """
        check_reset_options(options or (), ("episode",))
        super().reset(seed=seed)
        episode = (options or {}).get("episode")
        if episode is None:
            episode = self.np_random.choice(self.batch.split_indices)
        observation, _ = self.batch.reset(options={"episodes": [int(episode)]})
        return row_of(observation, 0), self._info(False)

    def step(self, action: np.ndarray) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Steps by one control step; ``action`` (A,) is the controller's.

        Raises:
            InvalidActionError: It has another shape, or is not finite.
            ResetNeededError: The environment was never reset.
        """
        action = np.asarray(action)
        if action.shape != self.action_space.shape:
            names = self.batch.controller.names
            raise wrong_shape(action, (len(names),), names)
        observation, result = self.batch.step_without_restarts(action[None])
        reward, terminated, truncated, success = (values.item() for values in result)
        return row_of(observation, 0), reward, terminated, truncated, self._info(success)

    def _info(self, success: bool) -> dict[str, Any]:
        return {"success": success, "is_success": success, "episode_index": int(self.batch.episodes[0])}

    def render(self) -> np.ndarray | None:
        """Returns the first camera's image, (H, W, 3) uint8."""
        return self.batch.render()[0] if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        """Frees the simulator."""
        self.batch.close()
