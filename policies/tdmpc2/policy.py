"""A trained TD-MPC2 behind the interface of every policy."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, Self, override

import torch
from torch import Tensor

from policies.base import Observation
from policies.flat_observation import sizes_of
from policies.flat_policy import FlatPolicy
from policies.stacked_pictures import stacked
from policies.tdmpc2.config import Tdmpc2Config
from policies.tdmpc2.planner import plan, prior_rollout
from policies.tdmpc2.world_model import WorldModel


class Tdmpc2Policy(FlatPolicy):
    """TD-MPC2, arXiv:2310.16828, of one task whose state is observed, or pictures of it.

    It keeps nothing between calls, so a plan starts from what the policy prior would do, where training
    starts from the plan of the step before; and it values by all members of the ensemble.

    Attributes:
        episode_length: Steps of an episode, from which the discount follows.
    """

    name: ClassVar[str] = "tdmpc2"

    def __init__(
        self, config: Tdmpc2Config, model: WorldModel, sizes: Mapping[str, int], episode_length: int
    ) -> None:
        super().__init__(config, model, sizes)
        self.episode_length = episode_length
        self.discount = config.discount(episode_length)
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
    ) -> Self:
        """Makes an untrained policy.

        Args:
            config: Settings.
            sizes: Keys of the observation, in order, and their sizes: of pictures, pixels a side.
            action_size: Entries of an action, each in [-1, 1].
            episode_length: Steps of an episode.
            device: Torch device.
            seed: Seed of the first weights.
        """
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            model = WorldModel(config, _shape(config, sizes), (action_size,))
        return cls(config, model.to(device).eval(), sizes, episode_length)

    @override
    def seen(self, observation: Observation) -> Tensor:
        if self.config.observation == "state":
            return super().seen(observation)
        return stacked(observation, self.sizes, self.n_obs_steps, self.name)

    @override
    def actions(self, seen: Tensor, generators: Sequence[torch.Generator] | None) -> Tensor:
        z = self.model.encode(seen)
        horizon = self.config.horizon if self.config.plan else 1
        zeros = z.new_zeros(len(z), horizon, 1, self.model.action_size)
        mean = prior_rollout(self.model, z, zeros, mean=True).squeeze(2)
        if not self.config.plan:
            return mean[:, 0]
        normal = _normal(generators, self.device)
        return plan(self.config, self.model, z, mean, self.discount, normal).action.clamp(-1.0, 1.0)

    @override
    def facts(self) -> dict[str, Any]:
        return {"action_size": self.model.action_size, "episode_length": self.episode_length}

    @classmethod
    @override
    def from_facts(cls, content: Mapping[str, Any], device: str) -> Self:
        facts = {key: int(content[key]) for key in ("action_size", "episode_length")}
        config, sizes = Tdmpc2Config(**content["config"]), sizes_of(content["observation"])
        return cls.create(config, sizes, device=device, **facts)


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
