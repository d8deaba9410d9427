"""Settings of FastTD3."""

from dataclasses import dataclass

from envs.core.errors import PolicyError
from envs.core.ranges import check_ranges


@dataclass(frozen=True, kw_only=True, slots=True)
class FastTd3Config:
    """FastTD3, arXiv:2505.22642; the defaults are those of the authors' code for HumanoidBench.

    Attributes:
        actor_dim: Width of the actor's first layer; the next are a half and a quarter of it.
        critic_dim: Width of the critic's first layer, likewise.
        layer_norm: Normalize every hidden layer; the authors' results on HumanoidBench do not.
        init_scale: Deviation of the first weights of the actor's last layer.
        num_atoms: Atoms of the distribution of values.
        v_min: Lowest value that it can hold: at most the lowest reward of a step / (1 - discount). Where a
            task's values do not fit, ``mass_at_limits`` of the metrics is far from 0.
        v_max: Highest, likewise.
        clipped_double: Target the critic of two whose value is less; false lets each have its own.
        discount: Discount per step.
        num_steps: Steps whose rewards a target sums before it trusts the critics.
        tau: Share of the weights that the target critic takes over per update.
        lr: Learning rate of AdamW.
        weight_decay: Decoupled weight decay of AdamW.
        target_noise: Deviation of the noise on the actions that targets are computed with.
        target_noise_clip: Largest such noise.
        std_min: Least deviation of the noise to explore with; every environment has its own.
        std_max: Greatest.
        num_envs: Environments that are stepped at once.
        batch_size: Steps per update.
        num_updates: Updates after each step of all environments.
        policy_frequency: The actor is updated with every so manieth update of the critic.
        learning_starts: Steps of all environments before the first update.
        buffer_size: Environment steps that the replay buffer holds: 51,200 of each of 128 environments.
        save_replay: Write the replay buffer into the checkpoint that a run is resumed from: 3 GB for a
            humanoid. Without it, a resumed run collects one batch before it continues learning.
        compile: Compile updates; None compiles on a GPU only.
        cuda_graphs: Record an update as one CUDA graph; None does so on a GPU.
        bf16: Compute updates under autocast; None does so on a GPU.
    """

    actor_dim: int = 512
    critic_dim: int = 1024
    layer_norm: bool = False
    init_scale: float = 0.01
    num_atoms: int = 101
    v_min: float = -250.0
    v_max: float = 250.0
    clipped_double: bool = True
    discount: float = 0.99
    num_steps: int = 1
    tau: float = 0.1
    lr: float = 3e-4
    weight_decay: float = 0.1
    target_noise: float = 0.001
    target_noise_clip: float = 0.5
    std_min: float = 0.001
    std_max: float = 0.4
    num_envs: int = 128
    batch_size: int = 32_768
    num_updates: int = 2
    policy_frequency: int = 2
    learning_starts: int = 10
    buffer_size: int = 6_553_600
    save_replay: bool = False
    compile: bool | None = None
    cuda_graphs: bool | None = None
    bf16: bool | None = None

    def __post_init__(self) -> None:
        above_0 = ("lr", "num_envs", "batch_size", "num_updates", "num_steps", "policy_frequency", "tau",
                   "init_scale")  # fmt: skip
        from_0 = ("weight_decay", "target_noise", "target_noise_clip", "std_min", "learning_starts")
        check_ranges(self, "policy.", above_0=above_0, from_0=from_0, error=PolicyError)
        for name in ("actor_dim", "critic_dim"):
            if getattr(self, name) < 4 or getattr(self, name) % 4:
                raise PolicyError(f"policy.{name} must be a multiple of 4, given {getattr(self, name)}.")
        if self.num_atoms < 2 or not self.v_min < self.v_max:
            raise PolicyError(
                f"policy.num_atoms={self.num_atoms} must be at least 2, and policy.v_min={self.v_min} below "
                f"policy.v_max={self.v_max}."
            )
        if not self.std_min <= self.std_max:
            raise PolicyError(f"policy.std_min={self.std_min} must be at most policy.std_max={self.std_max}.")
        if not 0.0 <= self.discount < 1.0:
            raise PolicyError(f"policy.discount must be from 0 to below 1, given {self.discount}.")
