"""A LeRobot policy from its settings or from a checkpoint: configuration, network, weights, processors."""

import json
from collections.abc import Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from lerobot.configs import PreTrainedConfig
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from lerobot.processor import (
    PolicyProcessorPipeline,
    ProcessorStepRegistry,
    RenameObservationsProcessorStep,
)
from lerobot.utils.constants import ACTION
from torch import Tensor, nn

from envs.core.errors import MissingExtraError, PolicyError
from envs.core.extras import install_command
from policies import checkpoint
from policies.lerobot_policy import Processors
from policies.zoo import adapters
from policies.zoo.assets import carried, read_assets, tokenizer_from
from policies.zoo.config import LeRobotConfig, check_preset
from policies.zoo.preflight import check_type_packages
from policies.zoo.source import local_folder
from policies.zoo.types import EXTRA, OF_TRAINING, type_names
from policies.zoo.weights import load_tensors, read_tensors

_NORMALIZERS = ("normalizer_processor", "molmoact2_masked_normalizer")
_UNNORMALIZERS = ("unnormalizer_processor", "molmoact2_masked_unnormalizer")
_ACTION_TOKENIZER, _PACK_INPUTS = "action_tokenizer_processor", "molmoact2_pack_inputs"
_KEEP_STATISTICS = ("groot",)
"""Types whose own steps normalize: what they saved replaces the statistics that LeRobot is given."""
_RENAME, _DEVICE = "rename_observations_processor", "device_processor"


@dataclass(kw_only=True, slots=True)
class Read:
    """What a checkpoint folder holds.

    Attributes:
        config: LeRobot's configuration.
        folder: The checkpoint.
        weights_path: Where the network's weights are from; the base of adapters.
        tensors: Those weights.
        assets: Folder of each name that the checkpoint carries.
        adapters: Whether it has adapters.
    """

    config: Any
    folder: Path
    weights_path: Path
    tensors: dict[str, Tensor]
    assets: dict[str, str]
    adapters: bool = False


def read_base(config: LeRobotConfig, device: str) -> Read:
    """Reads the checkpoint that is fine-tuned, with the given settings over its own.

    Raises:
        PolicyError: if it is of another type, damaged, or has adapters.
    """
    folder = local_folder(config.path)
    content = checkpoint.read_json(folder / checkpoint.CONFIG)
    if config.type and content.get("type") != config.type:
        raise PolicyError(
            f"'{config.path}' is of type {content.get('type')}, and type={config.type} was given. "
            "Leave out type."
        )
    read = read_folder(folder, device, config.settings)
    if read.adapters:
        raise PolicyError(
            f"'{config.path}' has adapters, which are not trained further. Name their model in policy.path: "
            f"{adapters.find_base(folder)}."
        )
    return read


def read_folder(folder: Path, device: str, settings: Mapping[str, Any] | None = None) -> Read:
    """Reads the configuration, the weights and the assets of a checkpoint; with adapters, of their model.

    Raises:
        PolicyError: if a file is absent or damaged.
    """
    content = checkpoint.read_json(folder / checkpoint.CONFIG)
    with_adapters = (folder / checkpoint.ADAPTERS).is_file()
    config = _decode(str(content.pop("type", None)), {**content, **(settings or {})}, device, str(folder))
    assets = read_assets(folder)
    source = local_folder(adapters.find_base(folder)) if with_adapters else folder
    path = checkpoint.weights_path(source)
    config.use_peft = with_adapters
    return Read(
        config=config,
        folder=folder,
        weights_path=path,
        tensors=read_tensors(path),
        assets=read_assets(source) | assets,
        adapters=with_adapters,
    )


def lerobot_config(config: LeRobotConfig, device: str) -> Any:
    """Returns LeRobot's configuration of given settings.

    Raises:
        PolicyError: if LeRobot refuses one.
    """
    return _decode(config.type, dict(config.settings), device, f"policy=lerobot type={config.type}")


def _decode(type_name: str, content: dict[str, Any], device: str, where: str) -> Any:
    import draccus

    try:
        found = PreTrainedConfig.get_choice_class(type_name)
    except Exception as error:  # draccus raises several unrelated types
        raise PolicyError(
            f"'{where}' is of type '{type_name}', which this LeRobot does not have. Types: "
            f"{', '.join(type_names())}."
        ) from error
    content = content | {"device": device, "push_to_hub": False}
    for key in {*OF_TRAINING} - {field.name for field in fields(found)}:
        content.pop(key, None)
    if "pretrained_backbone_weights" in content:  # torchvision's would be downloaded
        content["pretrained_backbone_weights"] = None
    with _readable(f"LeRobot refuses the settings of '{where}'"):
        return draccus.decode(found, content)


