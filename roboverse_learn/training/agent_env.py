"""The env of a run that learns by reward, from the keys that every such run has."""

from typing import Any

from envs.errors import ConfigError
from envs.tasks.making import make_task


def make_env(config: Any, num_envs: int, seed: int, device: str, **own: Any) -> Any:
    """Makes the env of a run.

    Args:
        config: Configuration of the run.
        num_envs: Environments.
        seed: Seeds which initial states are drawn.
        device: ``cpu`` or ``cuda``.
        own: What one learner alone asks for; see :class:`envs.torch_env.TorchVectorEnv`.

    Raises:
        ConfigError: as :func:`check_env`.
    """
    from envs.torch_env import TorchVectorEnv

    check_env(config, expert_starts=own.get("expert_starts", 0.0))
    keys = ("task", "simulator", "task_kwargs", "simulator_settings", "scenario")
    scene = {key: getattr(config, key) for key in keys}
    return TorchVectorEnv(num_envs=num_envs, device=device, seed=seed, **scene, **own)


def check_env(config: Any, *, expert_starts: float = 0.0) -> None:
    """Checks that the task of a run has what an agent is to learn from.

    Args:
        config: Configuration of the run.
        expert_starts: Share of the episodes that are to begin on the way of the task's expert.

    Raises:
        ConfigError: if it pays no reward, or has no expert and needs one.
    """
    task = make_task(config.task, config.task_kwargs, config.scenario)
    if not task.has_reward:
        raise ConfigError(
            f"Task '{config.task}' pays no reward, which policy={config.policy_name} learns from. Learn it "
            "from demonstrations, as with policy=act, or take another task, such as PickCube."
        )
    if expert_starts and not task.has_expert:
        raise ConfigError(
            f"policy.expert_starts={expert_starts:g} lets episodes begin on the way of the task's scripted "
            f"expert, and '{config.task}' has none. Take policy.expert_starts=0, or a task with an expert, "
            "such as PickCube."
        )
