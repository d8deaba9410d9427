"""An environment of a suite that exists only while it is evaluated."""

from collections.abc import Callable
from typing import Any

from envs.vector_env import RoboVerseVectorEnv


class LazyVectorEnv:
    """Makes its environment when it is first used, and again after it was closed.

    LeRobot asks for the environments of all tasks at once, evaluates one after the other, and closes each.

    Args:
        make: Makes the environment.
        num_envs: Its number of environments.
    """

    def __init__(self, make: Callable[[], RoboVerseVectorEnv], num_envs: int) -> None:
        self._make, self.num_envs = make, num_envs
        self._env: RoboVerseVectorEnv | None = None

    @property
    def unwrapped(self) -> "LazyVectorEnv":
        """Itself."""
        return self

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        if self._env is None:
            self._env = self._make()
        return getattr(self._env, name)

    def close(self) -> None:
        """Frees the simulator, if there is one."""
        if self._env is not None:
            self._env.close()
        self._env = None
