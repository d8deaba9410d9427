"""Policies behind one interface: LeRobot's policies, reinforcement learning agents and baselines.

:data:`POLICIES` lists them. A network of your own is a :class:`policies.trainable.TrainablePolicy`. An entry
point in the group ``roboverse.policies`` registers it, or one call in a module that ``plugins=`` names::

    POLICIES.add("mine", "my_package.policy:Mine", summary="What it is, in one line")

Nothing heavy is imported before a policy is made or loaded.
"""

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from envs.core.errors import PolicyError
from envs.core.registry import Registry
from policies.base import Policy
from policies.learned_tasks import TASK_INDEX

if TYPE_CHECKING:
    from policies.imitation import ImitationPolicy
    from policies.scripted import ScriptedPolicy
    from policies.trainable import TrainablePolicy

__all__ = [
    "POLICIES", "Policy", "PolicyInfo", "Source", "check_of", "config_class", "create",
    "create_scripted", "learner", "learns_from", "learns_several", "load", "names", "policy_class", "summary",
]  # fmt: skip

Source = Literal["dataset", "env", "nothing"]
"""Source that a policy learns from, the tag of its entry: demonstrations, an environment, or nothing."""


@dataclass(frozen=True, kw_only=True, slots=True)
class PolicyInfo:
    """Parts of a policy as ``"module:Class"``, imported at first use.

    Attributes:
        policy: Its class, which follows :class:`policies.base.Policy`; it owns its checkpoints.
        config: Frozen dataclass of its settings, which checks them; None if it has none.
        learner: What trains it: a name in ``roboverse_learn.training.learners``, or the ``"module:Class"`` of
            a learner elsewhere. Empty if it needs no training.
        check: ``"module:function"`` of settings and features, called before a training begins: it raises a
            :class:`~envs.core.errors.RoboVerseError` where the policy cannot learn. Empty if there is none.
    """

    policy: str
    config: str | None = None
    learner: str = "imitation"
    check: str = ""


POLICIES: "Registry[PolicyInfo | type[TrainablePolicy]]" = Registry(
    "policy", "roboverse.policies", default_tags={"dataset"}
)
POLICIES.add(
    "act",
    PolicyInfo(policy="policies.act.policy:ActPolicy", config="policies.act.config:ActConfig"),
    tags={"dataset"},
    summary="Action Chunking Transformer (arXiv:2304.13705)",
)
POLICIES.add(
    "diffusion",
    PolicyInfo(
        policy="policies.diffusion.policy:DiffusionPolicy", config="policies.diffusion.config:DiffusionConfig"
    ),
    tags={"dataset"},
    summary="Diffusion Policy with a ResNet18 or image keypoints, and a 1D U-Net (arXiv:2303.04137)",
)
POLICIES.add(
    "mtact",
    PolicyInfo(
        policy="policies.mtact.policy:MtActPolicy",
        config="policies.mtact.config:MtActConfig",
        check="policies.mtact.frozen_text:check_mtact",
    ),
    tags={"dataset"},
    summary="Several tasks by their instructions: FiLM, transformer, action chunks (after arXiv:2406.07539)",
)
POLICIES.add(
    "lerobot",
    PolicyInfo(
        policy="policies.zoo.announced:LeRobotZooPolicy",
        config="policies.zoo.config:LeRobotConfig",
        check="policies.zoo.preflight:check_lerobot",
    ),
    tags={"dataset"},
    summary="Any policy of LeRobot's registry by type=<name>: smolvla, pi0, pi05, xvla, multi_task_dit, ...",
)
POLICIES.add(
    "openvla",
    PolicyInfo(
        policy="policies.openvla.policy:OpenVlaPolicy",
        config="policies.openvla.config:OpenVlaConfig",
        check="policies.zoo.preflight:check_openvla",
    ),
    tags={"dataset"},
    summary="OpenVLA, fine-tuned from its 7 B checkpoint: actions as tokens (arXiv:2406.09246)",
)
POLICIES.add(
    "octo",
    PolicyInfo(
        policy="policies.octo.policy:OctoPolicy",
        config="policies.octo.config:OctoConfig",
        check="policies.zoo.preflight:check_octo",
    ),
    tags={"dataset"},
    summary="Octo, fine-tuned from a converted checkpoint: action chunks by diffusion (arXiv:2405.12213)",
)
POLICIES.add(
    "fasttd3",
    PolicyInfo(
        policy="policies.fasttd3.policy:FastTd3Policy",
        config="policies.fasttd3.config:FastTd3Config",
        learner="fasttd3",
    ),
    tags={"env"},
    summary="FastTD3: distributional critics, many environments, large batches (arXiv:2505.22642)",
)
POLICIES.add(
    "tdmpc2",
    PolicyInfo(
        policy="policies.tdmpc2.policy:Tdmpc2Policy",
        config="policies.tdmpc2.config:Tdmpc2Config",
        learner="tdmpc2",
    ),
    tags={"env"},
    summary="TD-MPC2, planning in the latent space of a world model (arXiv:2310.16828)",
)
POLICIES.add(
    "ppo",
    PolicyInfo(policy="policies.ppo.policy:PpoPolicy", config="policies.ppo.config:PpoConfig", learner="ppo"),
    tags={"env"},
    summary="Proximal policy optimization by rsl_rl, Stable-Baselines3 or TorchRL (arXiv:1707.06347)",
)
for _name, _class, _summary in (
    ("zero", "ZeroPolicy", "Every action is zero"),
    ("random", "RandomPolicy", "Uniform actions within the limits of the robot"),
    ("hold", "HoldPolicy", "The joint positions of the observation, so that the robot stays"),
):
    POLICIES.add(
        _name,
        PolicyInfo(policy=f"policies.scripted:{_class}", learner=""),
        tags={"nothing"},
        summary=_summary,
    )