def build(
    config: Any, assets: Mapping[str, str], tensors: Mapping[str, Tensor] | None, path: Path | None
) -> Any:
    """Makes LeRobot's network, with the weights of a checkpoint or with its first ones.

    Raises:
        MissingExtraError: if a package is not installed.
        PolicyError: if a backbone is not found, or the weights do not fit.
    """
    check_type_packages(config.type)
    what = f"policy=lerobot type={config.type} cannot be made"
    with _readable(what), carried(config, assets, weights=tensors is None):
        model = get_policy_class(config.type)(config)
    if tensors is not None:
        assert path is not None
        load_tensors(model, tensors, path)
    return model


@contextmanager
def _readable(what: str) -> Any:
    """Turns the errors of LeRobot, draccus and transformers into one sentence."""
    try:
        yield
    except ImportError as error:
        raise MissingExtraError(f"{what}: {error} Install it by: {install_command(EXTRA)}.") from error
    except PolicyError:
        raise
    except Exception as error:  # each library raises its own
        cause = " ".join(str(error.__cause__ or error).split())
        hint = (
            " A tokenizer and a backbone are read from the hub, or from a folder: name it, as in "
            "policy.vlm_model_name=<folder> or policy.tokenizer=<folder>."
            if isinstance(error, OSError)
            else ""
        )
        raise PolicyError(f"{what}: {cause}{hint}") from error


def make_processors(
    config: Any,
    folder: Path | None,
    stats: Mapping[str, Mapping[str, Tensor]] | None,
    assets: Mapping[str, str],
    rename_map: Mapping[str, str],
    device: str,
    tokenizer: str = "",
) -> Processors:
    """Makes the processors of a policy, or reads those of its checkpoint.

    Args:
        config: LeRobot's configuration.
        folder: The checkpoint, if there is one.
        stats: Statistics to normalize with; None keeps those of the checkpoint.
        assets: Folder of each name that the checkpoint carries.
        rename_map: Key of the environment or dataset to key of the policy.
        device: Torch device.
        tokenizer: Folder of a tokenizer in place of the one that LeRobot names; empty takes that.

    Raises:
        PolicyError: if they cannot be read.
    """
    what = f"The processors of policy=lerobot type={config.type} cannot be made"
    if folder is None or not (folder / checkpoint.PREPROCESSOR).is_file():
        if stats is None:
            raise PolicyError(
                f"Checkpoint '{folder}' has no {checkpoint.PREPROCESSOR}: it is of an older LeRobot. "
                "Convert it with lerobot's migrate_policy_normalization, or fine-tune it with policy.path."
            )
        with _readable(what), tokenizer_from(config, tokenizer):
            processors = _new_processors(config, stats)
        set_rename_map(processors[0], rename_map)
        return processors
    processors = _read_processors(config, folder, stats, assets, rename_map, device, tokenizer)
    if config.type in _KEEP_STATISTICS and stats is not None:
        with _readable(what), tokenizer_from(config, tokenizer):
            _renew_statistics(processors, _new_processors(config, stats))
    return processors


def _new_processors(config: Any, stats: Mapping[str, Mapping[str, Tensor]]) -> Processors:
    return make_pre_post_processors(config, dataset_stats={key: dict(each) for key, each in stats.items()})


def _renew_statistics(processors: Processors, made: Processors) -> None:
    """Gives steps the statistics and the width of actions of steps that were made from a dataset."""
    own = {type(step): step for pipeline in made for step in pipeline.steps}
    for step in (step for pipeline in processors for step in pipeline.steps):
        for name in ("stats", "env_action_dim"):
            if hasattr(step, name) and type(step) in own:
                setattr(step, name, getattr(own[type(step)], name))


def _read_processors(
    config: Any, folder: Path, stats: Any, assets: Mapping[str, str], rename_map: Mapping[str, str],
    device: str, tokenizer: str,
) -> Processors:  # fmt: skip
    what = f"The processors of checkpoint '{folder}' cannot be read"
    normalizer: dict[str, Any] = {"norm_map": config.normalization_mapping}
    if stats is not None:
        normalizer["stats"] = dict(stats)
    inputs = {**normalizer, "features": {**config.input_features, **config.output_features}}
    changes = {
        checkpoint.PREPROCESSOR: {
            _DEVICE: {"device": device},
            _RENAME: {"rename_map": dict(rename_map)},
            **(dict.fromkeys(_NORMALIZERS, inputs) if stats is not None else {}),
            **_changed_settings(config, assets, tokenizer),
        },
        checkpoint.POSTPROCESSOR: (
            dict.fromkeys(_UNNORMALIZERS, normalizer | {"features": config.output_features})
            if stats is not None
            else {}
        ),
    }
    overrides = {}
    with _readable(what):
        _register_steps(config)
        for name, wanted in changes.items():
            checkpoint.check_pipeline(folder / name, ProcessorStepRegistry.list())
            overrides[name] = _overrides(folder / name, wanted, assets, tokenizer)
        return make_pre_post_processors(
            config,
            pretrained_path=str(folder),
            preprocessor_overrides=overrides[checkpoint.PREPROCESSOR],
            postprocessor_overrides=overrides[checkpoint.POSTPROCESSOR],
            dataset_stats=None if stats is None else dict(stats),
        )


