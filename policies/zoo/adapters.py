"""Adapters of the package peft, such as LoRA, in LeRobot's form of a checkpoint."""

import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from torch import Tensor, nn

from envs.core.errors import MissingExtraError, PolicyError
from envs.core.extras import install_command
from policies import checkpoint
from policies.zoo.config import PeftConfig
from policies.zoo.source import is_hub_name

CONFIG = "adapter_config.json"
_BASE, _BASIS = "base_model_name_or_path", "base.json"


def wrap(model: Any, config: PeftConfig, base: str) -> Any:
    """Adds adapters to a trained model, which is frozen but for what ``config`` trains in full.

    Args:
        model: LeRobot's policy, with its weights.
        config: ``peft.*``.
        base: Folder or hub name of the model.

    Raises:
        PolicyError: if peft refuses the configuration.
    """
    try:
        from peft import PeftType
    except ImportError as error:
        raise MissingExtraError(f"peft.* needs the package peft: {install_command('vla')}.") from error
    if config.method_type.upper() not in (names := [each.name for each in PeftType]):
        raise PolicyError(
            f"peft.method_type={config.method_type} is no method of peft. Valid: {', '.join(names)}."
        )
    name, _, revision = base.partition("@") if is_hub_name(base) else (base, "", "")
    model.config.pretrained_path = Path(name)
    overrides = {key: value for key, value in asdict(config).items() if value is not None}
    if not isinstance(config.target_modules, str) and config.target_modules is not None:
        overrides["target_modules"] = list(config.target_modules)
    try:
        wrapped = model.wrap_with_peft(peft_cli_overrides=overrides)
    except (ValueError, TypeError, KeyError) as error:
        raise PolicyError(
            f"peft.* does not fit LeRobot's {model.name}: {error} Name the layers with "
            "peft.target_modules, as in "
            "'peft.target_modules=[q_proj,v_proj]' or peft.target_modules=all-linear."
        ) from error
    wrapped.peft_config[wrapped.active_adapter].revision = revision or None
    return wrapped


def wrap_own(
    model: Any,
    config: PeftConfig,
    base: str,
    *,
    what: str,
    without: Collection[str],
    in_full: Sequence[str] = (),
) -> Any:
    """Adds LoRA to a network of ours, which is frozen but for what is trained in full.

    By default every linear layer gets an adapter, as peft's ``all-linear`` has it for its own models.

    Args:
        model: The network, with its weights.
        config: ``peft.*``.
        base: Folder or hub name of the network.
        what: Its name, for messages.
        without: Names of modules whose layers get none by default.
        in_full: Modules that are trained in full beside those that ``config`` names.

    Raises:
        PolicyError: if the method is another one, or peft refuses the configuration.
    """
    from peft import LoraConfig, get_peft_model

    if config.method_type.upper() != "LORA":
        raise PolicyError(f"{what} is adapted by peft.method_type=LORA, given {config.method_type}.")
    targets = config.target_modules or "all-linear"
    if targets == "all-linear":
        linear = [name for name, each in model.named_modules() if isinstance(each, nn.Linear)]
        targets = [name for name in linear if not {*name.split(".")} & {*without}]
    name, _, revision = base.partition("@") if is_hub_name(base) else (base, "", "")
    model.name_or_path = name  # where peft looks for it
    lora = LoraConfig(
        r=config.r,
        lora_alpha=config.lora_alpha or min(config.r, 16),
        target_modules=targets,
        modules_to_save=[*in_full, *(config.full_training_modules or [])] or None,
        init_lora_weights=config.init_type or "gaussian",
        revision=revision or None,
    )
    try:
        return get_peft_model(model, lora)
    except ValueError as error:
        raise PolicyError(f"peft.* does not fit {what}: {error}") from error


def base_network(model: Any) -> Any:
    """Returns LeRobot's policy inside a model with adapters, or the model itself."""
    return model.get_base_model() if hasattr(model, "peft_config") else model


def state(model: Any) -> dict[str, Tensor]:
    """Returns the tensors of the adapters, and of what is trained beside them, by peft's names."""
    from peft import get_peft_model_state_dict

    return get_peft_model_state_dict(model, save_embedding_layers=False)


def load_state(model: Any, tensors: Mapping[str, Tensor], path: Path) -> None:
    """Copies tensors into the adapters.

    Raises:
        PolicyError: if one is absent, unknown, or of another shape.
    """
    from peft import set_peft_model_state_dict

    checkpoint.check_tensors(state(model), tensors, path)
    set_peft_model_state_dict(model, dict(tensors))


def save(model: Any, directory: Path, tensors: Mapping[str, Tensor], final: Path) -> None:
    """Writes the adapters into a checkpoint, as peft and LeRobot do, and how to find their base from it.

    Args:
        model: The model with adapters.
        directory: The checkpoint, under way.
        tensors: Of the adapters.
        final: The folder that it becomes.
    """
    import json

    from safetensors.torch import save_file

    config = model.peft_config[model.active_adapter]
    base = str(getattr(config, _BASE))
    config.inference_mode, before = True, config.inference_mode
    config.save_pretrained(str(directory))
    config.inference_mode = before
    save_file(
        {key: value.detach().cpu().contiguous().clone() for key, value in tensors.items()},
        directory / checkpoint.ADAPTERS,
        metadata={"format": "pt"},
    )
    if not is_hub_name(base):
        relative = os.path.relpath(Path(base).resolve(), final.resolve())
        (directory / _BASIS).write_text(json.dumps({"relative": relative}, indent=2), encoding="utf-8")


def find_base(directory: Path) -> str:
    """Returns the folder or hub name of the model that a checkpoint's adapters belong to.

    A base that was moved together with the checkpoint is found too.

    Raises:
        PolicyError: if it is neither where it was nor at the same place beside the checkpoint.
    """
    content = checkpoint.read_json(directory / CONFIG)
    base = str(content.get(_BASE) or "")
    if not base:
        raise PolicyError(f"'{directory / CONFIG}' does not name the model of its adapters ({_BASE}).")
    places = [base]
    if (directory / _BASIS).is_file():
        places.append(str((directory / str(checkpoint.read_json(directory / _BASIS)["relative"])).resolve()))
    for place in places:
        if (Path(place) / checkpoint.CONFIG).is_file():
            return place
    if is_hub_name(base):
        return f"{base}@{content['revision']}" if content.get("revision") else base
    raise PolicyError(
        f"The adapters in '{directory}' belong to the model '{base}', which is not there any more. Put it "
        "back, or "
        f"write its present folder into {_BASE} of '{directory / CONFIG}'."
    )


def wrap_from(model: Any, directory: Path) -> Any:
    """Adds the adapters of a checkpoint to their model.

    Raises:
        MissingExtraError: if peft is not installed.
        PolicyError: if a tensor is absent or does not fit.
    """
    try:
        from peft import PeftConfig as Configuration
        from peft import get_peft_model
    except ImportError as error:
        raise MissingExtraError(
            f"'{directory}' has adapters, which need the package peft: {install_command('vla')}."
        ) from error
    config = Configuration.from_pretrained(str(directory))
    config.inference_mode = False
    for parameter in model.parameters():
        parameter.requires_grad_(False)
    model.name_or_path = config.base_model_name_or_path  # what peft would else write over it
    wrapped = get_peft_model(model, config)
    load_state(
        wrapped, checkpoint.read_weights(directory / checkpoint.ADAPTERS), directory / checkpoint.ADAPTERS
    )
    return wrapped
