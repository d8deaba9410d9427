"""Checkpoints of a training run: complete or absent, JSON and safetensors only.

::

    <run>/checkpoints/005000/pretrained_model/   the policy, in its own format
                            /training_state/     state.json and state.safetensors, to resume from
    <run>/checkpoints/last                       link to the newest
"""

import contextlib
import filecmp
import itertools
import json
import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from envs.core.atomic import atomic_directory, partial_path, remove_partial_files, write_errors
from envs.core.errors import CheckpointError
from policies.checkpoint import of_steps

PRETRAINED = "pretrained_model"
STATE = "training_state"
_TENSORS, _JSON, _FORMAT = "state.safetensors", "state.json", 2
_ADVICE = (
    "Resume with the configuration that the run was started with, "
    "or begin a new run (another folder, or resume=false)."
)


@dataclass(frozen=True, kw_only=True, slots=True)
class TrainState:
    """All that a run needs to resume, besides its policy.

    Attributes:
        step: Gradient steps taken; environment steps of an agent.
        elapsed_s: Seconds of training.
        settings: What must be the same to resume; another value is an error.
        numbers: Further state, plain JSON.
        tensors: Further state in tensors.
    """

    step: int
    elapsed_s: float
    settings: Mapping[str, Any]
    numbers: Mapping[str, Any]
    tensors: Mapping[str, Tensor]


def save_checkpoint(
    run_dir: Path, policy: Any, state: TrainState, weights: Mapping[str, Tensor] | None = None
) -> Path:
    """Writes a checkpoint and points ``last`` at it; earlier ones keep their policy and lose their state.

    Args:
        run_dir: Folder of the run.
        policy: The policy.
        state: What resuming needs.
        weights: Saved as the policy's weights in place of its own, such as their average.

    Returns:
        The pretrained folder.

    Raises:
        WriteError: if the disk is full or the folder cannot be written; the checkpoints before are
            unchanged.
    """
    directory = run_dir / "checkpoints" / f"{state.step:06d}"
    with atomic_directory(directory) as staging:
        policy.save(staging / PRETRAINED, **({} if weights is None else {"weights": weights}))
        inner = staging / STATE
        inner.mkdir()
        tensors = {key: value.detach().cpu().contiguous() for key, value in state.tensors.items()}
        save_file(tensors, inner / _TENSORS)
        names = ("step", "elapsed_s", "settings", "numbers")
        content = {name: getattr(state, name) for name in names}
        (inner / _JSON).write_text(json.dumps({"format": _FORMAT, **content}, indent=2), encoding="utf-8")
    _point_last_at(directory)
    for other in of_steps(directory.parent):
        if other != directory:
            shutil.rmtree(other / STATE, ignore_errors=True)
    return directory / PRETRAINED


def _point_last_at(directory: Path) -> None:
    """Makes ``last`` a link to a checkpoint, also where it is a folder, as in a copy without links.

    Such a folder is deleted where a checkpoint has all that it has, and else kept beside the link.
    """
    last = directory.parent / "last"
    with write_errors(last):
        link, double = partial_path(last), partial_path(last)
        link.symlink_to(directory.name)
        if _is_copied(last):
            is_double = any(_has_all_of(last, each) for each in of_steps(last.parent))
            os.rename(last, double if is_double else _free_name(last))
        os.replace(link, last)
        shutil.rmtree(double, ignore_errors=True)


def _is_copied(last: Path) -> bool:
    """Whether ``last`` is a folder of its own, as in a copy without links."""
    return last.is_dir() and not last.is_symlink()


def _has_all_of(copy: Path, checkpoint: Path) -> bool:
    """Whether a checkpoint has every file of a folder, with the same bytes."""
    pairs = ((path, checkpoint / path.relative_to(copy)) for path in copy.rglob("*") if path.is_file())
    return all(other.is_file() and filecmp.cmp(path, other, shallow=False) for path, other in pairs)


def _free_name(last: Path) -> Path:
    names = (last.with_name(f"last.copied{count or ''}") for count in itertools.count())
    return next(path for path in names if not path.exists())


