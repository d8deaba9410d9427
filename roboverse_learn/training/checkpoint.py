"""Checkpoints of a training run: complete or absent, JSON and safetensors only.

::

    <run>/checkpoints/005000/pretrained_model/   a LeRobot pretrained folder: the policy
                            /training_state/     what it takes to go on to the same loss
    <run>/checkpoints/last                       link to the newest
"""

import contextlib
import json
import os
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from envs.core.atomic import atomic_directory, partial_path, remove_partial_files, write_errors
from envs.core.errors import CheckpointError
from policies.checkpoint import load_weights
from policies.lerobot_policy import LeRobotPolicy
from roboverse_learn.training.imitation.ema import Ema

PRETRAINED = "pretrained_model"
STATE = "training_state"
_FORMAT = 1


@dataclass(frozen=True, kw_only=True, slots=True)
class TrainState:
    """Where a run is.

    Attributes:
        step: Gradient steps taken.
        elapsed_s: Seconds of training.
        sampler: Position in the order of the frames.
        settings: Whatever must be the same for the run to go on: another value is an error.
    """

    step: int
    elapsed_s: float
    sampler: Mapping[str, int]
    settings: Mapping[str, Any]


def save_checkpoint(
    run_dir: Path,
    policy: LeRobotPolicy,
    optimizer: torch.optim.Optimizer,
    ema: Ema | None,
    state: TrainState,
) -> Path:
    """Writes a checkpoint and points ``last`` at it.

    The pretrained folder holds the average of the weights if there is one, else the weights. Earlier
    checkpoints keep their policy and lose their training state, which is three times as large.

    Returns:
        The pretrained folder.

    Raises:
        WriteError: if the disk is full or the folder cannot be written; the checkpoints before are
            unchanged.
    """
    directory = run_dir / "checkpoints" / f"{state.step:06d}"
    with newest(directory) as (pretrained, inner):
        policy.save(pretrained, weights=None if ema is None else ema.average)
        moments, groups = _flatten(optimizer.state_dict())
        save_file(moments, inner / "optimizer.safetensors")
        if ema is not None:
            weights = {key: value.detach().cpu().contiguous() for key, value in policy.state_dict().items()}
            save_file(weights, inner / "weights.safetensors")
        content = {
            "format": _FORMAT,
            "step": state.step,
            "elapsed_s": state.elapsed_s,
            "sampler": dict(state.sampler),
            "ema_updates": None if ema is None else ema.num_updates,
            "settings": dict(state.settings),
            "param_groups": groups,
        }
        (inner / "state.json").write_text(json.dumps(content, indent=2), encoding="utf-8")
    return directory / PRETRAINED


@contextlib.contextmanager
def newest(directory: Path) -> Iterator[tuple[Path, Path]]:
    """Makes a checkpoint, whole or not at all, which ``last`` then leads to; earlier ones lose their state.

    Yields:
        Where the policy is to be saved, and an empty folder for what it takes to go on.

    Raises:
        WriteError: if the disk is full or the folder cannot be written.
    """
    with atomic_directory(directory) as staging:
        (staging / STATE).mkdir()
        yield staging / PRETRAINED, staging / STATE
    with write_errors(directory):
        point_last_at(directory)
    for old in directory.parent.glob(f"[0-9]*/{STATE}"):
        if old.parent.name != directory.name:
            shutil.rmtree(old, ignore_errors=True)


def remove_leftovers(run_dir: Path) -> None:
    """Deletes what a killed run was writing; only the one process that has the run open may."""
    remove_partial_files(run_dir / "checkpoints")


def last_checkpoint(run_dir: Path) -> Path | None:
    """Returns the newest checkpoint of a run that training can go on from, or None."""
    last = run_dir / "checkpoints" / "last"
    if (last / STATE).is_dir():
        return last.resolve()
    # Killed between a checkpoint and its link: the newest folder counts.
    found = sorted((run_dir / "checkpoints").glob(f"[0-9]*/{STATE}"))
    return found[-1].parent if found else None


def what_is_kept(run_dir: Path) -> str:
    """Returns what a run that has to stop leaves to go on from, in a sentence for people."""
    if last_checkpoint(run_dir) is None:
        return "No checkpoint had been saved; a smaller train.save_every saves the first sooner."
    return f"The last checkpoint in '{run_dir / 'checkpoints'}' is sound."


