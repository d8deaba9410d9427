"""Weights of a LeRobot model: read with every key checked, written without what is there twice."""

import importlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torch import Tensor

from envs.core.errors import PolicyError
from policies import checkpoint

_CHOSEN_TYPES = ("float32", "bfloat16")
"""Values of LeRobot's setting ``dtype`` by which a policy casts its network; eo1 has auto besides."""


def read_tensors(path: Path) -> dict[str, Tensor]:
    """Reads the tensors of a safetensors file, or of all files that an index names.

    Raises:
        PolicyError: if one is absent or damaged.
    """
    if path.suffix != ".json":
        return checkpoint.read_weights(path)
    names = sorted(set(checkpoint.read_json(path).get("weight_map", {}).values()))
    tensors: dict[str, Tensor] = {}
    for name in names:
        tensors |= checkpoint.read_weights(path.parent / str(name))
    return tensors


def load_tensors(model: Any, tensors: Mapping[str, Tensor], path: Path) -> None:
    """Copies the tensors of a checkpoint into a model, whose parameters take the checkpoint's types.

    Where the configuration names a type, as ``policy.dtype=bfloat16`` does, they keep that.

    LeRobot returns a π0 with random weights where the file is absent or does not fit; here this is an error.

    Args:
        model: LeRobot's policy.
        tensors: Tensors by name, also by the names of the programs that the policy was published with.
        path: Where they are from, for messages.

    Raises:
        PolicyError: if a tensor of the model is absent, or has another shape.
    """
    tensors = _renamed(model, tensors)
    own = model.state_dict()
    shared: dict[tuple[int, tuple[int, ...]], list[str]] = {}
    for key, value in own.items():
        shared.setdefault((value.data_ptr(), tuple(value.shape)), []).append(key)
    given = {
        each: tensors[key] for keys in shared.values() for key in keys if key in tensors for each in keys
    }
    wrong = [key for key in own if key not in given or given[key].shape != own[key].shape]
    wrong = [key for key in wrong if not key.endswith("num_batches_tracked")]
    if wrong:
        raise PolicyError(
            f"'{path}' does not hold the weights of this policy: {len(wrong)} of {len(own)} tensors are "
            "absent or "
            f"of another shape, the first '{wrong[0]}'. The policy would act at random. Name another "
            "checkpoint."
        )
    parameters = dict(model.named_parameters(remove_duplicate=False))
    is_chosen = getattr(getattr(model, "config", None), "dtype", "auto") in _CHOSEN_TYPES
    for key, value in given.items():
        if key in parameters and parameters[key].dtype != value.dtype and not is_chosen:
            parameters[key].data = parameters[key].data.to(value.dtype)
    model.load_state_dict(given, strict=False)


def _renamed(model: Any, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Returns tensors under the names of LeRobot's model."""
    renamed = dict(tensors)
    if hasattr(model, "_fix_pytorch_state_dict_keys"):  # π0's family, as Physical Intelligence published it
        renamed = model._fix_pytorch_state_dict_keys(renamed, model.config)
        renamed = {key if key.startswith("model.") else f"model.{key}": v for key, v in renamed.items()}
    module = importlib.import_module(type(model).__module__)
    if hasattr(module, "_is_vendored_florence_state_dict") and module._is_vendored_florence_state_dict(
        renamed
    ):
        renamed = module._remap_vendored_florence_state_dict(renamed)
    return renamed


def unique_tensors(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Returns tensors on the CPU, tied ones once, which is what safetensors takes."""
    seen: set[tuple[int, tuple[int, ...], tuple[int, ...]]] = set()
    unique = {}
    for key, value in tensors.items():
        place = value.data_ptr(), tuple(value.shape), tuple(value.stride())
        if value.numel() and place in seen:
            continue
        seen.add(place)
        unique[key] = value.detach().cpu().contiguous()
    return unique
