"""Checkpoints of agents that learn from an env: complete or absent, JSON and safetensors only.

::

    <run>/checkpoints/000500000/pretrained_model/   the policy
                               /training_state/     what it takes to go on
    <run>/checkpoints/last                          link to the newest
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import load_file, save_file
from torch import Tensor

from envs.core.errors import CheckpointError
from roboverse_learn.training.checkpoint import ADVICE, PRETRAINED, STATE, check_same, newest

_TENSORS, _STATE_FILE, _FORMAT = "state.safetensors", "state.json", 1


@dataclass(frozen=True, kw_only=True, slots=True)
class AgentState:
    """Where a run is.

    Attributes:
        step: Environment steps taken.
        elapsed_s: Seconds of training.
        settings: Whatever must be the same for the run to go on: another value is an error.
        numbers: State of the learner and of its env that is plain JSON.
        tensors: State of the learner and of its env in tensors.
    """

    step: int
    elapsed_s: float
    settings: Mapping[str, Any]
    numbers: Mapping[str, Any]
    tensors: Mapping[str, Tensor]


def save_agent(run_dir: Path, policy: Any, state: AgentState) -> Path:
    """Writes a checkpoint and points ``last`` at it; earlier ones keep their policy alone.

    Returns:
        The pretrained folder.

    Raises:
        WriteError: if the disk is full or the folder cannot be written; the checkpoints before are
            unchanged.
    """
    directory = run_dir / "checkpoints" / f"{state.step:09d}"
    with newest(directory) as (pretrained, inner):
        policy.save(pretrained)
        tensors = {key: value.detach().cpu().contiguous() for key, value in state.tensors.items()}
        save_file(tensors, inner / _TENSORS)
        content = {
            "format": _FORMAT,
            "step": state.step,
            "elapsed_s": state.elapsed_s,
            "settings": dict(state.settings),
            "numbers": dict(state.numbers),
        }
        (inner / _STATE_FILE).write_text(json.dumps(content, indent=2), encoding="utf-8")
    return directory / PRETRAINED


def load_agent(directory: Path, settings: Mapping[str, Any]) -> AgentState:
    """Reads the training state of a checkpoint.

    Args:
        directory: The checkpoint.
        settings: Settings of this run, which must be those of the checkpoint.

    Raises:
        CheckpointError: if a file is damaged or the checkpoint is of another configuration.
    """
    from safetensors import SafetensorError

    path = directory / STATE / _STATE_FILE
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["format"] != _FORMAT:
            raise ValueError(f"format {content['format']}, valid is {_FORMAT}")
        tensors = load_file(directory / STATE / _TENSORS)
        saved, state = content["settings"], {key: content[key] for key in ("step", "elapsed_s", "numbers")}
    except (OSError, ValueError, KeyError, TypeError, SafetensorError) as error:
        raise CheckpointError(f"'{path.parent}' cannot be read ({error}). {ADVICE}") from error
    check_same(directory, saved, settings)
    return AgentState(settings=saved, tensors=tensors, **state)


def moments(optimizer: torch.optim.Optimizer, prefix: str) -> dict[str, Tensor]:
    """Returns the moments of an optimizer as named tensors."""
    return {
        f"{prefix}.{index}.{name}": value
        for index, state in optimizer.state_dict()["state"].items()
        for name, value in state.items()
    }


def load_moments(optimizer: torch.optim.Optimizer, tensors: Mapping[str, Tensor], prefix: str) -> None:
    """Puts back what :func:`moments` returned; learning rates stay as they are."""
    state: dict[int, dict[str, Tensor]] = {}
    for key, value in tensors.items():
        if key.startswith(f"{prefix}."):
            index, name = key.removeprefix(f"{prefix}.").split(".")
            state.setdefault(int(index), {})[name] = value.clone()
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
    """Returns tensors under names with a prefix; :func:`part` takes them out again."""
    return {f"{prefix}.{key}": value for key, value in tensors.items()}
