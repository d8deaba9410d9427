"""Cameras, states and statistics of a LeRobot policy, matched with those of a dataset or task."""

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from lerobot.configs import FeatureType, NormalizationMode
from lerobot.utils.constants import OBS_STATE
from torch import Tensor

from envs.core.errors import PolicyError
from envs.core.observation_keys import IMAGE_PREFIX
from policies.lerobot_policy import Features
from policies.normalization import policy_stats
from policies.zoo.cameras import check_state_size, missing_cameras

_MIN_RANGE = 1e-4


def matched_inputs(config: Any, inputs: Features, rename_map: Mapping[str, str]) -> None:
    """Sets the inputs of a trained policy to those of a dataset.

    Args:
        config: LeRobot's configuration of the checkpoint, changed in place.
        inputs: Of the dataset.
        rename_map: Key of the dataset to key of the policy.

    Raises:
        PolicyError: if the cameras do not match, or the state is wider than the policy allows.
    """
    cameras = [key for key, feature in inputs.items() if feature.type is FeatureType.VISUAL]
    own = (config.input_features or {}).get(OBS_STATE)
    trained = None if own is None else own.shape[0]
    check_state_size(inputs[OBS_STATE].shape[0], trained, getattr(config, "max_state_dim", None))
    names = [key.removeprefix(IMAGE_PREFIX) for key in cameras]
    keep_cameras(config, names, rename_map, "the dataset")
    renamed = {rename_map.get(key, key): feature for key, feature in inputs.items()}
    config.input_features = {
        key: renamed.get(key, feature)
        for key, feature in config.input_features.items()
        if feature.type is FeatureType.VISUAL
    } | {key: feature for key, feature in inputs.items() if feature.type is not FeatureType.VISUAL}


def keep_cameras(
    config: Any, cameras: Sequence[str], rename_map: Mapping[str, str], where: str = "the task"
) -> None:
    """Keeps the inputs of a policy that some cameras give.

    Args:
        config: LeRobot's configuration, changed in place.
        cameras: Names of the cameras.
        rename_map: Key of a camera to key of the policy.
        where: What has the cameras: ``the task`` or ``the dataset``.

    Raises:
        PolicyError: if a camera of the policy is not given, and the policy needs it.
    """
    plain = [key.removeprefix(IMAGE_PREFIX) for key in config.image_features]
    targets = [
        rename_map.get(IMAGE_PREFIX + name, IMAGE_PREFIX + name).removeprefix(IMAGE_PREFIX)
        for name in cameras
    ]
    lost = {IMAGE_PREFIX + name for name in missing_cameras(config.type, plain, targets, cameras, where)}
    config.input_features = {key: each for key, each in config.input_features.items() if key not in lost}


def statistics(config: Any, stats: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Tensor]]:
    """Returns the statistics that LeRobot's processors normalize with.

    Images have ImageNet's, as in ``lerobot-train``.

    Args:
        config: LeRobot's configuration, whose inputs and outputs are those of the dataset.
        stats: Of the dataset, by the keys of the policy.

    Raises:
        PolicyError: if one that is needed is absent.
    """
    features = config.input_features | config.output_features
    present = {key: feature for key, feature in features.items() if key in stats}
    images = {key: feature.type is FeatureType.VISUAL for key, feature in present.items()}
    own = policy_stats(images, stats, "imagenet")
    for key, feature in present.items():
        mode = config.normalization_mapping.get(feature.type.value, NormalizationMode.IDENTITY)
        pair = {
            NormalizationMode.QUANTILES: ("q01", "q99"), NormalizationMode.QUANTILE10: ("q10", "q90")
        }.get(mode)  # fmt: skip
        if pair is None or images[key]:
            continue
        if not set(pair) <= stats[key].keys():
            raise PolicyError(
                f"{config.type} normalizes '{key}' by the quantiles {' and '.join(pair)}, which the dataset "
                "does not have: collect it again, or set policy.normalization_mapping="
                "{VISUAL:IDENTITY,STATE:MEAN_STD,ACTION:MEAN_STD}."
            )
        low, high = (torch.as_tensor(stats[key][name], dtype=torch.float32).clone() for name in pair)
        constant = high - low < _MIN_RANGE  # a joint that never moves must not be amplified without bound
        own[key] |= dict(zip(pair, (torch.where(constant, low - 1, low), torch.where(constant, high + 1,
        high)),
                             strict=True))  # fmt: skip
    return own
