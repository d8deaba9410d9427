"""Contracts of a policy that learns from demonstrations."""

import tempfile
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

import policies
from envs.core.errors import ConfigError
from envs.core.observation_keys import IMAGE_PREFIX
from envs.spec import EnvSpec
from policies.imitation import ACTION, ImitationPolicy
from roboverse_learn.checks.contract import Contract, contract, require
from roboverse_learn.data.dataset.schema import STATE_KEY, make_features

_ROWS = 4
_STEPS = 100
_LEARNING_RATE = 1e-3
_LEARNED = 0.85
"""Share of the first loss that the last one is below, after 100 steps on one batch: Diffusion Policy, which
predicts noise, reaches 0.78; a regression far lower."""


def random_observation(
    features: Mapping[str, Any], n_obs_steps: int, instruction: str, num_envs: int
) -> dict[str, np.ndarray]:
    """Returns what environments might show a policy, the same each time: see ``Policy.act``."""
    rng, time = np.random.default_rng(0), (n_obs_steps,) if n_obs_steps > 1 else ()
    seen: dict[str, np.ndarray] = {}
    for key, feature in features.items():
        shape = (num_envs, *time, *feature["shape"])
        if key.startswith(IMAGE_PREFIX):
            seen[key] = rng.integers(0, 256, shape, np.uint8)
        elif key == STATE_KEY:
            seen[key] = rng.normal(0.0, 0.5, shape).astype(np.float32)
    seen["task"] = np.array([instruction] * num_envs)
    return seen


class CheckedPolicy:
    """A policy under test, untrained, on what a task observes.

    Args:
        name: Registered policy.
        spec: Environment whose cameras, image size, joints and actions it gets.
        config: Instance of its configuration; None takes its defaults.

    Raises:
        UnknownNameError: There is no such policy.
        ConfigError: It does not learn from demonstrations.
    """

    def __init__(self, name: str, spec: EnvSpec, config: Any = None) -> None:
        if policies.learns_from(name) != "dataset":
            raise ConfigError(
                f"policy={name} does not learn from demonstrations, which the contracts of policies ask for. "
                f"Those that do: {', '.join(policies.names('dataset'))}."
            )
        self.name, self.spec, self.config = name, spec, config

    @cached_property
    def features(self) -> dict[str, Any]:
        """Features of a dataset of the task."""
        task = self.spec.make_task()
        cameras = self.spec.cameras or tuple(camera.name for camera in task.scenario.cameras[:1])
        size = (self.spec.image_size, self.spec.image_size)
        return make_features(task.state_names, task.controller.names, dict.fromkeys(cameras, size))

    @cached_property
    def policy(self) -> ImitationPolicy:
        """The untrained policy."""
        return self.create()

    def create(self) -> ImitationPolicy:
        """Returns another one, with the same weights."""
        vectors = (STATE_KEY, ACTION)
        sizes = {key: self.features[key]["shape"][0] for key in vectors}
        stats: dict[str, Mapping[str, Any]] = {
            key: {"mean": np.zeros(n), "std": np.full(n, 0.5), "min": -np.ones(n), "max": np.ones(n)}
            for key, n in sizes.items()
        }
        shape = (3, 1, 1)
        image = {"mean": 0.5, "std": 0.25, "min": 0.0, "max": 1.0}
        for key in self.features.keys() - vectors:
            stats[key] = {name: np.full(shape, value) for name, value in image.items()}
        return policies.create(self.name, self.features, stats, self.config)

    def observation(self) -> dict[str, np.ndarray]:
        """Returns random observations of ``_ROWS`` environments."""
        return random_observation(self.features, self.policy.n_obs_steps, self.spec.make_task().name, _ROWS)

    def batch(self) -> dict[str, Tensor]:
        """Returns raw frames of ``_ROWS`` training samples, as the training loop gives them."""
        batch: dict[str, Tensor] = {}
        for key, value in self.observation().items():
            if key not in self.features:  # the instructions, which a dataset counts
                continue
            tensor = torch.from_numpy(value)
            batch[key] = tensor.movedim(-1, -3).contiguous() if key.startswith(IMAGE_PREFIX) else tensor
        length = len(self.policy.delta_indices[ACTION])
        steps, rng = np.arange(length) / 10.0, np.random.default_rng(1)
        waves = np.sin(steps[:, None] + rng.uniform(0.0, 6.0, (_ROWS, 1, self.features[ACTION]["shape"][0])))
        batch[ACTION] = torch.from_numpy(0.5 * waves).float()
        for key, deltas in self.policy.delta_indices.items():
            batch[f"{key}_is_pad"] = torch.zeros(_ROWS, len(deltas), dtype=torch.bool)
        for key in self.policy.columns:
            batch[key] = torch.zeros(_ROWS, dtype=torch.int64)
        return batch

    def act(self, policy: Any = None, rows: slice = slice(None)) -> np.ndarray:
        """Returns the actions for the random observations, with the same noise each time."""
        generators = [torch.Generator().manual_seed(row) for row in range(_ROWS)][rows]
        return (policy or self.policy).act(
            {key: value[rows] for key, value in self.observation().items()}, generators
        )


