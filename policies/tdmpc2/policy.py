"""A trained TD-MPC2 behind the interface of every policy."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple, Self, override

import torch
from torch import Tensor
from torch.nn import functional

from envs.core.errors import PolicyError
from policies.base import Observation
from policies.flat_observation import joined, sizes_of
from policies.flat_policy import FlatPolicy
from policies.stacked_images import stacked
from policies.tdmpc2.config import Tdmpc2Config
from policies.tdmpc2.planner import plan, prior_rollout
from policies.tdmpc2.world_model import WorldModel


class TaskSizes(NamedTuple):
    """One of several tasks that a model learns together.

    Attributes:
        observation_size: Entries of an observation.
        action_size: Entries of an action.
        episode_length: Steps of an episode, from which the discount follows.
    """

    observation_size: int
    action_size: int
    episode_length: int


class Tdmpc2Policy(FlatPolicy):
    """TD-MPC2, arXiv:2310.16828, of tasks whose state is observed, or of one of which images are.

    It keeps nothing between calls, so a plan starts from what the policy prior would do, where training
    starts from the plan of the step before; and it values by all members of the ensemble. Of several tasks
    ``task`` says which one it acts in; its observations and actions are those of that task, without padding.

    Attributes:
        episode_length: Steps of an episode, from which the discount follows; of several tasks, the longest.
        several: Sizes of each task by its name, in the order of the model's indices; none of one task alone.
    """

    name: ClassVar[str] = "tdmpc2"

    def __init__(
        self,
        config: Tdmpc2Config,
        model: WorldModel,
        sizes: Mapping[str, int],
        episode_length: int,
        several: Mapping[str, TaskSizes] | None = None,
    ) -> None:
        super().__init__(config, model, sizes)
        self.episode_length = episode_length
        self.several = dict(several or {})
        self.task = next(iter(self.several), "")
        if config.observation == "pixels":
            self.n_obs_steps = config.num_frames

    @classmethod
    def create(
        cls,
        config: Tdmpc2Config,
        sizes: Mapping[str, int],
        action_size: int,
        episode_length: int,
        device: str = "cpu",
        seed: int = 0,
        several: Mapping[str, TaskSizes] | None = None,
    ) -> Self:
        """Makes an untrained policy.

        Args:
            config: Settings.
            sizes: Keys of the observation, in order, and their sizes: of images, pixels a side.
            action_size: Entries of an action, each in [-1, 1].
            episode_length: Steps of an episode.
            device: Torch device.
            seed: Seed of the first weights.
            several: Sizes of each task by its name, where there are several; ``sizes``, of one key,
                ``action_size`` and ``episode_length`` are then the largest of them.
        """
        action_sizes = [task.action_size for task in (several or {}).values()] or [action_size]
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            model = WorldModel(config, _shape(config, sizes), action_sizes)
        return cls(config, model.to(device).eval(), sizes, episode_length, several)

    @property
    @override
    def tasks(self) -> tuple[str, ...]:
        return tuple(self.several) or super().tasks

    @property
    def discounts(self) -> list[float]:
        """The discount of each task, in the order of the model's indices."""
        lengths = [task.episode_length for task in self.several.values()] or [self.episode_length]
        return [self.config.discount(length) for length in lengths]

    @property
    def discount(self) -> float:
        """The discount of the task that it acts in."""
        return self.discounts[self._index or 0]

    @property
    def _index(self) -> int | None:
        """The model's index of the task that it acts in; None where there is one alone."""
        if not self.several:
            return None
        if self.task not in self.several:
            raise PolicyError(
                f"This TD-MPC2 acts in {', '.join(self.several)}, which it learned; its task is "
                f"'{self.task}'. Set policy.task to one of them."
            )
        return list(self.several).index(self.task)

    @property
    def _own(self) -> TaskSizes | None:
        """Sizes of the task that it acts in; None where there is one alone, whose sizes are the model's."""
        index = self._index
        return None if index is None else list(self.several.values())[index]

    @override
    def seen(self, observation: Observation) -> Tensor:
        if self.config.observation == "pixels":
            return stacked(observation, self.sizes, self.n_obs_steps, self.name)
        own = self._own
        if own is None:
            return super().seen(observation)
        seen = joined(observation, dict.fromkeys(self.sizes, own.observation_size), self.name)
        return functional.pad(seen, (0, sum(self.sizes.values()) - own.observation_size))

    @override
    def actions(self, seen: Tensor, generators: Sequence[torch.Generator] | None) -> Tensor:
        index, own = self._index, self._own
        task = None if index is None else torch.full((len(seen), 1), index, device=self.device)
        z = self.model.encode(seen, None if task is None else task[:, 0])
        horizon = self.config.horizon if self.config.plan else 1
        zeros = z.new_zeros(len(z), horizon, 1, self.model.action_size)
        actions = mean = prior_rollout(self.model, z, zeros, task, mean=True).squeeze(2)
        if self.config.plan:
            normal = _normal(generators, self.device)
            planned = plan(self.config, self.model, z, mean, self.discount, normal, task)
            actions = planned.action.clamp(-1.0, 1.0)[:, None]
        return actions[:, 0, : None if own is None else own.action_size]

    @override
    def facts(self) -> dict[str, Any]:
        facts: dict[str, Any] = {
            "action_size": self.model.action_size,
            "episode_length": self.episode_length,
        }
        if self.several:
            facts["tasks"] = {name: sizes._asdict() for name, sizes in self.several.items()}
        return facts

    @classmethod
    @override
    def from_facts(cls, content: Mapping[str, Any], device: str) -> Self:
        facts = {key: int(content[key]) for key in ("action_size", "episode_length")}
        values = {**content["config"], "tasks": tuple(content["config"].get("tasks", ()))}
        config, sizes = Tdmpc2Config(**values), sizes_of(content["observation"])
        several = {str(name): TaskSizes(**sizes_of(task)) for name, task in content.get("tasks", {}).items()}
        return cls.create(config, sizes, device=device, several=several, **facts)


def _shape(config: Tdmpc2Config, sizes: Mapping[str, int]) -> tuple[int, ...]:
    """Returns the shape of an observation: of a vector, or of the frames of all cameras."""
    if config.observation == "state":
        return (sum(sizes.values()),)
    pixels = max(sizes.values())
    return (3 * len(sizes) * config.num_frames, pixels, pixels)


def _normal(generators: Sequence[torch.Generator] | None, device: torch.device) -> Callable[..., Tensor]:
    """Returns a source of normal numbers (n, ...), each row of its environment's generator alone."""
    if generators is None:
        return lambda *shape: torch.randn(*shape, device=device)
    own: list[Any] = []
    for generator in generators:
        seed = int(torch.randint(2**62, (), generator=generator))
        own.append(torch.Generator(device).manual_seed(seed))

    def draw(_num: int, *shape: int) -> Tensor:
        return torch.stack([torch.randn(*shape, generator=generator, device=device) for generator in own])

    return draw
