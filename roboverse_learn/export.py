"""``roboverse export``: a checkpoint for a real robot of LeRobot's.

The folder is a pretrained folder of LeRobot's. Its network and normalization are the checkpoint's; its
preprocessor first resizes the cameras' images to the size that the policy was trained on, so that
``lerobot-rollout`` takes the robot's cameras as they are. ``robot.json`` beside it says what the real scene
has to match.
"""

import shutil
from pathlib import Path
from typing import Any

from envs.core.atomic import atomic_directory, write_json
from envs.core.errors import ConfigError, PolicyError, UnknownNameError, suggest
from envs.core.observation_keys import IMAGE_PREFIX
from envs.joint_readings import joint_readings
from envs.scenario import CameraCfg, RobotCfg
from envs.tasks.base import Task
from roboverse_learn.config.other_commands import ExportConfig

ROBOT_FILE = "robot.json"

RESIZE_STEP = "image_crop_resize_processor"
"""LeRobot's registered step that resizes images."""


def export(config: ExportConfig) -> str:
    """Exports a checkpoint; returns what to print: the folder, and the command for the robot.

    Raises:
        UnknownNameError: ``to`` is no robot of LeRobot's that one here has the joints of.
        ConfigError: No checkpoint is named, its robot is another one, or the folder exists.
        PolicyError: There is no checkpoint, or it is no policy of LeRobot's format.
    """
    from policies.checkpoint import CONFIG, read_json, resolve
    from roboverse_learn.commands.run_folder import read_config, run_of

    _check_target(config.to)
    if not config.checkpoint:
        raise ConfigError("Name what to export, as in: roboverse export checkpoint=runs/<task>/act/<run>")
    checkpoint = resolve(config.checkpoint)
    folder = run_of(checkpoint)
    if folder is None:
        raise ConfigError(
            f"The checkpoint '{config.checkpoint}' is in no run of roboverse train, so its robot is unknown. "
            "A checkpoint of lerobot-train runs on the robot of its dataset without an export."
        )
    spec = read_config(folder).env
    task = spec.make_task()
    robot = _checked_robot(task, config.to)
    cameras = task.scenario.seen_by(spec.cameras, spec.image_size).cameras
    size = _checked_features(checkpoint, read_json(checkpoint / CONFIG), robot, cameras)
    out = Path(config.out) if config.out else Path("exports") / config.to / folder.name
    _write(checkpoint, out, size, _facts(task, robot, cameras))
    return _words(out, robot, task, cameras)


def _check_target(to: str) -> None:
    """Checks the name of LeRobot's robot before anything is read.

    Raises:
        UnknownNameError: No robot here has its joints.
    """
    from envs.robots import ROBOTS

    kinds = {name: ROBOTS.get(name).lerobot_type for name in ROBOTS.names()}
    meant = {name: kind for name, kind in kinds.items() if kind} | {kind: kind for kind in kinds.values()}
    valid = sorted({*kinds.values()} - {""})
    if to not in valid:
        raise UnknownNameError(
            f"Unknown robot to={to}.{suggest(to, filter(None, meant), meant)} Valid: {', '.join(valid)}, the "
            "robots of LeRobot's whose joints a robot here has."
        )


def _checked_robot(task: Task, to: str) -> RobotCfg:
    """Returns the robot of a task, whose observations and actions are what LeRobot's driver reads and sends.

    Raises:
        ConfigError: They are not.
    """
    robot = task.only_robot("roboverse export")
    if robot.lerobot_type != to:
        kind = f"LeRobot's '{robot.lerobot_type}'" if robot.lerobot_type else "no robot of LeRobot's"
        raise ConfigError(
            f"The checkpoint acts with '{robot.name}' in {task.name}, which is {kind}, not '{to}'. Train one "
            "with a robot that is, as in: roboverse train policy=act task=so101/pick_cube preset=quick "
            "image_size=128"
        )
    for what, names in (("observes", task.state_names), ("acts by", task.controller.names)):
        if tuple(names) != robot.reading_names:
            raise ConfigError(
                f"The policy {what} {', '.join(names)}; '{to}' has {', '.join(robot.reading_names)}. Train "
                "it with joint positions as states and actions."
            )
    return robot


