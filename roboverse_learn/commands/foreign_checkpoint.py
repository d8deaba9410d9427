"""A checkpoint in a task that it was perhaps not made for: its cameras, sizes and widths, checked first."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import policies
from envs.core.errors import ConfigError
from envs.core.observation_keys import IMAGE_PREFIX
from envs.spec import EnvSpec

ANY_SIZE = ("lerobot", "openvla", "octo")
"""Policies that resize what they see."""

_DEFAULT_PX = 256
"""Image size for a policy that saw images of several sizes, pixels."""


def open_checkpoint(path: str) -> Path:
    """Returns the pretrained folder of a path, or of a name on the hub.

    Raises:
        PolicyError: if there is neither.
    """
    from policies.zoo.source import local_folder

    return local_folder(path)


def task_cameras(env: EnvSpec) -> tuple[str, ...]:
    """Returns the names of every camera of a task."""
    return tuple(camera.name for camera in env.replace(cameras=(), scenario={}).make_task().scenario.cameras)


def seen_env(checkpoint: Path, given: Mapping[str, Any], rename_map: Mapping[str, str]) -> EnvSpec:
    """Returns the cameras of a task that a policy sees, and the size of its images in pixels.

    Args:
        checkpoint: A pretrained folder.
        given: Fields of the environment that are given; ``task`` is one.
        rename_map: Camera of the task to camera of the policy.

    Raises:
        PolicyError: if no camera of the task is one of the policy, or two become the same one.
        UnknownNameError: if a name of ``rename_map`` is no camera.
    """
    from policies.checkpoint import CONFIG, policy_label, policy_type, read_json, seen_cameras
    from policies.zoo.cameras import missing_cameras

    of_task = {key: given[key] for key in ("task", "task_kwargs", "robot") if key in given}
    present = task_cameras(EnvSpec(**of_task))
    seen = given.get("cameras") or present
    _check_names(checkpoint, given["task"], (*present, *seen), seen, rename_map)
    is_published = "input_features" not in read_json(checkpoint / CONFIG)
    if policy_type(checkpoint) == "openvla" and (is_published or rename_map):
        from policies.openvla.config import IMAGE_PX

        chosen = tuple(rename_map)[:1] or present[:1]
        return EnvSpec(cameras=chosen, image_size=IMAGE_PX)
    cameras = seen_cameras(checkpoint, rename_map)
    found = tuple(name for name in present if name in cameras)
    if cameras and not found:
        missing_cameras(policy_label(checkpoint), list(cameras), present, present, given["task"])
    sizes = set(cameras.values())
    return EnvSpec(cameras=found, image_size=sizes.pop() if len(sizes) == 1 else _DEFAULT_PX)


def check_fits(checkpoint: Path, env: EnvSpec, rename_map: Mapping[str, str]) -> None:
    """Checks that cameras, state and actions of a policy are those of the task, before it is loaded.

    An agent of reinforcement learning sees the task itself, which is checked by its name.

    Args:
        checkpoint: A pretrained folder.
        env: The environment of the evaluation.
        rename_map: Camera of the task to camera of the policy.

    Raises:
        ConfigError: if the state, the actions or the images are of another size, or a camera that a policy of
            ours sees is not there.
        PolicyError: if a camera that another policy needs is not there, or two become the same one.
        UnknownNameError: if a name of ``rename_map`` is no camera.
    """
    from policies.checkpoint import CONFIG, policy_label, policy_type, read_json, seen_cameras
    from policies.zoo.cameras import missing_cameras
    from roboverse_learn.commands.dataset_layout import task_layout
    from roboverse_learn.config.schema import CollectConfig

    content, kind = read_json(checkpoint / CONFIG), policy_type(checkpoint)
    if kind in ANY_SIZE:
        present = task_cameras(env)
        cameras = env.cameras or present[:1]
        _check_names(checkpoint, env.task, (*present, *cameras), cameras, rename_map)
        if kind == "lerobot":
            wanted = list(seen_cameras(checkpoint, rename_map))
            missing_cameras(policy_label(checkpoint), wanted, cameras, cameras, env.task)
    elif "input_features" not in content:
        return
    features, _, robot = task_layout(CollectConfig(env=replace(env, scenario={})))
    if kind not in ANY_SIZE:
        _check_images(content["input_features"], features)
    if not getattr(policies.config_class(kind), "pads_tasks", False):
        _check_widths(kind, content, features, env.task, robot)


def _check_images(own: Mapping[str, Any], features: Mapping[str, Any]) -> None:
    """Checks that the images of a policy that resizes none are those of the environment."""
    learned = {key: tuple(each["shape"])[-2:] for key, each in own.items() if key.startswith(IMAGE_PREFIX)}
    here = {key: tuple(each["shape"][:2]) for key, each in features.items() if key.startswith(IMAGE_PREFIX)}
    if any(here.get(key) != size for key, size in learned.items()):
        raise ConfigError(
            f"The policy was trained with the images {_sizes(learned)} (height × width), and those of the "
            f"evaluation are {_sizes(here)}. Leave out cameras and image_size where its run is there, or "
            "give those of training; image_size is the shorter side. Types of policy=lerobot may resize them."
        )


def _sizes(images: Mapping[str, tuple[int, ...]]) -> str:
    """Describes images: ``front 96 × 96, wrist 96 × 96``."""
    each = (f"{key.removeprefix(IMAGE_PREFIX)} {' × '.join(map(str, size))}" for key, size in images.items())
    return ", ".join(each) or "none"


def _check_widths(
    kind: str, content: Mapping[str, Any], features: Mapping[str, Any], task: str, robot: str
) -> None:
    """Checks that a policy's state and actions have as many numbers as those of the task."""
    if kind in ANY_SIZE:
        command = "roboverse train policy=lerobot policy.path=<checkpoint>"
        again = f"fine-tune it on demonstrations of {task}: {command}"
    else:
        again = f"train one: roboverse train policy={kind}"
    for section, key, what in (
        ("output_features", "action", "actions have"),
        ("input_features", "observation.state", "state has"),
    ):
        shape = ((content.get(section) or {}).get(key) or {}).get("shape")
        names = features[key]["names"]
        if shape and int(shape[0]) != len(names):
            raise ConfigError(
                f"The policy's {what} {shape[0]} numbers, and in {task} it is {len(names)} "
                f"({', '.join(names)}) of robot {robot}. Evaluate it in a task, with a robot and with "
                f"task_kwargs.* that it was trained for, or {again} task={task}"
            )


