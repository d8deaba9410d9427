"""What URDF cannot hold and MuJoCo needs, as JSON beside the file: ``to=mjcf`` reads it.

It holds the actuators of joints, the armature, and whether the root moves freely.
"""

import json
from pathlib import Path
from typing import Any

import mujoco

from envs.convert.description import Description
from envs.core.errors import ConfigError

_VERSION = 1
_ARRAYS = ("gainprm", "biasprm", "dynprm", "gear", "ctrlrange", "forcerange")
_KINDS = ("gaintype", "biastype", "dyntype", "ctrllimited", "forcelimited")


def sidecar_path(urdf: Path) -> Path:
    """Returns the path of the file beside a URDF file."""
    return urdf.with_suffix(".mujoco.json")


def write_sidecar(
    model: mujoco.MjModel, prefix: str, description: Description, urdf: Path
) -> tuple[str, ...]:
    """Writes the file beside a URDF file.

    Args:
        model: The compiled source.
        prefix: Prefix of its names, which is removed.
        description: What the URDF file was written from.
        urdf: The file.

    Returns:
        What neither of the two holds, one sentence each.
    """
    losses, actuators = [], []
    for index in range(model.nu):
        name = model.actuator(index).name.removeprefix(prefix) or f"actuator{index}"
        if int(model.actuator_trntype[index]) != int(mujoco.mjtTrn.mjTRN_JOINT):
            losses.append(f"Actuator '{name}' acts on no joint and is left out.")
            continue
        joint = model.joint(int(model.actuator_trnid[index, 0])).name.removeprefix(prefix)
        actuators.append(
            {"name": name, "joint": joint or f"joint{int(model.actuator_trnid[index, 0])}"}
            | {key: getattr(model, f"actuator_{key}")[index].tolist() for key in _ARRAYS}
            | {key: int(getattr(model, f"actuator_{key}")[index]) for key in _KINDS}
        )
    content = {
        "version": _VERSION,
        "floating": description.floating,
        "armature": {joint.name: joint.armature for joint in description.joints if joint.armature},
        "actuators": actuators,
    }
    sidecar_path(urdf).write_text(json.dumps(content, indent=1), encoding="utf-8")
    # Without them the robot moves as before, but what reads them, such as an observation, does not find them.
    counts = {"Sites": model.nsite, "Sensors": model.nsensor, "Keyframes": model.nkey}
    return (*losses, *(f"{what} ({count}) are left out." for what, count in counts.items() if count))


def read_sidecar(spec: mujoco.MjSpec, urdf: Path) -> None:
    """Adds what the file beside a URDF file says to what MuJoCo read from the URDF file.

    Raises:
        ConfigError: The file is damaged, or of another robot.
    """
    path = sidecar_path(urdf)
    if not path.is_file():
        return
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["version"] != _VERSION:
            raise ValueError(f"version {content['version']}, readable is {_VERSION}")
        _add(spec, content)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ConfigError(
            f"'{path}' does not fit '{urdf.name}': {error}. Convert the robot again, or delete the file; its "
            "actuators and armature are then left out."
        ) from error


def _add(spec: mujoco.MjSpec, content: dict[str, Any]) -> None:
    joints = {joint.name: joint for joint in spec.joints}
    for name in (*content["armature"], *(actuator["joint"] for actuator in content["actuators"])):
        if name not in joints:
            raise ValueError(f"there is no joint '{name}'")
    for name, armature in content["armature"].items():
        joints[name].armature = armature
    for values in content["actuators"]:
        actuator = spec.add_actuator(name=values["name"], target=values["joint"])
        actuator.trntype = mujoco.mjtTrn.mjTRN_JOINT
        for key in _ARRAYS:
            getattr(actuator, key)[:] = values[key]
        for key in _KINDS:
            setattr(actuator, key, values[key])
    if content["floating"]:
        spec.worldbody.first_body().add_freejoint()
