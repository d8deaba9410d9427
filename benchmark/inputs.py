"""What a policy looks at: how far its actions move when one of its inputs is that of another episode.

A policy that has learned its demonstrations by heart tells them apart by what no new episode has, such as the
joints' first positions, and one that does not read has the same actions for every instruction. Neither is
seen in a success rate. The measure is permutation importance (Breiman 2001, doi.org/10.1023/A:1010933404324)
of actions in place of a loss, so it needs no demonstrations.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmark.runner import actor_of
from envs.core.errors import ConfigError
from envs.core.observation_keys import IMAGE_PREFIX
from envs.rollout import rollout

if TYPE_CHECKING:
    import torch

    from benchmark.runner import EvaluatedEnv
    from policies.base import Observation, Policy

type _Noise = "Sequence[torch.Tensor] | None"
"""States of the episodes' generators; None for a policy that is given none."""

INSTRUCTION = "task"
"""Key of the instructions in an observation."""

ALL_IMAGES = "all images"

LEAST_EPISODES = 4
"""Episodes below which another episode's input says little."""

OTHERS = 3
"""Other episodes whose input each episode is given, one after the other."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Call:
    """How far the actions of one call of the policy move, in the mean over episodes.

    Attributes:
        step: Control step of the call, counted from 0.
        moved: Mean distance of the actions, in the actions' unit, by input.
        moved_by_all: The same with all inputs of another episode, the instruction apart.
    """

    step: int
    moved: Mapping[str, float]
    moved_by_all: float

    def share(self, name: str) -> float:
        """Returns how far an input moves the actions, of how far all do; NaN where nothing moves them."""
        return self.moved[name] / self.moved_by_all if self.moved_by_all else float("nan")


class _Enough(Exception):  # noqa: N818 - no error
    """All calls are measured, so the episodes need not end."""


class _Watched:
    """A policy whose first calls are measured; in everything else it is the policy.

    Args:
        policy: The policy.
        count: Episodes that run together.
        most: Calls to measure.
        others: Instructions of other tasks.
    """

    def __init__(self, policy: "Policy", count: int, most: int, others: Sequence[str]) -> None:
        self._policy, self._count, self._most, self._others = policy, count, most, others
        self.calls: list[Call] = []

    def __getattr__(self, name: str) -> Any:
        return getattr(self._policy, name)

    def act(
        self, observation: "Observation", generators: "Sequence[torch.Generator] | None" = None
    ) -> np.ndarray:
        """Returns the policy's actions, after having asked it with others' inputs."""
        if len(self.calls) == self._most or len(next(iter(observation.values()))) < self._count:
            raise _Enough
        noise = None if generators is None else [generator.get_state() for generator in generators]
        own = np.asarray(self._policy.act(observation, generators))
        seen = [key for key in observation if key != INSTRUCTION]
        images = [key for key in seen if key.startswith(IMAGE_PREFIX)]
        exchanged = {key.removeprefix("observation."): [key] for key in seen}
        if len(images) > 1:
            exchanged[ALL_IMAGES] = images
        if self._others and INSTRUCTION in observation:
            exchanged["instruction"] = [INSTRUCTION]
        moved = {name: self._moved(own, observation, keys, noise) for name, keys in exchanged.items()}
        step = len(self.calls) * self._policy.n_action_steps
        by_all = self._moved(own, observation, seen, noise)
        self.calls.append(Call(step=step, moved=moved, moved_by_all=by_all))
        return own

    def _moved(
        self, own: np.ndarray, observation: "Observation", keys: Sequence[str], noise: "_Noise"
    ) -> float:
        """Returns how far the actions are from the own ones when some inputs are of another episode."""
        distances = []
        for shift in range(1, OTHERS + 1):
            others = {key: self._of_another(key, observation[key], shift) for key in keys}
            actions = self._policy.act({**observation, **others}, _generators(noise))
            distances.append(np.abs(np.asarray(actions) - own).mean())
        return float(np.mean(distances))

    def _of_another(self, key: str, values: Any, shift: int) -> Any:
        """Returns an input of the episode that comes ``shift`` later, or another task's instruction."""
        values = np.asarray(values)
        if key != INSTRUCTION:
            return np.roll(values, shift, axis=0)
        texts = [self._others[(shift + number) % len(self._others)] for number in range(len(values))]
        return texts if values.ndim == 1 else np.repeat(np.array(texts)[:, None], values.shape[1], axis=1)


def input_shares(
    policy: "Policy", env: "EvaluatedEnv", *, calls: int, instructions: Sequence[str] = (), seed: int = 0
) -> list[Call]:
    """Returns how far each input moves the actions of a policy's first calls.

    The first episodes of the environment's split run together, as the policy acts; measuring ends when one of
    them does. State and images are those of another episode of the task.

    Args:
        policy: The policy.
        env: The environment.
        calls: Calls to measure, at most.
        instructions: Those of other tasks, which stand in for the episode's own; without any it is kept.
        seed: The protocol's seed.

    Raises:
        ConfigError: There are fewer than :data:`LEAST_EPISODES` episodes, or the split has not as many.
    """
    if env.num_envs > (there := len(env.split_indices)):
        raise ConfigError(
            f"The split has {there:,} episodes, given episodes={env.num_envs}. Give {there} or fewer."
        )
    if env.num_envs < LEAST_EPISODES:
        raise ConfigError(
            f"episodes={env.num_envs} are too few to exchange inputs. Give {LEAST_EPISODES} or more, as in "
            "episodes=32."
        )
    watched = _Watched(policy, env.num_envs, calls, instructions)
    actor: Any = actor_of(watched, env, seed, "inputs")  # pyright: ignore[reportArgumentType]
    try:
        for _ in rollout(env, actor, env.split_indices[: env.num_envs].tolist()):
            pass
    except _Enough:
        pass
    return watched.calls


def _generators(noise: "_Noise") -> "list[torch.Generator] | None":
    """Returns generators that give an episode's noise once more."""
    import torch

    if noise is None:
        return None
    generators = [torch.Generator() for _ in noise]
    for generator, state in zip(generators, noise, strict=True):
        generator.set_state(state)
    return generators
