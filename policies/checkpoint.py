"""Reading a LeRobot pretrained folder: only JSON and safetensors, checked before anything is built."""

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from envs.core.errors import PolicyError
from envs.core.fingerprint import file_hash
from envs.core.observation_keys import IMAGE_PREFIX

if TYPE_CHECKING:
    import torch

CONFIG = "config.json"
WEIGHTS = "model.safetensors"
ADAPTERS = "adapter_model.safetensors"
"""Weights of adapters, in place of those of a whole network."""

HASHES = "sha256.json"
PREPROCESSOR = "policy_preprocessor.json"
POSTPROCESSOR = "policy_postprocessor.json"

LEROBOT = "lerobot"
"""The policy that is any type of LeRobot's registry."""

OF_THEIR_OWN = ("act", "diffusion")
"""LeRobot's types that are a policy of their own here."""

REGISTERED_AS = {"keypoint_act": "act", "keypoint_diffusion": "diffusion", "multitask_act": "mtact"}
"""LeRobot's policy types that are a network of a policy with another name."""

_ADVICE = (
    "A checkpoint is the folder of a run, or one with config.json, model.safetensors, "
    "policy_preprocessor.json and policy_postprocessor.json, such as "
    "<run>/checkpoints/last/pretrained_model. Name another checkpoint, or train again."
)
_MOST_NAMED = 5
"""Runs that are named where a folder of them was given, and learned tasks: a suite has a hundred."""

_MOST_PARTS = 5
"""Folders from that of all runs to a run: the parts of a task's name (at most three), the policy, the run."""


def resolve(directory: str | Path) -> Path:
    """Returns the pretrained folder that ``directory`` is or holds.

    Args:
        directory: A pretrained folder, a checkpoint of a run, or a run or its folder of checkpoints, of which
            the last counts: the newest where the link to it is gone, as in a copy without links.

    Raises:
        PolicyError: if there is no such folder, or no checkpoint in it.
    """
    directory = Path(directory)
    if not directory.is_dir():
        what = "is a file" if directory.exists() else "does not exist"
        raise PolicyError(f"Checkpoint '{directory}' {what}. {_ADVICE}")
    checkpoints = [directory]
    for folder in (directory / "checkpoints", directory):
        checkpoints += [folder / "last", *reversed(of_steps(folder))]
    for found in (directory, *(checkpoint / "pretrained_model" for checkpoint in checkpoints)):
        if (found / CONFIG).is_file():
            return found
    raise PolicyError(f"Checkpoint '{directory}' {_what_it_is(directory)}")


def _what_it_is(directory: Path) -> str:
    """Says what a folder without a checkpoint is, and what to do."""
    if (directory / "meta" / "info.json").is_file():
        return (
            "is a dataset, and no checkpoint. Train a policy on it: roboverse train policy=act "
            f"dataset={directory}"
        )
    if (directory / "config.yaml").is_file():
        if steps := of_steps(directory / "checkpoints"):
            return f"is a run whose checkpoint '{steps[-1]}' has no pretrained_model/{CONFIG}. {_ADVICE}"
        return f"is a run without a checkpoint yet. Go on with it first: roboverse train run={directory}"
    if runs := _runs_in(directory):
        more = f", and {len(runs) - _MOST_NAMED} more" if len(runs) > _MOST_NAMED else ""
        return f"holds runs. Name one of them: {', '.join(map(str, runs[:_MOST_NAMED]))}{more}."
    return f"has no {CONFIG}. {_ADVICE}"


def _runs_in(directory: Path) -> list[Path]:
    """Returns the runs in a folder that have a checkpoint, as deep as names of tasks have parts."""
    runs = []
    for name, folders, _files in os.walk(directory):
        folder = Path(name)
        steps = of_steps(folder / "checkpoints")
        if any((step / "pretrained_model" / CONFIG).is_file() for step in steps):
            runs.append(folder)
        is_deep = len(folder.relative_to(directory).parts) >= _MOST_PARTS
        if is_deep or steps or "meta" in folders:  # nothing is looked for inside runs and datasets
            folders.clear()
    return sorted(runs)


def of_steps(checkpoints: Path) -> list[Path]:
    """Returns the checkpoints in a folder, oldest first: their folders are named by their steps alone."""
    found = [path for path in checkpoints.glob("[0-9]*") if path.name.isdecimal()]
    return sorted(found, key=lambda path: int(path.name))