def _changed_settings(config: Any, assets: Mapping[str, str], tokenizer: str) -> dict[str, Any]:
    """Returns settings of steps that a saved pipeline lacks, or has from the dataset before."""
    changes: dict[str, Any] = {}
    if config.type == "molmoact2":
        changes[_PACK_INPUTS] = {"env_action_dim": config.output_features[ACTION].shape[0]}
    if hasattr(config, "fast_skip_tokens"):  # π0-FAST's step saves neither; LeRobot takes those of the hub
        name = config.text_tokenizer_name
        changes[_ACTION_TOKENIZER] = {
            "paligemma_tokenizer_name": tokenizer or assets.get(name, name),
            "fast_skip_tokens": config.fast_skip_tokens,
        }
    return changes


def _register_steps(config: Any) -> None:
    """Imports the module that registers the processor steps of a type."""
    import importlib

    module = type(config).__module__.replace("configuration_", "processor_")
    importlib.import_module(module)


def _overrides(
    path: Path, wanted: Mapping[str, Any], assets: Mapping[str, str], tokenizer: str
) -> dict[str, Any]:
    """Returns what changes in the steps of a pipeline file, carried folders in place of names included."""
    overrides: dict[str, Any] = {}
    for step in checkpoint.read_json(path)["steps"]:
        name, config = str(step["registry_name"]), dict(step.get("config", {}))
        changes = {key: assets[value] for key, value in config.items() if _is_carried(value, assets)}
        if tokenizer and "tokenizer_name" in config:
            changes["tokenizer_name"] = tokenizer
        changes |= wanted.get(name, {})
        if changes:
            overrides[name] = changes
    return overrides


def _is_carried(value: Any, assets: Mapping[str, str]) -> bool:
    return isinstance(value, str) and value in assets


def restore_names(directory: Path, assets: Mapping[str, str]) -> None:
    """Writes the names of tokenizers, in place of carried folders, into saved processors."""
    path = directory / checkpoint.PREPROCESSOR
    names = {folder: name for name, folder in assets.items()}
    content = checkpoint.read_json(path)
    for step in content["steps"]:
        for key, value in step.get("config", {}).items():
            if isinstance(value, str) and value in names:
                step["config"][key] = names[value]
    path.write_text(json.dumps(content, indent=2), encoding="utf-8")


def saved_rename_map(folder: Path) -> dict[str, str]:
    """Returns how a checkpoint's processors rename cameras."""
    path = folder / checkpoint.PREPROCESSOR
    if not path.is_file():
        return {}
    steps = checkpoint.read_json(path).get("steps", [])
    found = [step["config"].get("rename_map") for step in steps if step.get("registry_name") == _RENAME]
    return dict(found[0] or {}) if found else {}


def set_rename_map(preprocessor: PolicyProcessorPipeline, rename_map: Mapping[str, str]) -> None:
    """Sets how a pipeline renames cameras."""
    for step in preprocessor.steps:
        if isinstance(step, RenameObservationsProcessorStep):
            renaming: Any = step
            renaming.rename_map = dict(rename_map)


# --- training -----------------------------------------------------------------------------------------


def with_preset(model: Any, config: Any) -> Any:
    """Returns settings of training with those of LeRobot's preset.

    Args:
        model: LeRobot's policy.
        config: A :class:`roboverse_learn.training.config.TrainConfig`.

    Raises:
        PolicyError: if a value that the preset decides was changed.
    """
    check_preset(config)
    preset = model.config.get_optimizer_preset()
    values = {"lr": preset.lr, "weight_decay": preset.weight_decay, "grad_clip": preset.grad_clip_norm}
    if hasattr(preset, "betas"):
        values["betas"] = tuple(preset.betas)
    return replace(config, **values)


def parameter_groups(model: nn.Module, network: Any) -> list[tuple[list[nn.Parameter], float]]:
    """Returns the trained parameters, each group with its share of the learning rate, as LeRobot has them."""
    trained = [parameter for parameter in model.parameters() if parameter.requires_grad]
    shares = {id(parameter): 1.0 for parameter in trained}
    given = network.get_optim_params()
    if isinstance(given, dict):  # X-VLA, by name (lerobot.optim.optimizers.XVLAAdamWConfig)
        scales = {"vlm": 0.1, "soft_prompt": getattr(network.config, "optimizer_soft_prompt_lr_scale", 1.0)}
        for name, parameter in given.items():
            shares[id(parameter)] = next((s for part, s in scales.items() if part in name.lower()), 1.0)
    elif isinstance(given, list) and given and isinstance(given[0], dict):
        base = network.config.get_optimizer_preset().lr
        for group in given:
            for parameter in group["params"]:
                shares[id(parameter)] = group.get("lr", base) / base
    groups: dict[float, list[nn.Parameter]] = {}
    for parameter in trained:
        groups.setdefault(shares[id(parameter)], []).append(parameter)
    return [(members, share) for share, members in groups.items()]
