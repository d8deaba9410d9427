"""Settings of proximal policy optimization."""

from dataclasses import dataclass
from typing import ClassVar, Literal

from envs.core.errors import PolicyError
from envs.core.ranges import check_ranges

Backend = Literal["rsl_rl", "sb3", "torchrl"]
BACKENDS = ("rsl_rl", "sb3", "torchrl")


@dataclass(frozen=True, kw_only=True, slots=True)
class PpoConfig:
    """Proximal policy optimization, arXiv:1707.06347, with one meaning in all three libraries.

    Learning rate, largest gradient norm, environment steps and time limit are those of ``train``. The
    defaults are after ManiSkill 3's PPO for states (``examples/baselines/ppo``, Apache-2.0): short rollouts
    of many environments and a near horizon, which a dense reward allows.

    Attributes:
        backend: Whose implementation: ``rsl_rl``, ``sb3`` (Stable-Baselines3) or ``torchrl``.
        observation: What it sees: the state of the task, or pixels, the images of the cameras of the run
            beside the robot's own joint positions (cameras=[front,wrist] image_size=64).
        num_frames: Frames of an observation of pixels, the last ones.
        num_envs: Environments.
        num_steps: Steps of every environment between two updates.
        num_epochs: Passes over a rollout.
        num_minibatches: Parts of a rollout, each a gradient step.
        gamma: Discount.
        lam: Of generalized advantage estimation, arXiv:1506.02438.
        clip: Clipping range of the probability ratio.
        value_coef: Weight of the squared error of the value, which is not clipped.
        entropy_coef: Weight of the entropy.
        schedule: ``adaptive`` raises and lowers the learning rate so that the updates of a rollout change the
            policy by about ``desired_kl`` (rsl_rl after every gradient step, the others after every rollout),
            ``fixed`` keeps it, and ``linear`` lowers it evenly to 0 at the end of the run. Images need one of
            the last two: while the first policy hardly moves, ``adaptive`` raises it to 0.01, at which no
            unit of their encoder is left alive.
        desired_kl: Mean Kullback-Leibler divergence of new from old policy, nats.
        hidden_dims: Widths of the hidden layers of policy and value.
        activation: Between the layers: ``elu``, ``tanh`` or ``relu``.
        init_std: First standard deviation of the actions, which does not depend on the state.
        stagger: Let the first episodes end at different times.
        max_episode_steps: Control steps of a training episode; null for the task's.
        substeps: Physics steps per control step in training; null for the task's. Tests always take the
            task's.
        expert_starts: Share of the training episodes that begin somewhere on the way of the task's expert.
    """

    younger: ClassVar[tuple[str, ...]] = ("observation", "num_frames")
    """Keys that are no part of a run's name at their defaults: older runs, made without them, keep theirs."""

    backend: Backend = "rsl_rl"
    observation: Literal["state", "pixels"] = "state"
    num_frames: int = 1
    num_envs: int = 4096
    num_steps: int = 8
    num_epochs: int = 5
    num_minibatches: int = 8
    gamma: float = 0.9
    lam: float = 0.9
    clip: float = 0.2
    value_coef: float = 0.5
    entropy_coef: float = 0.0
    schedule: Literal["adaptive", "fixed", "linear"] = "adaptive"
    desired_kl: float = 0.016
    hidden_dims: tuple[int, ...] = (256, 256, 256)
    activation: Literal["elu", "tanh", "relu"] = "elu"
    init_std: float = 0.6
    stagger: bool = True
    max_episode_steps: int | None = None
    substeps: int | None = None
    expert_starts: float = 0.0

    def __post_init__(self) -> None:
        if self.backend not in BACKENDS:
            raise PolicyError(f"policy.backend must be one of {', '.join(BACKENDS)}, given {self.backend!r}.")
        if self.backend == "sb3" and self.observation == "pixels":
            raise PolicyError(
                "policy.backend=sb3 keeps rollouts on the host as floats, which images are too large for. "
                "With policy.observation=pixels take policy.backend=rsl_rl or torchrl."
            )
        above_0 = ("num_envs", "num_steps", "num_epochs", "num_minibatches", "clip", "desired_kl", "init_std",
                   "num_frames")  # fmt: skip
        check_ranges(self, "policy.", above_0=above_0, error=PolicyError)
        for name in ("gamma", "lam", "expert_starts"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise PolicyError(f"policy.{name} must be from 0 to 1, given {getattr(self, name)}.")
        if self.rollout_size % self.num_minibatches:
            raise PolicyError(
                f"policy.num_minibatches={self.num_minibatches} does not divide a rollout of "
                f"policy.num_envs={self.num_envs} × policy.num_steps={self.num_steps} = "
                f"{self.rollout_size} steps."
            )
        if not self.hidden_dims or min(self.hidden_dims) < 1:
            raise PolicyError(f"policy.hidden_dims needs a width per layer, given {list(self.hidden_dims)}.")

    @property
    def rollout_size(self) -> int:
        """Environment steps between two updates."""
        return self.num_envs * self.num_steps