def names(source: Source | None = None) -> list[str]:
    """Returns the policies that learn from one kind of source; all that can be trained by default."""
    trainable = [*POLICIES.names("dataset"), *POLICIES.names("env")]
    return sorted(trainable) if source is None else POLICIES.names(source)


def summary(name: str) -> str:
    """Returns one line about a policy.

    Raises:
        UnknownNameError: if there is no such policy.
    """
    return POLICIES.entry(name).summary


def learns_from(name: str) -> Source:
    """Returns what policy ``name`` learns from.

    Raises:
        UnknownNameError: if there is no such policy.
    """
    tags = POLICIES.entry(name).tags
    return "dataset" if "dataset" in tags else "env" if "env" in tags else "nothing"


def config_class(name: str) -> type:
    """Returns the frozen dataclass of the settings of policy ``name``.

    Of our own policies, torch is not imported.

    Raises:
        UnknownNameError: if there is no such policy.
        PolicyError: if it has no settings, or what is registered is no policy.
    """
    found = POLICIES.get(name)
    if not isinstance(found, PolicyInfo):
        return _checked(name, found).config_class
    if found.config is None:
        raise PolicyError(f"Policy '{name}' needs no training. Trainable: {', '.join(names())}.")
    return resolve(found.config)


def policy_class(name: str) -> Any:
    """Returns the class of policy ``name``.

    Raises:
        UnknownNameError: if there is no such policy.
        PolicyError: if what is registered is no policy.
    """
    found = POLICIES.get(name)
    if isinstance(found, PolicyInfo):
        return resolve(found.policy)
    from policies.module_policy import module_policy

    return module_policy(name, _checked(name, found))


def learns_several(name: str) -> bool:
    """Whether policy ``name`` learns several tasks of demonstrations together: its batches name each task.

    Raises:
        UnknownNameError: if there is no such policy.
        PolicyError: if what is registered is no policy.
    """
    return TASK_INDEX in getattr(policy_class(name), "columns", ())


def learner(name: str) -> str:
    """Returns what trains policy ``name``; see :attr:`PolicyInfo.learner`.

    Raises:
        UnknownNameError: if there is no such policy.
    """
    found = POLICIES.get(name)
    return found.learner if isinstance(found, PolicyInfo) else "imitation"


def check_of(name: str) -> "Callable[[Any, Mapping[str, Any]], None] | None":
    """Returns what looks at the settings and features of policy ``name``; see :attr:`PolicyInfo.check`."""
    found = POLICIES.get(name)
    return resolve(found.check) if isinstance(found, PolicyInfo) and found.check else None


def _checked(name: str, found: Any) -> "type[TrainablePolicy]":
    from policies.trainable import check_class

    return check_class(name, found)


def create_scripted(name: str, action_space: Any, n_action_steps: int = 1) -> "ScriptedPolicy":
    """Makes a policy that needs no training, such as ``random``, for the actions of an environment.

    Args:
        name: One of ``names("nothing")``.
        action_space: Box (action_dim,) of one environment, such as ``env.single_action_space``.
        n_action_steps: Actions that one call returns.

    Raises:
        UnknownNameError: if there is no such policy.
        PolicyError: if it has to be trained.
    """
    if learns_from(name) != "nothing":
        raise PolicyError(
            f"Policy '{name}' must be trained: roboverse train policy={name} task=<name>. "
            f"Without training: {', '.join(names('nothing'))}."
        )
    return policy_class(name)(action_space.low, action_space.high, n_action_steps)


def create(
    name: str,
    features: Mapping[str, Any],
    stats: Mapping[str, Mapping[str, Any]],
    config: Any = None,
    device: str = "cpu",
    seed: int = 0,
) -> "ImitationPolicy":
    """Makes an untrained policy for a dataset.

    Args:
        name: Registered name.
        features: Features of a LeRobotDataset: per key ``dtype``, ``shape`` and ``names``.
        stats: Statistics of a LeRobotDataset: per key ``mean``, ``std``, ``min`` and ``max``.
        config: Instance of :func:`config_class`; None takes its defaults.
        device: Torch device.
        seed: Seed of the first weights.

    Raises:
        UnknownNameError: if there is no such policy.
        PolicyError: if the configuration does not fit the features, or the policy learns from something else.
    """
    if (source := learns_from(name)) != "dataset":
        raise PolicyError(
            f"Policy '{name}' learns from {'an env' if source == 'env' else source}, not from a dataset. "
            f"Train it with `roboverse train policy={name} task=<name>`. From a dataset learn: "
            f"{', '.join(names('dataset'))}."
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
        PolicyError: if the checkpoint is incomplete or damaged.
        UnknownNameError: if it is of a policy that is not registered.
    """
    from policies.checkpoint import policy_type, resolve

    directory = resolve(directory)
    return policy_class(policy_type(directory)).load(directory, device)


def resolve(target: str) -> Any:
    """Returns what ``"module:attribute"`` names."""
    module, _, attribute = target.partition(":")
    return getattr(importlib.import_module(module), attribute)
