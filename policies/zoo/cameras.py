"""Which cameras and states a policy of LeRobot takes, and the sentence where they are not there."""

from collections.abc import Mapping, Sequence
from typing import Any

from envs.core.errors import PolicyError, unknown_name
from envs.core.observation_keys import IMAGE_PREFIX

FEWER_CAMERAS = ("smolvla", "pi0", "pi05", "pi0_fast", "xvla")
"""Types whose model leaves out, or pads and masks, a camera that is not there."""


def cameras_of(features: Mapping[str, Any]) -> list[str]:
    """Returns the names of the cameras among features."""
    return [key.removeprefix(IMAGE_PREFIX) for key in features if key.startswith(IMAGE_PREFIX)]


def missing_cameras(
    type_name: str, wanted: Sequence[str], given: Sequence[str], cameras: Sequence[str], where: str
) -> list[str]:
    """Returns the cameras of a policy that are not there, and that it can do without.

    Args:
        type_name: LeRobot's policy type.
        wanted: Cameras of the policy.
        given: Cameras that are there, by the policy's names.
        cameras: The same by the names that they have there.
        where: What has them: a task's name or ``the dataset``.

    Raises:
        PolicyError: if the policy needs one of them, or has none at all.
    """
    missing = [name for name in wanted if name not in given and "empty_camera" not in name]
    found = [name for name in wanted if name in given]
    if not wanted or (found and (not missing or type_name in FEWER_CAMERAS)):
        return missing
    free = [name for name, target in zip(cameras, given, strict=True) if target not in wanted] or ["front"]
    pairs = ",".join(f"{name}:{target}" for name, target in zip(free, missing, strict=False))
    raise PolicyError(
        f"The policy sees the cameras {', '.join(wanted)}, and {where} has {', '.join(cameras) or 'none'}: "
        f"{', '.join(missing)} {'is' if len(missing) == 1 else 'are'} missing. Map them, as in "
        f"'rename_map={{{pairs}}}'."
    )


def check_rename_map(
    rename_map: Mapping[str, str],
    type_name: str,
    own: Sequence[str],
    cameras: Sequence[str],
    seen: Sequence[str],
    where: str,
) -> None:
    """Checks that a map names cameras that are there and cameras of the policy, each of these once.

    A policy that does with fewer cameras would otherwise act without the one whose name is wrong.

    Args:
        rename_map: Camera that is there to camera of the policy; names alone, or keys of observations.
        type_name: LeRobot's policy type.
        own: Cameras of the policy; none where it takes any name.
        cameras: Cameras that may be named.
        seen: Those that the policy is shown.
        where: What has them: a task's name or ``the dataset``.

    Raises:
        PolicyError: if two cameras become the same one.
        UnknownNameError: if a name is no camera.
    """
    hint = f"Write rename_map={{<camera of {where}>:<camera of the policy>}}."
    targets = {name: name for name in seen}
    for source, target in rename_map.items():
        name, seen_as = source.removeprefix(IMAGE_PREFIX), target.removeprefix(IMAGE_PREFIX)
        if name not in cameras:
            raise unknown_name(f"camera of {where}", name, set(cameras), hint)
        if own and seen_as not in own:
            raise unknown_name(f"camera of the policy '{type_name}'", seen_as, own, hint)
        targets[name] = seen_as
    names: dict[str, list[str]] = {}
    for name, seen_as in targets.items():
        names.setdefault(seen_as, []).append(name)
    for seen_as, several in names.items():
        if len(several) > 1:
            raise PolicyError(
                f"rename_map={dict(rename_map)} gives two cameras the same name: {' and '.join(several)} of "
                f"{where} are both {seen_as} of the policy. Give each its own, or name with cameras= those "
                "that the policy is to see."
            )


def check_state_size(size: int, trained: int | None, widest: int | None) -> None:
    """Checks that a state fits a trained policy, which is fine-tuned on it.

    Args:
        size: Numbers of the state.
        trained: Numbers that it was trained with; None if it saw no state.
        widest: Numbers that it pads to; None if it pads nothing.

    Raises:
        PolicyError: if it is wider than the policy pads to, or of another size where nothing is padded.
    """
    if widest is not None and size > widest:
        raise PolicyError(
            f"The state has {size} numbers, and the policy takes at most {widest} (policy.max_state_dim)."
        )
    if widest is None and trained is not None and trained != size:
        raise PolicyError(f"The state has {size} numbers, and the policy was trained with {trained}.")
