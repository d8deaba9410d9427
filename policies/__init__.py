"""Policies: LeRobot's ACT and Diffusion Policy behind one interface, and scripted baselines.

Nothing heavy is imported before a policy is made or loaded.
"""

import difflib
import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from envs.core.errors import PolicyError
from policies.base import Policy

if TYPE_CHECKING:
    from policies.lerobot_policy import LeRobotPolicy

__all__ = [
    "Policy", "config_class", "create", "learns_from", "load", "names", "scripted_names",
    "summary",
]  # fmt: skip

LearnsFrom = Literal["dataset", "env"]
"""Demonstrations, or an environment that the policy acts in."""


@dataclass(frozen=True, slots=True)
class _Entry:
    """Where a learned policy is, as ``"module:Class"``, one line about it, and what it learns from."""

    config: str
    policy: str
    summary: str
    learns_from: LearnsFrom = "dataset"


_LEARNED = {
    "act": _Entry(
        "policies.act.config:ActConfig",
        "policies.act.policy:ActPolicy",
        "Action Chunking Transformer (arXiv:2304.13705)",
    ),
    "diffusion": _Entry(
        "policies.diffusion.config:DiffusionConfig",
        "policies.diffusion.policy:DiffusionPolicy",
        "Diffusion Policy with a ResNet18 and a 1D U-Net (arXiv:2303.04137)",
    ),
    "fasttd3": _Entry(
        "policies.fasttd3.config:FastTd3Config",
        "policies.fasttd3.policy:FastTd3Policy",
        "FastTD3, distributional, of many environments and large batches (arXiv:2505.22642)",
        learns_from="env",
    ),
    "tdmpc2": _Entry(
        "policies.tdmpc2.config:Tdmpc2Config",
        "policies.tdmpc2.policy:Tdmpc2Policy",
        "TD-MPC2, planning in the latent space of a world model (arXiv:2310.16828)",
        learns_from="env",
    ),
    "ppo": _Entry(
        "policies.ppo.config:PpoConfig",
        "policies.ppo.policy:PpoPolicy",
        "Proximal policy optimization by rsl_rl, Stable-Baselines3 or TorchRL (arXiv:1707.06347)",
        learns_from="env",
    ),
}
_SCRIPTED = {
    "zero": "every action is zero",
    "random": "uniform actions within the limits of the robot",
    "hold": "the joint positions of the observation, so that the robot stays",
}


def names(learns_from: LearnsFrom | None = None) -> list[str]:
    """Returns the policies that can be trained, or those of them that learn from one kind of source."""
    return sorted(name for name, entry in _LEARNED.items() if learns_from in (None, entry.learns_from))


def scripted_names() -> list[str]:
    """Returns the policies that need no training; see :mod:`policies.scripted`."""
    return sorted(_SCRIPTED)


def summary(name: str) -> str:
    """Returns one line about a learned or scripted policy."""
    return _SCRIPTED[name] if name in _SCRIPTED else _entry(name).summary


def learns_from(name: str) -> LearnsFrom:
    """Returns what policy ``name`` learns from: a ``dataset``, or an ``env`` that it acts in.

    Raises:
        PolicyError: if there is no such policy.
    """
    return _entry(name).learns_from


def config_class(name: str) -> type:
    """Returns the frozen dataclass of the settings of policy ``name``, without importing torch.

    Raises:
        PolicyError: if there is no such policy.
    """
    return _resolve(_entry(name).config)


def policy_class(name: str) -> Any:
    """Returns the class of policy ``name``.

    Raises:
        PolicyError: if there is no such policy.
    """
    return _resolve(_entry(name).policy)


def create(
    name: str,
    features: Mapping[str, Any],
    stats: Mapping[str, Mapping[str, Any]],
    config: Any = None,
    device: str = "cpu",
    seed: int = 0,
) -> "LeRobotPolicy":
    """Makes an untrained policy for a dataset.

    Args:
        name: Registered name.
        features: Features of a LeRobotDataset: per key ``dtype``, ``shape`` and ``names``.
        stats: Statistics of a LeRobotDataset: per key ``mean``, ``std``, ``min`` and ``max``.
        config: Instance of :func:`config_class`; None takes its defaults.
        device: Torch device.
        seed: Seed of the first weights.

    Raises:
        PolicyError: if there is no such policy, the configuration does not fit the features, or the policy
            learns from an env, which tells it what it sees.
    """
    if learns_from(name) != "dataset":
        raise PolicyError(
            f"Policy '{name}' learns from an env, not from a dataset: train it with `roboverse train "
            f"policy={name} task=<name>`. Of a dataset learn: {', '.join(names('dataset'))}."
        )
    config = config_class(name)() if config is None else config
    if not isinstance(config, config_class(name)):
        raise PolicyError(
            f"Policy '{name}' takes a {config_class(name).__name__}, given a {type(config).__name__}."
        )
    import torch

    cls = policy_class(name)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return cls.create(features, stats, config, device)


def load(directory: str | Path, device: str = "cpu") -> Any:
    """Loads the policy of a checkpoint, whichever it is.

    Args:
        directory: A LeRobot pretrained folder, or a run or checkpoint folder that holds one.
        device: Torch device.

    Raises:
        PolicyError: if the checkpoint is incomplete, damaged, or of a policy that is not registered.
    """
    from policies.checkpoint import policy_type, resolve

    directory = resolve(directory)
    return policy_class(policy_type(directory)).load(directory, device)


def _entry(name: str) -> _Entry:
    if name not in _LEARNED:
        close = difflib.get_close_matches(str(name).lower(), _LEARNED, n=1)
        hint = f" Did you mean '{close[0]}'?" if close else ""
        raise PolicyError(f"Unknown policy '{name}'.{hint} Valid: {', '.join(names())}.")
    return _LEARNED[name]


def _resolve(target: str) -> Any:
    module, _, attribute = target.partition(":")
    return getattr(importlib.import_module(module), attribute)