def load_checkpoint(
    directory: Path,
    policy: LeRobotPolicy,
    optimizer: torch.optim.Optimizer,
    ema: Ema | None,
    settings: Mapping[str, Any],
) -> TrainState:
    """Brings policy, optimizer and average to where a checkpoint left them.

    Args:
        directory: The checkpoint.
        policy: The policy in training, made with the same configuration.
        optimizer: Its optimizer.
        ema: Its average, if it has one.
        settings: Settings of this run, which must be those of the checkpoint.

    Returns:
        Where the run is.

    Raises:
        CheckpointError: if a file is damaged or the checkpoint is of another configuration.
        PolicyError: if the weights do not fit the policy.
    """
    inner = directory / STATE
    content = _read_state(inner / "state.json")
    saved = content["settings"] | {"ema": content["ema_updates"] is not None}
    check_same(directory, saved, dict(settings) | {"ema": ema is not None})
    saved_policy = directory / PRETRAINED / "model.safetensors"
    raw = saved_policy if ema is None else inner / "weights.safetensors"
    load_weights(policy.model, _read(raw), raw)
    _restore(optimizer, _read(inner / "optimizer.safetensors"), content["param_groups"], inner)
    if ema is not None:
        average = _read(saved_policy)
        for key, value in ema.average.items():
            value.copy_(average[key])
        ema.num_updates = content["ema_updates"]
    names = ("step", "elapsed_s", "sampler", "settings")
    return TrainState(**{name: content[name] for name in names})


def _flatten(state: Mapping[str, Any]) -> tuple[dict[str, Tensor], list[dict[str, Any]]]:
    """Splits an optimizer's state into named tensors and JSON."""
    tensors = {
        f"{index}.{name}": torch.as_tensor(value).detach().cpu().contiguous()
        for index, moments in state["state"].items()
        for name, value in moments.items()
    }
    return tensors, state["param_groups"]


def _restore(
    optimizer: torch.optim.Optimizer, tensors: Mapping[str, Tensor], groups: list[dict[str, Any]], path: Path
) -> None:
    """Puts an optimizer back; moments take the memory layout of their parameters, as fused kernels need."""
    parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
    if sum(len(group["params"]) for group in groups) != len(parameters):
        raise CheckpointError(f"'{path}' is of a model with another number of parameters. {ADVICE}")
    state: dict[int, dict[str, Tensor]] = {}
    for key, value in tensors.items():
        index, _, name = key.partition(".")
        parameter = parameters[int(index)]
        like = torch.empty_like(parameter).copy_(value) if value.shape == parameter.shape else value
        state.setdefault(int(index), {})[name] = like
    optimizer.load_state_dict({"state": state, "param_groups": groups})


ADVICE = (
    "Go on with the configuration that the run was begun with, "
    "or begin a new run (another folder, or resume=false)."
)


def check_same(directory: Path, saved: Mapping[str, Any], given: Mapping[str, Any]) -> None:
    """Refuses to go on with other settings than those that a checkpoint was begun with.

    Raises:
        CheckpointError: which names all that changed.
    """
    given = json.loads(json.dumps(dict(given)))
    changed = [
        f"{key} was {saved.get(key)} and is {given.get(key)}"
        for key in sorted(saved.keys() | given.keys())
        if saved.get(key) != given.get(key)
    ]
    if changed:
        raise CheckpointError(f"Cannot resume from '{directory}': {'; '.join(changed)}. {ADVICE}")


def _read_state(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        version = content["format"]
        absent = {"step", "elapsed_s", "sampler", "ema_updates", "settings", "param_groups"} - content.keys()
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise CheckpointError(f"'{path}' cannot be read ({error}). {ADVICE}") from error
    if version != _FORMAT:
        raise CheckpointError(f"'{path}' has format {version}, valid is {_FORMAT}. {ADVICE}")
    if absent:
        raise CheckpointError(f"'{path}' lacks {', '.join(sorted(absent))}. {ADVICE}")
    return content


def _read(path: Path) -> dict[str, Tensor]:
    try:
        return load_file(path)
    except (OSError, SafetensorError) as error:
        raise CheckpointError(f"'{path}' is absent, truncated or damaged ({error}). {ADVICE}") from error


def point_last_at(directory: Path) -> None:
    """Points the link ``last`` beside a checkpoint at it."""
    last = directory.parent / "last"
    link = partial_path(last)
    link.symlink_to(directory.name)
    os.replace(link, last)
