"""Evaluation of an ACT checkpoint against ``lerobot-eval``: ``roboverse speed evaluation``.

Both run the policy of ``preset=quick`` on the same episodes of one batched env, on one core, without videos.
It is untrained, because then every episode lasts as long as the task allows. LeRobot gives its policy the
observation of every step, so every image is rendered. The clock is that of the process: on one core it is the
time that passes, less what other programs take.
"""

import contextlib
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from envs.core.errors import SimulatorError
from roboverse_learn.speed.harness import Goal, Measurement, Program, part

TASK, LEVEL, SPLIT, SEED = "PickCube", 0, "test", 0
GOAL = Goal(5.0)


@dataclass(frozen=True, kw_only=True, slots=True)
class Evaluation(Program):
    """Compares the evaluation of an ACT checkpoint to lerobot-eval.

    Attributes:
        parts: act.
        num_episodes: Episodes of one evaluation, all at once.
        turns: How often each side is timed.
    """

    one_core: ClassVar = True
    environment: ClassVar = {"HF_HUB_OFFLINE": "1", "TQDM_DISABLE": "1"}

    num_episodes: int = 4
    turns: int = 3

    @part("act")
    def act(self) -> Measurement:
        """Compares both, in seconds per episode; the checkpoint is loaded and the env built beforehand."""
        import torch
        from lerobot.envs.factory import make_env_pre_post_processors
        from lerobot.scripts.lerobot_eval import eval_policy

        from benchmark.runner import evaluate_cell
        from envs.lerobot.env import RoboVerseEnvConfig

        size, cameras, policy = _quick_policy()
        env_config = RoboVerseEnvConfig(task=TASK, level=LEVEL, split=SPLIT, image_size=size, cameras=cameras)
        env: Any
        (env,) = env_config.create_envs(self.num_episodes)[env_config.type].values()
        before, after = make_env_pre_post_processors(env_cfg=env_config, policy_cfg=policy.model.config)
        steps = (before, after, policy.preprocessor, policy.postprocessor)
        seeds = list(range(SEED, SEED + self.num_episodes))
        env.reset(seed=seeds)  # as LeRobot's side does
        episodes = env.episodes.tolist()
        ran: dict[str, list[int]] = {}

        @torch.no_grad()
        def theirs() -> None:
            found = eval_policy(env, policy.model, *steps, self.num_episodes, start_seed=SEED)
            ran["LeRobot"] = [episode["seed"] for episode in found["per_episode"]]

        def ours() -> None:
            records = evaluate_cell(
                policy, env, episodes, split=SPLIT, level=LEVEL, seed=SEED, policy_name="act"
            )
            ran["ours"] = [record.episode for record in records if record.length >= 50]

        def check() -> None:
            if ran != {"LeRobot": seeds, "ours": episodes}:
                raise SimulatorError("The two evaluations are not of the same episodes: do not compare them.")

        name = f"evaluation of ACT, {size}×{size}, LeRobot / ours"
        how: Any = {"units": self.num_episodes, "clock": time.process_time, "after": check}
        with contextlib.closing(env):
            return self.compare(name, ours, theirs, GOAL, **how)


def _quick_policy() -> tuple[int, tuple[str, ...], Any]:
    """Returns image size, cameras and the untrained policy of ``preset=quick``, saved and loaded again."""
    import policies
    from roboverse_learn.commands.dataset_layout import dataset_layout
    from roboverse_learn.config.compose import compose
    from roboverse_learn.training.imitation.estimate import plain_stats

    config = compose("train", ["policy=act", f"task={TASK}", "preset=quick"])
    features, _, _ = dataset_layout(config)
    policy = policies.create("act", features, plain_stats(features), config.policy)
    with tempfile.TemporaryDirectory() as folder:
        policy.save(Path(folder) / "pretrained_model")
        return config.env.image_size, config.env.cameras, policies.load(folder)