def _check_names(
    checkpoint: Path, task: str, cameras: Sequence[str], seen: Sequence[str], rename_map: Mapping[str, str]
) -> None:
    """Checks the map of a checkpoint's cameras; see :func:`policies.zoo.cameras.check_rename_map`."""
    from policies.checkpoint import CONFIG, policy_label, policy_type, read_json
    from policies.zoo.cameras import cameras_of, check_rename_map

    kind = policy_type(checkpoint)
    if kind == "octo":  # takes no map, and says so
        return
    own: Sequence[str] = ()
    if kind == "openvla":  # sees one camera, by whatever name
        seen = ()
    else:
        own = cameras_of(read_json(checkpoint / CONFIG).get("input_features") or {})
    check_rename_map(rename_map, policy_label(checkpoint), own, cameras, seen, task)


def show_cameras(policy: Any, env: EnvSpec, rename_map: Mapping[str, str]) -> None:
    """Maps the cameras of the environment to those of a policy that takes such a map.

    Args:
        policy: The policy.
        env: The environment of the evaluation.
        rename_map: Camera of the task to camera of the policy.

    Raises:
        ConfigError: if a map is given, and the policy takes none.
        PolicyError: if a camera of the policy is not there.
    """
    if hasattr(policy, "see"):
        policy.see(env.cameras or task_cameras(env)[:1], rename_map)
    elif rename_map:
        raise ConfigError(
            f"rename_map is for policies of LeRobot's registry; policy '{policy.name}' sees the cameras "
            "that it was "
            "trained with. Leave rename_map out."
        )
