"""The env of a run that learns by reward, from the keys that every such run has."""

from typing import Any


def make_env(config: Any, num_envs: int, seed: int, device: str, **own: Any) -> Any:
    """Makes the env of a run.

    Args:
        config: Configuration of the run.
        num_envs: Environments.
        seed: Seeds which initial states are drawn.
        device: ``cpu`` or ``cuda``.
        own: What one learner alone asks for; see :class:`envs.torch_env.TorchVectorEnv`.
    """
    from envs.torch_env import TorchVectorEnv

    keys = ("task", "simulator", "task_kwargs", "simulator_settings", "scenario")
    scene = {key: getattr(config, key) for key in keys}
    return TorchVectorEnv(num_envs=num_envs, device=device, seed=seed, **scene, **own)