def weights_path(directory: Path) -> Path:
    """Returns the file of a pretrained folder whose content is the policy's own.

    Args:
        directory: A pretrained folder.

    Returns:
        The weights, or the adapters where only these were trained; ``model.safetensors`` if there is neither.
    """
    for name in (WEIGHTS, ADAPTERS, f"{WEIGHTS}.index.json"):
        if (directory / name).is_file():
            return directory / name
    return directory / WEIGHTS


def read_json(path: Path) -> dict[str, Any]:
    """Reads a JSON object of a checkpoint.

    Raises:
        PolicyError: if the file is absent or holds something else.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise PolicyError(f"Checkpoint '{path.parent}' has no {path.name}. {_ADVICE}") from None
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise PolicyError(f"'{path}' is not valid JSON ({error}). {_ADVICE}") from None
    if not isinstance(content, dict):
        raise PolicyError(f"'{path}' must hold a JSON object, not a {type(content).__name__}. {_ADVICE}")
    return content


def learned_tasks(path: str | Path) -> tuple[str, ...]:
    """Returns the tasks that the agent of a checkpoint learned; none if it does not say.

    Args:
        path: Folder of a checkpoint, or of its run.
    """
    try:
        content = read_json(resolve(path) / CONFIG)
    except PolicyError:  # there is none, or it is damaged; loading it raises
        return ()
    several, task = content.get("tasks"), content.get("task")
    if isinstance(several, dict) and several:
        return tuple(several)
    return (str(task),) if task else ()


def check_learned(
    directory: Path, task: str, learned: Sequence[str] | None = None, *, other_tasks: bool = False
) -> None:
    """Refuses a task that a policy did not learn, whose observations mean something else to it.

    Args:
        directory: A pretrained folder.
        task: What it is to act in.
        learned: The tasks that it is known to have learned, of which nothing is known where there is none; by
            default those that the folder lists.
        other_tasks: Whether a policy of demonstrations may act in a task that it did not learn.

    Raises:
        PolicyError: if tasks are known, and this is none of them.
    """
    learned = learned_tasks(directory) if learned is None else learned
    if not learned or task in learned:
        return
    reads = "input_features" in read_json(resolve(directory) / CONFIG)  # LeRobot's; agents take no words
    if not (reads and other_tasks):
        advice = ", or evaluate it there nevertheless with other_tasks=true" if reads else ""
        shown, more = learned[:_MOST_NAMED], len(learned) - _MOST_NAMED
        named = f"{', '.join(shown)} and {more} more" if more > 0 else " and ".join(shown)
        raise PolicyError(
            f"Checkpoint '{directory}' of policy '{policy_type(directory)}' learned the "
            f"task{'s' * (len(learned) > 1)} {named}, not {task}. Give task={' or task='.join(shown)}, or "
            f"train it on {task}{advice}."
        )


def seen_cameras(directory: Path, rename_map: Mapping[str, str] | None = None) -> dict[str, int]:
    """Returns the cameras whose images a policy sees, in order, and the pixels a side of each.

    Args:
        directory: A pretrained folder.
        rename_map: Camera of the environment to camera of the policy, beside the map that is saved.

    Returns:
        Nothing for a policy that sees no images. Cameras have the names of the environment; one that only
        fills the place of none is left out.

    Raises:
        PolicyError: if the folder does not say what its policy sees.
    """
    path = directory / CONFIG
    values = read_json(path)
    try:
        if "input_features" in values:  # LeRobot's
            shapes = {key: feature["shape"] for key, feature in values["input_features"].items()}
        else:  # of a reinforcement learning policy
            shapes = {key: [size] for key, size in values["observation"].items()}
        sources, seen = _sources(directory, rename_map or {}), {}
        for key, shape in shapes.items():
            name = key.removeprefix(IMAGE_PREFIX)
            if name != key and not name.startswith("empty_camera"):
                seen[sources.get(name, name)] = min(map(int, shape[-2:]))
        return seen
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        raise PolicyError(f"'{path}' does not say which images its policy takes: {error!r}.") from error


def _sources(directory: Path, rename_map: Mapping[str, str]) -> dict[str, str]:
    """Returns the camera of the environment of each renamed camera of a policy."""
    path = directory / PREPROCESSOR
    saved: dict[str, str] = {}
    for step in read_json(path).get("steps", []) if path.is_file() else []:
        if step.get("registry_name") == "rename_observations_processor":
            saved = dict(step.get("config", {}).get("rename_map") or {})
    return {
        str(target).removeprefix(IMAGE_PREFIX): str(source).removeprefix(IMAGE_PREFIX)
        for source, target in {**saved, **rename_map}.items()
    }


def policy_type(directory: Path) -> str:
    """Returns the registered name of the policy in a pretrained folder.

    A type of LeRobot's that has no policy of its own here is of ``lerobot``.
    """
    name = policy_label(directory)
    if name in OF_THEIR_OWN:
        return name
    from policies.zoo.types import type_names

    return LEROBOT if name in type_names() else name


def policy_label(directory: Path) -> str:
    """Returns the name of the policy in a pretrained folder as results have it: LeRobot's type."""
    content = read_json(directory / CONFIG)
    name = content.get("type", content.get("model_type"))
    if not isinstance(name, str):
        raise PolicyError(f"'{directory / CONFIG}' does not say which policy it is (key 'type'). {_ADVICE}")
    return REGISTERED_AS.get(name, name)


