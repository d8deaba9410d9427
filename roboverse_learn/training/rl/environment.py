"""The env of a reinforcement learning run, from the keys that every such run has."""

from contextlib import ExitStack
from typing import Any, Literal

from envs.core.errors import ConfigError


def make_env(config: Any, num_envs: int, seed: int, device: str, **own: Any) -> Any:
    """Makes the env of a run.

    Args:
        config: Configuration of the run.
        num_envs: Environments.
        seed: Seed of the initial states.
        device: ``cpu`` or ``cuda``.
        own: Arguments that only one learner needs; see :class:`envs.torch_env.TorchVectorEnv`.

    Raises:
        ConfigError: as :func:`check_env`.
    """
    check_env(config, expert_starts=own.get("expert_starts", 0.0))
    return config.env.make_torch(num_envs, device=device, seed=seed, **own)


def make_multi_task_env(config: Any, num_envs: int, seed: int, device: str) -> Any:
    """Makes the env of a run that learns several tasks together.

    Args:
        config: Configuration of the run; its ``tasks`` divide the environments among themselves, the first
            ones taking one more where they cannot be divided evenly.
        num_envs: Environments of all tasks together.
        seed: Seed of the initial states.
        device: ``cpu`` or ``cuda``.

    Raises:
        ConfigError: as :func:`check_env`.
    """
    from envs.multi_task_env import MultiTaskEnv

    check_env(config)
    each, more = divmod(num_envs, len(config.tasks))
    envs = {}
    with ExitStack() as opened:  # closes those that there are if one cannot be made
        for index, task in enumerate(config.tasks):
            num = each + (index < more)
            envs[task] = config.env.replace(task=task).make_torch(num, device=device, seed=seed)
            opened.callback(envs[task].close)
        opened.pop_all()
    return MultiTaskEnv(envs)


def make_pixel_env(
    config: Any,
    num_envs: int,
    seed: int,
    device: str,
    *,
    num_frames: int,
    image_size: int,
    observation: Literal["pixels", "pixels_and_state"] = "pixels",
    **own: Any,
) -> Any:
    """Makes the env of a run that learns from images.

    Args:
        config: Configuration of the run; ``cameras`` and ``renderer`` say what is seen.
        num_envs: Environments.
        seed: Seed of the initial states.
        device: ``cpu`` or ``cuda``.
        num_frames: Frames of an observation.
        image_size: Pixels a side that the policy's network takes.
        observation: ``pixels_and_state`` for the robot's own state beside the images.
        own: As in :func:`make_env`.

    Raises:
        ConfigError, UnknownNameError: as :func:`check_images`.
    """
    check_images(config, image_size, expert_starts=own.get("expert_starts", 0.0))
    spec = config.env.replace(image_size=image_size)
    return spec.make_torch(
        num_envs,
        observation=observation,
        num_frames=num_frames,
        num_threads=config.train.num_threads,
        device=device,
        seed=seed,
        **own,
    )


def check_images(config: Any, image_size: int, *, expert_starts: float = 0.0) -> None:
    """Checks that the task of a run has the images that an agent is to learn from, and a reward.

    Args:
        config: Configuration of the run.
        image_size: Pixels a side that the policy's network takes.
        expert_starts: As in :func:`check_env`.

    Raises:
        ConfigError: if the task has no camera, or the requested images have another size or are not square;
            and as :func:`check_env`.
        UnknownNameError: if the task has no camera of a name.
    """
    from envs.pixel_env import watched

    check_env(config, expert_starts=expert_starts)
    if config.env.image_size != image_size:
        raise ConfigError(
            f"policy={config.policy_name} takes images of {image_size} pixels a side, given image_size="
            f"{config.env.image_size}. Add image_size={image_size}, or learn from states with "
            "policy.observation=state."
        )
    scene = config.env.make_task().scenario
    for camera in watched(config.env.task, scene, config.env.cameras, image_size).cameras:
        if camera.width != camera.height:
            raise ConfigError(
                f"policy={config.policy_name} learns from square images, and those of camera '{camera.name}' "
                f"have {camera.width} × {camera.height} pixels. Take cameras=[…] whose images are square."
            )


def check_env(config: Any, *, expert_starts: float = 0.0) -> None:
    """Checks that every task of a run has what an agent is to learn from.

    Args:
        config: Configuration of the run.
        expert_starts: Share of the episodes that are to begin on the way of the task's expert.

    Raises:
        ConfigError: if scenes are to vary as above level 0, which these environments do not do, or a task has
            no reward, or has no expert and needs one.
    """
    if varied := [key for key in ("only", "level", "materials") if getattr(config.env, key)]:
        raise ConfigError(
            f"policy={config.policy_name} learns at level 0, with the built-in materials, given "
            f"{varied[0]}={getattr(config.env, varied[0])}. Leave it out; the other levels can be evaluated, "
            "as in evaluate.levels=[0,1,2,3]."
        )
    for name in config.tasks:
        if not config.env.replace(task=name).make_task().has_reward:
            raise ConfigError(
                f"Task '{name}' has no reward, which policy={config.policy_name} learns from. Learn it "
                "from demonstrations, as with policy=act, or take another task, such as PickCube."
            )
    if expert_starts and not config.env.make_task().has_expert:
        raise ConfigError(
            f"policy.expert_starts={expert_starts:g} lets episodes begin on the way of the task's scripted "
            f"expert, and '{config.env.task}' has none. Take policy.expert_starts=0, or a task with an "
            "expert, such as PickCube."
        )
