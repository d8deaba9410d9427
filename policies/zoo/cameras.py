"""Which cameras and states a policy of LeRobot takes, and the sentence where they are not there."""

from collections.abc import Sequence

from envs.core.errors import PolicyError

FEWER_CAMERAS = ("smolvla", "pi0", "pi05", "pi0_fast", "xvla")
"""Types whose model leaves out, or pads and masks, a camera that is not there."""


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