@contract()
def made(checked: CheckedPolicy) -> str:
    """It is made for the task's cameras, joints and actions, of a configuration of defaults."""
    policy = checked.policy
    require(policies.summary(checked.name), "Add summary='…' to POLICIES.add: a line for listings.")
    require(policy.n_params > 0, "It has no parameters. Make its layers in __init__.")
    return f"{policy.n_params:,} parameters"


@contract("made")
def acts(checked: CheckedPolicy) -> str:
    """It returns a finite chunk of actions for each environment."""
    actions, size = checked.act(), checked.features[ACTION]["shape"][0]
    wanted = (_ROWS, checked.policy.n_action_steps, size)
    require(actions.shape == wanted, f"act returned the shape {actions.shape}; it must be {wanted}.")
    require(np.isfinite(actions).all(), "act returned actions that are not finite.")
    return f"{wanted[1]} actions of {size} numbers"


@contract("acts")
def repeatable(checked: CheckedPolicy) -> str:
    """Its generators are the only noise: the same observation gives the same actions."""
    torch.manual_seed(1)
    first = checked.act()
    torch.manual_seed(2)
    require(
        np.array_equal(first, checked.act()),
        "act gave two answers for one observation and one seed. Keep nothing between calls, and draw noise "
        "from torch's global generator.",
    )
    return "bit-identical"


@contract("acts")
def independent(checked: CheckedPolicy) -> str:
    """An environment's actions do not depend on its neighbours."""
    alone = [checked.act(rows=slice(row, row + 1)) for row in range(_ROWS)]
    require(
        np.array_equal(checked.act(), np.concatenate(alone)),
        "act gave other actions for one observation than for the same beside others. Compute each row of a "
        "batch from that row alone.",
    )
    return f"1 and {_ROWS} environments"


@contract("acts")
def saved_and_loaded(checked: CheckedPolicy) -> str:
    """Saved and loaded, its actions are bit-identical; the folder has JSON and safetensors alone."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "checkpoint"
        checked.policy.save(path)
        suffixes = {file.suffix for file in path.rglob("*") if file.is_file()}
        require(suffixes <= {".json", ".safetensors"}, f"save wrote {sorted(suffixes)}: no pickle, please.")
        loaded = policies.load(path)
    require(
        np.array_equal(checked.act(), checked.act(loaded)),
        "The loaded policy acts differently. Keep what it learns in parameters and buffers, and its sizes in "
        "the configuration.",
    )
    return "bit-identical"


@contract("made")
def learns(checked: CheckedPolicy) -> str:
    """It learns from one batch: in 100 steps of Adam the loss falls by 15 % or more."""
    torch.manual_seed(0)
    policy = checked.create()
    objective, batch = policy.objective(), checked.batch()
    policy.begin_training()
    optimizer = torch.optim.Adam(policy.model.parameters(), _LEARNING_RATE)
    losses = []
    for _ in range(_STEPS):
        optimizer.zero_grad()
        loss, _terms = objective(batch)
        loss.backward()
        grads = [each.grad for each in policy.model.parameters() if each.grad is not None]
        require(all(bool(torch.isfinite(grad).all()) for grad in grads), "A gradient is not finite.")
        optimizer.step()
        losses.append(loss.item())
    first, last = float(np.mean(losses[:5])), float(np.mean(losses[-10:]))
    require(
        last < _LEARNED * first,
        f"The loss of one batch of {_ROWS} fell from {first:.3g} to {last:.3g} only in {_STEPS} steps. Check "
        "that compute_loss compares the predicted chunk with batch['action'], and that its graph reaches "
        "every layer.",
    )
    return f"loss {first:.3g} to {last:.3g}"


POLICY_CONTRACTS: tuple[Contract[CheckedPolicy], ...] = (
    made, acts, repeatable, independent, saved_and_loaded, learns,
)  # fmt: skip
