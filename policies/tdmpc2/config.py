"""Settings of TD-MPC2."""

from dataclasses import dataclass
from typing import Literal

from envs.core.errors import PolicyError
from envs.core.ranges import check_ranges
from policies.base import listed

ModelSize = Literal[1, 5, 19, 48, 317]
Observed = Literal["state", "pixels"]


@dataclass(frozen=True, kw_only=True, slots=True)
class Architecture:
    """Widths and depths of a model size.

    Attributes:
        enc_dim: Width of the encoder.
        mlp_dim: Width of dynamics, reward, policy prior and Q.
        latent_dim: Size of the latent state.
        num_enc_layers: Layers of the encoder.
        num_q: Members of the Q ensemble.
    """

    enc_dim: int
    mlp_dim: int
    latent_dim: int
    num_enc_layers: int
    num_q: int = 5


ARCHITECTURES: dict[int, Architecture] = {
    1: Architecture(enc_dim=256, mlp_dim=384, latent_dim=128, num_enc_layers=2, num_q=2),
    5: Architecture(enc_dim=256, mlp_dim=512, latent_dim=512, num_enc_layers=2),
    19: Architecture(enc_dim=1024, mlp_dim=1024, latent_dim=768, num_enc_layers=3),
    48: Architecture(enc_dim=1792, mlp_dim=1792, latent_dim=768, num_enc_layers=4),
    317: Architecture(enc_dim=4096, mlp_dim=4096, latent_dim=1376, num_enc_layers=5, num_q=8),
}
"""Parameters in millions to architecture, as published (arXiv:2310.16828, appendix H, and its code)."""

