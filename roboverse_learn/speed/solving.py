"""How soon PPO solves PickCube: training in slices, with a test on unseen episodes after each."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from envs.spec import EnvSpec
from envs.torch_env import TorchVectorEnv
from policies.ppo.config import PpoConfig
from roboverse_learn.training.config import TrainConfig

TASK = "PickCube"
SUCCESS_GOAL, SECONDS_GOAL = 0.95, 60.0
TEST_EPISODES = 1000
NUM_SLICES = 8
LEARNING_RATE, GRAD_CLIP = 3e-4, 1.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Solved:
    """How soon PPO solved the task.

    Attributes:
        backend: Whose PPO.
        seed: Of the training.
        num_envs: Environments.
        reached_s: Seconds of training after which 95 % of the test episodes were solved; None if that
            never was so.
        curve: After each slice: seconds of training, environment steps, share of solved test episodes.
        test_episodes: Their number.
    """

    backend: str
    seed: int
    num_envs: int
    reached_s: float | None
    curve: tuple[tuple[float, int, float], ...]
    test_episodes: int

    def __str__(self) -> str:
        seconds, steps, success = self.curve[-1]
        reached = "95 % never reached" if self.reached_s is None else f"95 % after {self.reached_s:.1f} s"
        return (
            f"{TASK} by PPO of {self.backend}, {self.num_envs} worlds, seed {self.seed}: {reached} (goal ≤ "
            f"{SECONDS_GOAL:.0f} s on a GPU); {100 * success:.1f} % of {self.test_episodes} test episodes "
            f"after {seconds:.1f} s and {steps:,} steps"
        )


def solve(
    config: PpoConfig,
    device: str,
    seconds: float,
    folder: Path,
    seed: int = 0,
    *,
    lr: float = LEARNING_RATE,
) -> Solved:
    """Trains PPO from nothing, in slices, until it solves 95 % of the test episodes or its time is over.

    Test episodes are of the other split, one each, without the noise of exploration. What is not training
    is left out of the seconds: tests, building the scene, kernels of the first steps.

    Args:
        config: Settings of PPO.
        device: Torch device, or ``auto``.
        seconds: How long at most.
        folder: Where curves and checkpoints go.
        seed: Of the training.
        lr: Learning rate.
    """
    import policies
    from roboverse_learn.training.rl.ppo import learner

    agent = {"substeps": config.substeps, "expert_starts": config.expert_starts}
    env = make_env(config.num_envs, device, seed=seed, **agent)
    test = make_env(min(config.num_envs, TEST_EPISODES), device, split="test")
    curve: list[tuple[float, int, float]] = []
    reached = None
    try:
        for each in (env, test):
            each.step(torch.zeros(each.num_envs, each.action_size, device=each.device))
        while reached is None and (not curve or curve[-1][0] < seconds):
            train = TrainConfig(
                steps=10**12,
                lr=lr,
                grad_clip=GRAD_CLIP,
                save_every=10**12,
                log_every=config.rollout_size,
                time_limit_s=(len(curve) + 1) * seconds / NUM_SLICES,
            )
            trained = learner.train(config, env, train, folder, TASK, seed=seed)
            success = success_on(test, policies.load(folder, str(env.device)))
            curve.append((trained.elapsed_s, trained.steps, success))
            reached = trained.elapsed_s if success >= SUCCESS_GOAL else None
    finally:
        env.close()
        test.close()
    return Solved(
        backend=config.backend,
        seed=seed,
        num_envs=config.num_envs,
        reached_s=reached,
        curve=tuple(curve),
        test_episodes=test.num_envs,
    )


@torch.no_grad()
def success_on(env: TorchVectorEnv, policy: Any) -> float:
    """Runs one episode in each environment without noise; returns the share that is solved."""
    env.seed(0)
    seen = env.reset()
    over = torch.zeros(env.num_envs, dtype=torch.bool, device=env.device)
    solved = over.clone()
    for _ in range(env.max_episode_steps):
        step = env.step(policy.model(seen))
        solved |= step.success & ~over
        over |= step.terminated | step.truncated
        seen = step.obs
    return float(solved.float().mean())


def make_env(
    num_envs: int, device: str, *, split: str = "train", seed: int = 0, **options: Any
) -> TorchVectorEnv:
    """Makes the env that is measured; ``options`` are those of the env."""
    spec = EnvSpec(task=TASK, simulator="mujoco_warp", simulator_settings={"device": device})
    return spec.make_torch(num_envs, split=split, seed=seed, **options)