def load_checkpoint(directory: Path, settings: Mapping[str, Any]) -> TrainState:
    """Reads the training state of a checkpoint.

    Args:
        directory: The checkpoint.
        settings: Settings of this run, which must be those of the checkpoint.

    Raises:
        CheckpointError: if a file is damaged or the checkpoint is of another configuration.
    """
    inner = directory / STATE
    try:
        content = json.loads((inner / _JSON).read_text(encoding="utf-8"))
        if content.pop("format") != _FORMAT:
            raise ValueError(f"another format than {_FORMAT}")
        state = TrainState(tensors=load_file(inner / _TENSORS), **content)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, SafetensorError) as error:
        raise CheckpointError(f"'{inner}' cannot be read ({error}). {_ADVICE}") from error
    saved, given = state.settings, json.loads(json.dumps(dict(settings)))
    changed = [
        f"{key} was {saved.get(key)} and is {given.get(key)}"
        for key in sorted(saved.keys() | given.keys())
        if saved.get(key) != given.get(key)
    ]
    if changed:
        raise CheckpointError(f"Cannot resume from '{directory}': {'; '.join(changed)}. {_ADVICE}")
    return state


def remove_leftovers(run_dir: Path) -> None:
    """Puts right what a killed run was writing; only the one process that has the run open may."""
    remove_partial_files(run_dir / "checkpoints")
    _number_copied(run_dir / "checkpoints" / "last")
    if newest := _newest(run_dir):
        _point_last_at(newest)


def _number_copied(last: Path) -> None:
    """Names a folder ``last`` by its step, where a copy has it alone, so that training resumes from it."""
    with contextlib.suppress(OSError, ValueError, KeyError, TypeError):  # else reading it says what is wrong
        step = json.loads((last / STATE / _JSON).read_text(encoding="utf-8"))["step"]
        place = last.with_name(f"{step:06d}")
        if _is_copied(last) and not place.exists():
            os.rename(last, place)


def last_checkpoint(run_dir: Path) -> Path | None:
    """Returns the newest checkpoint of a run that training can resume from, or None."""
    if newest := _newest(run_dir):  # also where the run was killed between a checkpoint and its link
        return newest
    last = run_dir / "checkpoints" / "last"
    return last.resolve() if (last / STATE).is_dir() else None


def _newest(run_dir: Path) -> Path | None:
    """Returns the folder with the largest step that training can resume from, or None."""
    return next(
        (path for path in reversed(of_steps(run_dir / "checkpoints")) if (path / STATE).is_dir()), None
    )


def not_finite(tensors: Mapping[str, Tensor]) -> str:
    """Returns the name of the first tensor with a number that is infinite or NaN; empty if there is none."""
    return next((key for key, value in tensors.items() if not bool(value.isfinite().all())), "")


def what_is_kept(run_dir: Path) -> str:
    """Returns what a run that has to stop leaves to resume from, in a sentence for people."""
    if last_checkpoint(run_dir) is None:
        return "No checkpoint had been saved; a smaller train.save_every saves the first sooner."
    return f"The last checkpoint in '{run_dir / 'checkpoints'}' is sound."


def moments(optimizer: torch.optim.Optimizer, prefix: str) -> dict[str, Tensor]:
    """Returns the moments of an optimizer as named tensors."""
    return {
        f"{prefix}.{index}.{name}": torch.as_tensor(value)
        for index, state in optimizer.state_dict()["state"].items()
        for name, value in state.items()
    }


def load_moments(optimizer: torch.optim.Optimizer, tensors: Mapping[str, Tensor], prefix: str) -> None:
    """Restores what :func:`moments` returned; learning rates stay as they are."""
    parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
    state: dict[int, dict[str, Tensor]] = {}
    for key, value in part(tensors, prefix).items():
        index, _, name = key.partition(".")
        moment = value.clone()
        if moment.dim() == 4:  # fused kernels need the memory layout of the parameter
            moment = torch.empty_like(parameters[int(index)]).copy_(value)
        state.setdefault(int(index), {})[name] = moment
    groups = optimizer.state_dict()["param_groups"]
    optimizer.load_state_dict({"state": state, "param_groups": groups})


def part(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """Returns the tensors whose names begin with a prefix, without it."""
    return {
        key.removeprefix(f"{prefix}."): value
        for key, value in tensors.items()
        if key.startswith(f"{prefix}.")
    }


def named(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """Returns tensors under names with a prefix; the inverse of :func:`part`."""
    return {f"{prefix}.{key}": value for key, value in tensors.items()}