LARGE_ACTION_SIZE, LARGE_ACTION_ITERATIONS = 20, 2
"""From so many action dimensions on, planning takes so many iterations more (the authors' heuristic)."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Tdmpc2Config:
    """TD-MPC2, arXiv:2310.16828; the defaults are those of its table 8 and of the authors' code.

    Attributes:
        tasks: Further tasks that one model learns together with the run's ``task``, as in
            policy.tasks=[humanoid/stand,humanoid/run]; num_envs are divided among all of them.
        observation: What it sees: the state of the task, or pixels, the images of the cameras of the run,
            64 pixels a side (cameras=[front] image_size=64).
        num_frames: Frames of an observation of pixels, the last ones.
        model_size: Millions of parameters: 1, 5, 19, 48 or 317; 5 is that of all single-task results.
        enc_dim: Width of the encoder; 0 takes that of the model size.
        mlp_dim: Width of all other networks; 0 takes that of the model size.
        latent_dim: Size of the latent state; 0 takes that of the model size.
        num_enc_layers: Layers of the encoder; 0 takes that of the model size.
        num_q: Members of the Q ensemble; 0 takes that of the model size.
        num_channels: Channels of the pixel encoder.
        task_dim: Size of the embedding of a task, where there are several.
        simnorm_dim: Entries of one simplex of the latent state.
        dropout: Dropout in the first layer of every Q.
        num_bins: Bins of the discrete regression of rewards and values.
        symlog_limit: The bins range from minus this to this, in symlog space.
        log_std_min: Lowest logarithm of the policy prior's standard deviation.
        log_std_max: Highest.
        horizon: Steps of a latent rollout, in planning and in learning.
        iterations: Iterations of MPPI; two more where there are 20 action dimensions or more.
        num_samples: Action sequences per iteration.
        num_elites: Best sequences, which the next mean and deviation come from.
        num_pi_trajs: Sequences of each iteration that follow the policy prior.
        min_std: Smallest deviation of the sampled actions.
        max_std: Largest, and that of the first iteration.
        temperature: Inverse temperature of the elites' weights.
        plan: Plan when acting; false takes the mean action of the policy prior.
        batch_size: Sequences per update.
        lr: Learning rate of Adam.
        enc_lr_scale: Learning rate of the encoder, as a share of ``lr``.
        grad_clip_norm: Largest norm of a gradient.
        tau: Share of the weights that the target ensemble takes over per update, and of the percentiles
            that the running scale does.
        rho: Weight of each step of a rollout, relative to the one before.
        consistency_coef: Weight of the latent prediction.
        reward_coef: Weight of the reward prediction.
        value_coef: Weight of the value prediction.
        termination_coef: Weight of the prediction of an episode's end.
        entropy_coef: Weight of the entropy of the policy prior.
        discount_denom: The discount is 1 - this / episode length, within the two limits below.
        discount_min: Lowest discount.
        discount_max: Highest discount.
        episodic: Episodes end by failure or success before their time: learn when, and do not count on
            rewards after it (the authors' code of 2025). False bootstraps from every state.
        num_envs: Environments that are stepped at once; the published results have one.
        update_ratio: Updates per environment step.
        seed_steps: Environment steps with random actions before the first update; 0 takes the length of
            five episodes, and 1,000 at least, of every task.
        buffer_size: Environment steps that the replay buffer holds; of pixels a step takes 12 kB a camera.
        save_replay: Write the replay buffer into the checkpoint that a run is resumed from. Without it,
            a resumed run fills it again before it continues.
        compile: Compile updates and planning; None compiles on a GPU only.
        cuda_graphs: Record an update as one CUDA graph; None does so on a GPU.
    """

    tasks: tuple[str, ...] = ()
    observation: Observed = "state"
    num_frames: int = 3
    model_size: ModelSize = 5
    enc_dim: int = 0
    mlp_dim: int = 0
    latent_dim: int = 0
    num_enc_layers: int = 0
    num_q: int = 0
    num_channels: int = 32
    task_dim: int = 96
    simnorm_dim: int = 8
    dropout: float = 0.01
    num_bins: int = 101
    symlog_limit: float = 10.0
    log_std_min: float = -10.0
    log_std_max: float = 2.0
    horizon: int = 3
    iterations: int = 6
    num_samples: int = 512
    num_elites: int = 64
    num_pi_trajs: int = 24
    min_std: float = 0.05
    max_std: float = 2.0
    temperature: float = 0.5
    plan: bool = True
    batch_size: int = 256
    lr: float = 3e-4
    enc_lr_scale: float = 0.3
    grad_clip_norm: float = 20.0
    tau: float = 0.01
    rho: float = 0.5
    consistency_coef: float = 20.0
    reward_coef: float = 0.1
    value_coef: float = 0.1
    termination_coef: float = 1.0
    entropy_coef: float = 1e-4
    discount_denom: float = 5.0
    discount_min: float = 0.95
    discount_max: float = 0.995
    episodic: bool = True
    num_envs: int = 16
    update_ratio: float = 1.0
    seed_steps: int = 0
    buffer_size: int = 1_000_000
    save_replay: bool = True
    compile: bool | None = None
    cuda_graphs: bool | None = None

    def __post_init__(self) -> None:
        if self.model_size not in ARCHITECTURES:
            raise PolicyError(
                f"policy.model_size={self.model_size} is none of the published sizes: "
                f"{', '.join(map(str, ARCHITECTURES))} (millions of parameters)."
            )
        above_0 = ("num_channels", "simnorm_dim", "horizon", "iterations", "num_elites", "batch_size",
                   "num_frames", "lr", "update_ratio", "num_envs", "temperature", "min_std")  # fmt: skip
        from_0 = ("enc_dim", "mlp_dim", "latent_dim", "num_enc_layers", "num_q", "seed_steps")
        check_ranges(self, "policy.", above_0=above_0, from_0=from_0, error=PolicyError)
        self._check_networks()
        self._check_planning()
        self._check_tasks()

    def _check_networks(self) -> None:
        if self.architecture.latent_dim % self.simnorm_dim:
            raise PolicyError(
                f"policy.latent_dim={self.architecture.latent_dim} must be a multiple of policy.simnorm_dim="
                f"{self.simnorm_dim}."
            )
        if self.architecture.num_q < 2:
            raise PolicyError(f"policy.num_q must be at least 2, given {self.num_q}: targets take pairs.")
        if self.num_bins < 3:
            raise PolicyError(f"policy.num_bins must be at least 3, given {self.num_bins}.")

    def _check_planning(self) -> None:
        if not (0 <= self.num_pi_trajs <= self.num_samples and self.num_elites <= self.num_samples):
            raise PolicyError(
                f"policy.num_pi_trajs={self.num_pi_trajs} and policy.num_elites={self.num_elites} can be at "
                f"most policy.num_samples={self.num_samples}."
            )
        if not self.min_std <= self.max_std:
            raise PolicyError(f"policy.min_std={self.min_std} must be at most policy.max_std={self.max_std}.")
        if not 0.0 <= self.discount_min <= self.discount_max < 1.0:
            raise PolicyError(
                f"policy.discount_min={self.discount_min} and policy.discount_max={self.discount_max} must "
                "be from 0 to below 1, the lower first."
            )

    def _check_tasks(self) -> None:
        if not self.tasks:
            return
        if self.observation == "pixels":
            raise PolicyError(
                f"policy.tasks={listed(self.tasks)} are learned together from states, and "
                "policy.observation=pixels was given. Leave it out, or learn one task from its images, "
                "without policy.tasks."
            )
        if self.num_envs < 1 + len(self.tasks):
            raise PolicyError(
                f"policy.num_envs={self.num_envs} is less than one environment for each of the "
                f"{1 + len(self.tasks)} tasks, task= and policy.tasks={listed(self.tasks)}. Take "
                f"policy.num_envs={1 + len(self.tasks)} at least."
            )

    @property
    def architecture(self) -> Architecture:
        """The widths and depths of this model: those of its size, but for those that were given."""
        size = ARCHITECTURES[self.model_size]
        return Architecture(
            enc_dim=self.enc_dim or size.enc_dim,
            mlp_dim=self.mlp_dim or size.mlp_dim,
            latent_dim=self.latent_dim or size.latent_dim,
            num_enc_layers=self.num_enc_layers or size.num_enc_layers,
            num_q=self.num_q or size.num_q,
        )

    def discount(self, episode_length: int) -> float:
        """Returns the discount of a task: the authors' heuristic, which grows with the episode's length."""
        fraction = episode_length / self.discount_denom
        return min(max((fraction - 1.0) / fraction, self.discount_min), self.discount_max)

    def planning_iterations(self, action_size: int) -> int:
        """Returns the iterations of MPPI for actions of so many dimensions."""
        return self.iterations + LARGE_ACTION_ITERATIONS * (action_size >= LARGE_ACTION_SIZE)

    def first_steps(self, *episode_lengths: int) -> int:
        """Returns the environment steps with random actions, of tasks with episodes of these lengths."""
        return self.seed_steps or sum(max(1000, 5 * length) for length in episode_lengths)
