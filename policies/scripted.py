"""Policies that need no training: baselines of a benchmark, and stand-ins in tests."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar, Literal, Self

import numpy as np
import torch
from numpy.typing import ArrayLike

from envs.core.atomic import atomic_directory
from envs.core.errors import PolicyError
from policies.base import Observation
from policies.checkpoint import read_json

_STATE = "observation.state"
_FILE = "scripted.json"


class ScriptedPolicy:
    """A policy that is a rule.

    Args:
        low: Lowest actions (action_dim,).
        high: Highest actions (action_dim,).
        n_action_steps: Actions that one call returns.

    Raises:
        PolicyError: if the limits do not fit each other.
    """

    name: ClassVar[str]
    actions_of: ClassVar[Literal["task", "rl"]] = "task"
    task: str = ""
    n_obs_steps = 1
    batch_invariant = True

    def __init__(self, low: ArrayLike, high: ArrayLike, n_action_steps: int = 1) -> None:
        self.low = np.asarray(low, np.float32)
        self.high = np.asarray(high, np.float32)
        self.n_action_steps = n_action_steps
        if self.low.ndim != 1 or self.low.shape != self.high.shape or not (self.low <= self.high).all():
            raise PolicyError(
                f"The limits of the actions must be two vectors of one size, low below high; "
                f"given low={self.low.tolist()} and high={self.high.tolist()}."
            )
        if n_action_steps < 1:
            raise PolicyError(f"n_action_steps must be at least 1, given {n_action_steps}.")

    def act(
        self, observation: Observation, generators: Sequence[torch.Generator] | None = None
    ) -> np.ndarray:
        """Chooses the next actions; see :meth:`policies.base.Policy.act`."""
        if _STATE not in observation:
            given = ", ".join(sorted(observation)) or "nothing"
            raise PolicyError(
                f"The observation has no '{_STATE}', which policy '{self.name}' needs. Given: {given}."
            )
        state = np.asarray(observation[_STATE], np.float32)
        return self._actions(state, generators)

    def _actions(self, state: np.ndarray, generators: Sequence[torch.Generator] | None) -> np.ndarray:
        raise NotImplementedError

    def _shape(self, n: int) -> tuple[int, int, int]:
        return n, self.n_action_steps, len(self.low)

    def save(self, directory: str | Path) -> None:
        """Writes the rule and its limits."""
        content = {
            "type": self.name,
            "low": self.low.tolist(),
            "high": self.high.tolist(),
            "n_action_steps": self.n_action_steps,
        }
        with atomic_directory(directory) as staging:
            (staging / _FILE).write_text(json.dumps(content, indent=2), encoding="utf-8")

    @classmethod
    def load(cls, directory: str | Path, device: str = "cpu") -> Self:
        """Reads what :meth:`save` wrote; see :meth:`policies.base.Policy.load`."""
        path = Path(directory) / _FILE
        content = read_json(path)
        if content.get("type") != cls.name:
            raise PolicyError(f"'{path}' is of policy '{content.get('type')}', not of '{cls.name}'.")
        try:
            return cls(content["low"], content["high"], content["n_action_steps"])
        except (KeyError, TypeError) as error:
            raise PolicyError(f"'{path}' lacks or has a wrong {error}. Write it again.") from error


class ZeroPolicy(ScriptedPolicy):
    """Every action is zero, or the nearest that the limits allow."""

    name = "zero"

    def _actions(self, state: np.ndarray, generators: Sequence[torch.Generator] | None) -> np.ndarray:
        return np.tile(np.clip(np.float32(0.0), self.low, self.high), (*self._shape(len(state))[:2], 1))


class RandomPolicy(ScriptedPolicy):
    """Uniform actions within the limits."""

    name = "random"

    def _actions(self, state: np.ndarray, generators: Sequence[torch.Generator] | None) -> np.ndarray:
        if generators is None or len(generators) != len(state):
            given = "none" if generators is None else len(generators)
            raise PolicyError(
                f"Policy 'random' needs one generator per environment: {len(state)}, given {given}."
            )
        shape = self._shape(1)[1:]
        share = np.stack([torch.rand(shape, generator=generator).numpy() for generator in generators])
        return self.low + share * (self.high - self.low)


class HoldPolicy(ScriptedPolicy):
    """The joint positions of the observation as targets, so that the robot stays where it is."""

    name = "hold"

    def _actions(self, state: np.ndarray, generators: Sequence[torch.Generator] | None) -> np.ndarray:
        if state.shape[1:] != self.low.shape:
            raise PolicyError(
                f"Policy 'hold' needs joint positions of the size of the actions: '{_STATE}' is "
                f"{state.shape}, actions are ({len(self.low)},)."
            )
        held = np.clip(state, self.low, self.high)
        return np.repeat(held[:, None], self.n_action_steps, axis=1)