def write_hashes(directory: Path) -> None:
    """Writes the SHA-256 of each safetensors file of a pretrained folder into the file ``sha256.json``."""
    hashes = {path.name: file_hash(path) for path in sorted(directory.glob("*.safetensors"))}
    (directory / HASHES).write_text(json.dumps(hashes, indent=2), encoding="utf-8")


def _check_hash(path: Path) -> None:
    """Refuses a file that changed after it was saved; a folder of another program may have no hashes."""
    hashes = path.with_name(HASHES)
    if not hashes.is_file():
        return
    saved = read_json(hashes).get(path.name)
    if saved is not None and saved != (found := file_hash(path)):
        raise PolicyError(
            f"'{path}' is damaged, or was changed after it was saved: its SHA-256 is {found[:16]}…, and "
            f"{HASHES} says {str(saved)[:16]}…. Name another checkpoint, or train again. If you changed it "
            f"yourself, delete {HASHES}."
        )


def read_weights(path: Path) -> dict[str, Any]:
    """Reads the tensors of a safetensors file to the CPU.

    Raises:
        PolicyError: if the file is absent, truncated, of another format, or not the file that was saved.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    if not path.is_file():
        raise PolicyError(f"Checkpoint '{path.parent}' has no {path.name}. {_ADVICE}")
    try:
        tensors = load_file(path)
    except (SafetensorError, ValueError) as error:
        size = path.stat().st_size
        raise PolicyError(
            f"'{path}' ({size} bytes) is truncated or not a safetensors file ({error}). {_ADVICE}"
        ) from None
    _check_hash(path)
    return tensors


def check_tensors(own: "Mapping[str, torch.Tensor]", given: "Mapping[str, torch.Tensor]", path: Path) -> None:
    """Checks that tensors are exactly those of a model.

    Args:
        own: The model's.
        given: Those of a file.
        path: The file, for the message.

    Raises:
        PolicyError: if names or shapes differ.
    """
    wrong = sorted(
        key for key in own.keys() | given.keys()
        if key not in own or key not in given or own[key].shape != given[key].shape
    )  # fmt: skip
    if wrong:
        raise PolicyError(
            f"'{path}' does not fit the configuration beside it: {len(wrong)} of {len(own)} tensors are "
            f"absent, unknown or of another shape, the first '{wrong[0]}'. Name another checkpoint, "
            "or train again."
        )


def load_weights(model: "torch.nn.Module", weights: "Mapping[str, torch.Tensor]", path: Path) -> None:
    """Copies tensors into a model that must have exactly these.

    Raises:
        PolicyError: if names or shapes differ.
    """
    # Counters of batch normalization have no part in an evaluation: LeRobot saves them, our policies do not.
    own, weights = (
        {key: value for key, value in tensors.items() if not key.endswith("num_batches_tracked")}
        for tensors in (model.state_dict(), weights)
    )
    check_tensors(own, weights, path)
    model.load_state_dict(weights, strict=False)


def check_pipeline(path: Path, allowed: Iterable[str]) -> None:
    """Checks that a pipeline file has allowed steps only, and that their tensors can be read.

    Args:
        path: The file, which may name any importable class.
        allowed: Registered names of the steps that may be loaded.

    Raises:
        PolicyError: if not.
    """
    steps = read_json(path).get("steps")
    if not isinstance(steps, list) or not all(isinstance(step, dict) for step in steps):
        raise PolicyError(f"'{path}' must hold a list 'steps'. {_ADVICE}")
    for step in steps:
        name = step.get("registry_name", step.get("class"))
        if name not in allowed or "class" in step:
            raise PolicyError(
                f"'{path}' has the step '{name}', which is not loaded. "
                f"Valid: {', '.join(sorted(allowed))}. {_ADVICE}"
            )
        if "state_file" in step:
            read_weights(path.parent / str(step["state_file"]))
