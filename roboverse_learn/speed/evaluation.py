"""Evaluation of an ACT checkpoint against ``lerobot-eval``: ``roboverse speed evaluation``.

Both run the policy of ``preset=quick`` on the same episodes of one batched env, on one core, without videos.
It is untrained, because then every episode lasts as long as the task allows. LeRobot gives its policy the
observation of every step, so every image is rendered. The clock is that of the process: on one core it is the
time that passes, less what other programs take.
"""

import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from envs.core.errors import SimulatorError
from roboverse_learn.speed.harness import Goal, Measurement, Settings, in_turns, measurement, program

TASK, LEVEL, SPLIT, SEED, NUM_EPISODES, TURNS = "PickCube", 0, "test", 0, 4, 3
GOAL = Goal(5.0)


def parts(_: Settings) -> Mapping[str, Callable[[], Measurement]]:
    """Returns what is measured."""
    return {"act": measure_evaluation}


def measure_evaluation(num_episodes: int = NUM_EPISODES, turns: int = TURNS) -> Measurement:
    """Compares both, in seconds per episode; the checkpoint is loaded and the env built beforehand.

    Args:
        num_episodes: Episodes of one evaluation, all at once.
        turns: How often each is timed.

    Raises:
        SimulatorError: The two did not run the same episodes.
    """
    import torch
    from lerobot.envs.factory import make_env_pre_post_processors
    from lerobot.scripts.lerobot_eval import eval_policy

    import policies
    from benchmark.runner import evaluate_cell
    from envs.lerobot.env import RoboVerseEnvConfig

    config, policy = _quick_policy()
    with tempfile.TemporaryDirectory() as folder:
        policy.save(Path(folder) / "pretrained_model")
        policy = policies.load(folder)
    env_config = RoboVerseEnvConfig(
        task=TASK, level=LEVEL, split=SPLIT, image_size=config.env.image_size, cameras=config.env.cameras
    )
    env: Any
    (env,) = env_config.create_envs(num_episodes)[env_config.type].values()
    before, after = make_env_pre_post_processors(env_cfg=env_config, policy_cfg=policy.model.config)
    steps = (before, after, policy.preprocessor, policy.postprocessor)
    begun: list[int] = []  # the episodes of LeRobot's side, which runs first in the warm-up turn
    records: list[Any] = []
    reset = env.reset

    def noted_reset(**options: Any) -> Any:
        result = reset(**options)
        begun[:] = env.episodes.tolist()
        return result

    @torch.no_grad()
    def theirs() -> None:
        env.reset = noted_reset
        eval_policy(env, policy.model, *steps, num_episodes, start_seed=SEED)
        env.reset = reset

    def ours() -> None:
        records[:] = evaluate_cell(policy, env, begun, split=SPLIT, level=LEVEL, seed=SEED, policy_name="act")

    def check() -> None:
        if [record.episode for record in records] != begun or any(record.length < 50 for record in records):
            raise SimulatorError("The two evaluations are not of the same episodes: do not compare them.")

    seconds = in_turns(ours, theirs, turns, clock=time.process_time, after=check)
    env.close()
    name = f"evaluation of ACT, {config.env.image_size}×{config.env.image_size}, LeRobot / ours"
    return measurement(name, seconds, GOAL, units=num_episodes)


def _quick_policy() -> tuple[Any, Any]:
    """Returns the configuration of ``preset=quick`` and its untrained policy."""
    import policies
    from roboverse_learn.commands.dataset_layout import dataset_layout
    from roboverse_learn.config.compose import compose
    from roboverse_learn.training.imitation.estimate import plain_stats

    config = compose("train", ["policy=act", f"task={TASK}", "preset=quick"])
    features, _, _ = dataset_layout(config)
    return config, policies.create("act", features, plain_stats(features), config.policy)


if __name__ == "__main__":
    quiet = {"HF_HUB_OFFLINE": "1", "TQDM_DISABLE": "1"}
    sys.exit(program("evaluation", Settings, parts, one_core=True, environment=quiet))
