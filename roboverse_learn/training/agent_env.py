"""The env of a run that learns by reward, from the keys that every such run has."""

from typing import Any

from envs.errors import ConfigError


def make_env(config: Any, num_envs: int, seed: int, device: str, **own: Any) -> Any:
    """Makes the env of a run.

    Args:
        config: Configuration of the run.
        num_envs: Environments.
        seed: Seeds which initial states are drawn.
        device: ``cpu`` or ``cuda``.
        own: What one learner alone asks for; see :class:`envs.torch_env.TorchVectorEnv`.

    Raises:
        ConfigError: if the task pays no reward.
    """
    from envs.torch_env import TorchVectorEnv

    check_reward(config.policy_name, config.task, config.task_kwargs)
    keys = ("task", "simulator", "task_kwargs", "simulator_settings", "scenario")
    scene = {key: getattr(config, key) for key in keys}
    return TorchVectorEnv(num_envs=num_envs, device=device, seed=seed, **scene, **own)


def check_reward(policy: str, task: str, task_kwargs: dict[str, Any]) -> None:
    """Checks that a task pays a reward.

    Args:
        policy: What is to learn from it.
        task: Registered task.
        task_kwargs: Its options.

    Raises:
        ConfigError: if it does not.
    """
    from envs.tasks import TASKS

    if not TASKS.get(task)(**task_kwargs).has_reward:
        raise ConfigError(
            f"Task '{task}' pays no reward, which policy={policy} learns from. Learn it from demonstrations, "
            "as with policy=act, or take another task, such as PickCube."
        )