def _checked_features(
    checkpoint: Path, content: dict[str, Any], robot: RobotCfg, cameras: tuple[CameraCfg, ...]
) -> tuple[int, int] | None:
    """Returns height and width of the images that a policy takes; None if it takes none.

    Raises:
        PolicyError: Its configuration is not LeRobot's, or its images differ from the cameras'.
    """
    if "input_features" not in content or "output_features" not in content:
        raise PolicyError(
            f"'{checkpoint}' is no policy of LeRobot's format, which lerobot-rollout runs. Export a policy "
            "of imitation: act, diffusion, mtact or lerobot."
        )
    shapes = {key: tuple(feature["shape"]) for key, feature in content["input_features"].items()}
    joints = (len(robot.joints),)
    found = (shapes.get("observation.state"), tuple(content["output_features"]["action"]["shape"]))
    if found[0] not in (None, joints) or found[1] != joints:
        raise PolicyError(
            f"'{checkpoint}' has a state of {found[0]} and an action of {found[1]} numbers; '{robot.name}' "
            f"has {joints[0]} joints."
        )
    expected = {f"{IMAGE_PREFIX}{camera.name}": (3, camera.height, camera.width) for camera in cameras}
    seen = {key: shape for key, shape in shapes.items() if key.startswith(IMAGE_PREFIX)}
    if any(expected.get(key) != shape for key, shape in seen.items()) or len(set(seen.values())) > 1:
        raise PolicyError(
            f"'{checkpoint}' takes images {seen}; its run rendered {expected}. All must be of one size: "
            "export a checkpoint that was trained on the cameras of its task."
        )
    shape = next(iter(seen.values()), None)
    return None if shape is None else (shape[1], shape[2])


def _write(checkpoint: Path, out: Path, size: tuple[int, int] | None, facts: dict[str, Any]) -> None:
    """Writes the folder, which appears once it is complete.

    Raises:
        ConfigError: The folder exists.
        WriteError: It cannot be written.
    """
    from policies.checkpoint import PREPROCESSOR, read_json

    if out.exists():
        raise ConfigError(f"The folder '{out}' exists. Name a new one with out=, or delete it.")
    pipeline = read_json(checkpoint / PREPROCESSOR)
    if size is not None:
        step = {"registry_name": RESIZE_STEP, "config": {"crop_params_dict": None, "resize_size": list(size)}}
        renames = (index for index, each in enumerate(pipeline["steps"]) if "rename" in str(each))
        pipeline["steps"].insert(next(renames, -1) + 1, step)
    with atomic_directory(out) as staging:
        shutil.copytree(checkpoint, staging, dirs_exist_ok=True)
        write_json(staging / PREPROCESSOR, pipeline)
        write_json(staging / ROBOT_FILE, facts)


def _facts(task: Task, robot: RobotCfg, cameras: tuple[CameraCfg, ...]) -> dict[str, Any]:
    """Returns what the real scene has to match, as JSON values."""
    readings = joint_readings(robot)
    low, high = readings.limits([joint.range for joint in robot.joints])
    start = readings.read(list(robot.default_qpos))
    names = [
        {"name": name, "least": round(least, 3), "largest": round(most, 3), "start": round(float(at), 3)}
        for name, least, most, at in zip(readings.names, low, high, start, strict=True)
    ]
    own = {camera.name: camera for camera in task.scenario.cameras}
    return {
        "robot_type": robot.lerobot_type,
        "task": task.name,
        "instruction": task.description,
        "fps": round(task.scenario.physics.control_hz),
        "joints": names,
        "cameras": {
            camera.name: {
                "width": own[camera.name].width,
                "height": own[camera.name].height,
                "fovy_deg": camera.fovy_deg,
                "mount": camera.mount,
                "pos_m": list(camera.pos),
                "look_at_m": list(camera.look_at),
                "policy_width": camera.width,
                "policy_height": camera.height,
            }
            for camera in cameras
        },
    }


def _words(out: Path, robot: RobotCfg, task: Task, cameras: tuple[CameraCfg, ...]) -> str:
    own = {camera.name: camera for camera in task.scenario.cameras}
    fps = round(task.scenario.physics.control_hz)
    devices = ", ".join(
        f"{camera.name}: {{type: opencv, index_or_path: {index}, width: {own[camera.name].width}, "
        f"height: {own[camera.name].height}, fps: {fps}}}"
        for index, camera in enumerate(cameras)
    )
    return (
        f"{out}\n"
        "With the arm connected (docs/howto/so101.md has the steps; begin with a small max_relative_target)\n"
        f"lerobot-rollout --strategy.type=base --policy.path={out} --robot.type={robot.lerobot_type} "
        f'--robot.port=/dev/ttyACM0 --robot.id=my_arm --robot.cameras="{{{devices}}}" '
        f'--robot.max_relative_target=10.0 --fps={fps} --duration=20 --task="{task.description}"'
    )
