"""Settings of a run that decide what its policy learned, as flat keys such as ``train.augment.shift_px``."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import policies
from envs.core.fingerprint import canonical_json
from envs.core.json_values import flat

_FREE = {
    *("train.steps", "train.time_limit_s"),  # the checkpoint has the training time
    *("train.save_every", "train.log_every", "train.wandb", "train.num_threads", "train.compile"),
    "train.cuda_graphs",
    *("policy.compile", "policy.cuda_graphs", "policy.save_replay"),
    "policy.tasks",  # a result lists the tasks that were learned together
}
"""Settings of how a run is computed, saved and watched."""


def completed(config: Mapping[str, Any], policy: str, train: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the configuration of a result with the defaults of keys that are younger than it is.

    Args:
        config: As :class:`benchmark.records.Result` has it.
        policy: Name of the policy, whose own defaults are those of its dataclass.
        train: Defaults of the training.
    """
    own = _own(policy)
    filled = dict(config)
    for key, defaults in (("policy", own), ("train", train)):
        if isinstance(config.get(key), Mapping):
            filled[key] = _filled(config[key], defaults)
    run = config.get("run")
    if isinstance(run, Mapping):  # a later evaluation keeps the configuration of the training there
        filled["run"] = completed(run, policy, train)
    return filled


def _filled(values: Mapping[str, Any], defaults: Mapping[str, Any]) -> dict[str, Any]:
    filled = {**defaults, **values}
    for key, inner in defaults.items():
        if isinstance(inner, Mapping) and isinstance(filled[key], Mapping):
            filled[key] = _filled(filled[key], inner)
    return filled


def learned_settings(policy: Any, train: Any) -> dict[str, Any]:
    """Returns the settings of a policy and of its training that decide what is learned, by flat key."""
    settings = {
        key: values for key, values in (("policy", policy), ("train", train)) if isinstance(values, Mapping)
    }  # a result may lack them
    return {key: value for key, value in flat(settings).items() if key not in _FREE}


def unusual_settings(name: str, policy: Any, train: Any, usual_train: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the settings of :func:`learned_settings` that are not the defaults.

    A key that is added to a policy or to the training changes nothing of it; a default that changes does.

    Args:
        name: Name of the policy.
        policy: Its settings.
        train: Settings of its training.
        usual_train: Defaults of the training.
    """
    usual = learned_settings(_own(name), usual_train)
    settings = learned_settings(policy, train)
    return {key: value for key, value in settings.items() if _is_unusual(key, value, usual)}


def _is_unusual(key: str, value: Any, usual: Mapping[str, Any]) -> bool:
    return key not in usual or canonical_json(value) != canonical_json(usual[key])  # a tuple is a list there


def _own(policy: str) -> dict[str, Any]:
    return asdict(policies.config_class(policy)()) if policy in policies.names() else {}


def differing(settings: Sequence[Mapping[str, Any]]) -> list[str]:
    """Returns the keys that all of several settings have, and not all with the same value."""
    shared = [key for key in settings[0] if all(key in other for other in settings)]
    return [key for key in shared if len({canonical_json(other[key]) for other in settings}) > 1]


def said(key: str, value: Any, among: Sequence[str]) -> str:
    """Returns a setting for people: ``shift_px 4``; by its whole key where ``among`` has that name twice."""
    name = key.rpartition(".")[2]
    unique = sum(other.rpartition(".")[2] == name for other in among) < 2
    return f"{name if unique else key} {value if isinstance(value, str) else canonical_json(value)}"
