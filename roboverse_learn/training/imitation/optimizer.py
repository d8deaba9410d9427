"""The optimizer of imitation, with groups for the backbone and for what Muon trains."""

from collections.abc import Collection
from typing import Any

from torch import nn

from envs.core.errors import ConfigError
from policies.imitation import ImitationPolicy
from roboverse_learn.training.config import TrainConfig
from roboverse_learn.training.imitation.muon import MuonAdamW


def make_optimizer(policy: ImitationPolicy, config: TrainConfig) -> MuonAdamW:
    """Returns the optimizer of a policy, with groups for its backbone and for what Muon trains.

    Raises:
        ConfigError: The policy forms its groups itself, and a rate of its backbone is given.
    """
    matrices = set() if config.lr_muon is None else _hidden_matrices(policy.model)
    if own := policy.parameter_groups():
        if (given := config.lr_backbone) is not None:
            raise ConfigError(
                f"policy={policy.name} gives each of its parts a share of train.lr, and takes no "
                f"train.lr_backbone, given {given:g}. Leave it out, or set train.lr."
            )
        return _adamw(_own_groups(own, matrices, config), config)
    named = {name: p for name, p in policy.model.named_parameters() if p.requires_grad}
    peak_lr = {"": config.lr, "backbone": config.lr, "muon": config.lr_muon}
    if config.lr_backbone is not None:
        peak_lr["backbone"] = config.lr_backbone
    parameters: dict[str, list[nn.Parameter]] = {kind: [] for kind in peak_lr}
    for name, parameter in named.items():
        if "backbone" in name:
            kind = "backbone"
        elif id(parameter) in matrices:
            kind = "muon"
        else:
            kind = ""
        parameters[kind].append(parameter)
    groups = [
        {"params": members, "peak_lr": peak_lr[kind], "muon": kind == "muon"}
        for kind, members in parameters.items()
        if members
    ]
    return _adamw(groups, config)


def _hidden_matrices(model: nn.Module) -> set[int]:
    """Returns the ids of the weights of linear layers that Muon trains.

    Its authors leave the last layer and embeddings, which a layer may share, to AdamW.
    """
    embeddings = {id(each.weight) for each in model.modules() if isinstance(each, nn.Embedding)}
    return {
        id(layer.weight)
        for name, layer in model.named_modules()
        if isinstance(layer, nn.Linear) and "head" not in name and id(layer.weight) not in embeddings
    }


def _own_groups(
    own: list[tuple[list[nn.Parameter], float]], matrices: Collection[int], config: TrainConfig
) -> list[dict[str, Any]]:
    """Returns a policy's groups, each divided into what Muon trains and the rest."""
    groups = []
    for members, share in own:
        for lr, muon in ((config.lr, False), (config.lr_muon, True)):
            chosen = [each for each in members if (id(each) in matrices) is muon]
            if chosen and lr is not None:
                groups.append({"params": chosen, "peak_lr": lr * share, "muon": muon})
    return groups


def _adamw(groups: list[dict[str, Any]], config: TrainConfig) -> MuonAdamW:
    return MuonAdamW(
        groups,
        lr=config.lr,
        betas=(config.betas[0], config.betas[1]),
        weight_decay=config.weight_decay,
        fused=True,
    )
