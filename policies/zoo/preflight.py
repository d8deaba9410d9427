"""Checks of a run of ``policy=lerobot``, ``openvla`` or ``octo`` before any demonstration is collected."""

from collections.abc import Mapping
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from envs.core.errors import MissingExtraError, PolicyError
from envs.core.extras import install_command
from envs.core.observation_keys import IMAGE_PREFIX
from policies import checkpoint
from policies.zoo.assets import read_assets
from policies.zoo.cameras import cameras_of, check_rename_map, check_state_size, missing_cameras
from policies.zoo.config import LeRobotConfig, full_rename_map
from policies.zoo.source import local_folder
from policies.zoo.types import EXTRA, check_settings, check_type, type_names

if TYPE_CHECKING:
    from policies.octo.config import OctoConfig
    from policies.openvla.config import OpenVlaConfig

NEEDS_NOTHING = ("act", "diffusion", "vqbet")
"""Types that LeRobot itself suffices for."""

_BESIDE_TRANSFORMERS: Mapping[str, tuple[str, ...]] = {
    "smolvla": ("num2words",),
    "multi_task_dit": ("diffusers",),
    "groot": ("diffusers", "tree"),
    "wall_x": ("peft", "torchdiffeq", "qwen_vl_utils"),
    "vla_jepa": ("diffusers",),
    "fastwam": ("diffusers",),
    "lingbot_va": ("diffusers",),
}
"""Modules that a type imports when its network or processor is made, after demonstrations are collected."""

_STATE = "observation.state"


def check_packages(what: str, *packages: str) -> None:
    """Checks that packages of the extra are installed, without importing them.

    Raises:
        MissingExtraError: if one is not.
    """
    if missing := [name for name in packages if find_spec(name) is None]:
        raise MissingExtraError(f"{what} needs {' and '.join(missing)}: {install_command(EXTRA)}")


def packages_of_type(name: str) -> tuple[str, ...]:
    """Returns the modules of the extra that a type of LeRobot imports; adapters need peft beside them."""
    return () if name in NEEDS_NOTHING else ("transformers", *_BESIDE_TRANSFORMERS.get(name, ()))


def check_type_packages(name: str) -> None:
    """Checks that what a type of LeRobot imports is installed, without importing it.

    Raises:
        MissingExtraError: if a package is not.
    """
    check_packages(f"LeRobot's {name}", *packages_of_type(name))


def check_lerobot(config: LeRobotConfig, features: Mapping[str, Any]) -> None:
    """Checks the type, the checkpoint to fine-tune and its cameras against the features of a dataset.

    A checkpoint on the hub is fetched now.

    Raises:
        MissingExtraError: if a package is not installed.
        PolicyError: if neither type nor checkpoint is given, if the checkpoint is not there, not LeRobot's,
            of another type, or sees other cameras, or if LeRobot cannot train the type, or cannot act with
            it, without a setting that is absent.
        UnknownNameError: if a name of ``rename_map`` is no camera.
    """
    name, content = config.type, None
    if config.path:
        folder = local_folder(config.path)
        content = checkpoint.read_json(folder / checkpoint.CONFIG)
        name = _type_in(content, config.path)
        read_assets(folder)  # says what is missing
        if config.type not in ("", name):
            raise PolicyError(
                f"'{config.path}' is of type {name}, and type={config.type} was given. Leave out type."
            )
        check_type(name)
        check_settings(name, config.settings)
    if not name:
        raise PolicyError(
            "policy=lerobot needs type=<name>, as in type=smolvla, or policy.path=<folder or hub name> to "
            f"fine-tune. Types: {', '.join(type_names())}."
        )
    check_type_packages(name)
    _check_trainable(name, (content or {}) | config.settings)
    if config.peft.method_type:
        check_packages("peft.*", "peft")
    inputs = (content or {}).get("input_features") or {}
    own, cameras = cameras_of(inputs), cameras_of(features)
    check_rename_map(config.rename_map, name, own, cameras, cameras, "the dataset")
    if content is not None:
        _check_features(name, content, features, full_rename_map(config.rename_map))


def _type_in(content: Mapping[str, Any], path: str) -> str:
    """Returns the type of a checkpoint of LeRobot's; GR00T's own and those of plain networks have none."""
    name = content.get("type")
    if isinstance(name, str):
        return name
    kind = str(content.get("model_type") or "")
    if kind in ("octo", "openvla"):
        raise PolicyError(f"'{path}' is of {kind}: give policy={kind} policy.path={path}.")
    raise PolicyError(
        f"'{path}' is no checkpoint of LeRobot's: its config.json has no type"
        f"{f', and its model_type is {kind}' if kind else ''}. Give a folder that LeRobot or this project "
        "saved. A network that a type begins with is given by a setting of that type, as in type=groot "
        f"policy.base_model_path={path}, or type=smolvla policy.vlm_model_name={path}."
    )


def _check_trainable(name: str, settings: Mapping[str, Any]) -> None:
    """Refuses settings that LeRobot would refuse at the first gradient step, or at the first action."""
    if name == "lingbot_va" and settings.get("attn_mode") != "flex":
        raise PolicyError(
            "LeRobot trains lingbot_va with policy.attn_mode=flex alone, on a GPU, and acts with "
            "policy.attn_mode=torch. Add policy.attn_mode=flex."
        )
    if name == "molmoact2" and settings.get("inference_action_mode") is None:
        raise PolicyError(
            "LeRobot's molmoact2 needs its kind of action. Add policy.inference_action_mode=continuous, or "
            "discrete."
        )


def _check_features(
    name: str, content: Mapping[str, Any], features: Mapping[str, Any], rename_map: Mapping[str, str]
) -> None:
    inputs = content.get("input_features") or {}
    cameras = cameras_of(features)
    keys = [IMAGE_PREFIX + camera for camera in cameras]
    given = [rename_map.get(key, key).removeprefix(IMAGE_PREFIX) for key in keys]
    missing_cameras(name, cameras_of(inputs), given, cameras, "the dataset")
    if _STATE in features:
        trained = inputs[_STATE]["shape"][0] if _STATE in inputs else None
        check_state_size(int(features[_STATE]["shape"][0]), trained, content.get("max_state_dim"))


def check_openvla(config: "OpenVlaConfig", features: Mapping[str, Any]) -> None:
    """Checks that OpenVLA's packages and its checkpoint are here; one on the hub is fetched now.

    Raises:
        MissingExtraError: if a package is not installed.
        PolicyError: if the checkpoint is not there, or the camera is none of the dataset.
    """
    del features
    check_packages("OpenVLA", "transformers", "timm", *(["peft"] if config.peft.method_type else []))
    if config.path:
        local_folder(config.path)


def check_octo(config: "OctoConfig", features: Mapping[str, Any]) -> None:
    """Checks that Octo's package and its checkpoint are here.

    Raises:
        MissingExtraError: if the package is not installed.
        PolicyError: if the checkpoint is not there, or is not converted.
    """
    del features
    check_packages("Octo", "transformers", *(["peft"] if config.peft.method_type else []))
    if config.path:
        from policies.octo.sizes import sizes_of

        sizes_of(checkpoint.read_json(local_folder(config.path) / checkpoint.CONFIG))
