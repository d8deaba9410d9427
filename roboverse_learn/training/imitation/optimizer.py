"""The optimizer of imitation, with groups for the backbone and for what Muon trains."""

from typing import Any

from torch import nn

from envs.core.errors import ConfigError
from policies.imitation import ImitationPolicy
from roboverse_learn.training.config import TrainConfig
from roboverse_learn.training.imitation.muon import MuonAdamW


def make_optimizer(policy: ImitationPolicy, config: TrainConfig) -> MuonAdamW:
    """Returns the optimizer of a policy, with groups for its backbone and for what Muon trains.

    Raises:
        ConfigError: The policy forms its groups itself, and a rate for one of those here is given.
    """
    if own := policy.parameter_groups():
        for key in ("lr_backbone", "lr_muon"):
            if (given := getattr(config, key)) is not None:
                raise ConfigError(
                    f"policy={policy.name} gives each of its parts a share of train.lr, and takes no "
                    f"train.{key}, given {given:g}. Leave it out, or set train.lr."
                )
        return _adamw(
            [{"params": members, "peak_lr": config.lr * share, "muon": False} for members, share in own],
            config,
        )
    named = {name: p for name, p in policy.model.named_parameters() if p.requires_grad}
    linear = {f"{name}.weight" for name, m in policy.model.named_modules() if isinstance(m, nn.Linear)}
    peak_lr = {"": config.lr, "backbone": config.lr, "muon": config.lr_muon}
    if config.lr_backbone is not None:
        peak_lr["backbone"] = config.lr_backbone
    parameters: dict[str, list[nn.Parameter]] = {kind: [] for kind in peak_lr}
    for name, parameter in named.items():
        if "backbone" in name:
            kind = "backbone"
        elif config.lr_muon is not None and name in linear and "head" not in name:
            kind = "muon"  # its authors leave the last layer to AdamW
        else:
            kind = ""
        parameters[kind].append(parameter)
    groups = [
        {"params": members, "peak_lr": peak_lr[kind], "muon": kind == "muon"}
        for kind, members in parameters.items()
        if members
    ]
    return _adamw(groups, config)


def _adamw(groups: list[dict[str, Any]], config: TrainConfig) -> MuonAdamW:
    return MuonAdamW(
        groups,
        lr=config.lr,
        betas=(config.betas[0], config.betas[1]),
        weight_decay=config.weight_decay,
        fused=True,
    )
