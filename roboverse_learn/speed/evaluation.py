"""Evaluating one ACT checkpoint on the same episodes: our runner against LeRobot's.

Both run the policy of ``preset=quick``, untrained, on the same episodes, in the same batched env, on the
same core, in turns, without videos. Untrained, because then every episode lasts as long as the task allows,
for both.
LeRobot's evaluation hands every observation of every step to the policy, so every picture is drawn.
"""

import logging
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from envs.core.arguments import NoSettings, run_program
from envs.core.errors import SimulatorError
from roboverse_learn.speed.throughput import Measurement

log = logging.getLogger(__name__)

TASK, LEVEL, SPLIT, SEED = "PickCube", 0, "test", 0
NUM_EPISODES = 4
GOAL = 5.0


def measure_evaluation(*, turns: int = 3) -> Measurement:
    """Compares both; each has loaded the checkpoint, built the env and run once before its clock starts.

    Args:
        turns: How often either is timed.

    Returns:
        Median seconds per episode; the ratio is LeRobot's time over ours.

    Raises:
        SimulatorError: The two did not run the same episodes.
    """
    import policies
    from envs.lerobot.env import RoboVerseEnvConfig

    config, policy = _quick_policy()
    with tempfile.TemporaryDirectory() as folder:
        policy.save(Path(folder) / "pretrained_model")
        policy = policies.load(folder)
    env_config = RoboVerseEnvConfig(task=TASK, level=LEVEL, split=SPLIT, image_size=config.env.image_size)
    (env,) = env_config.create_envs(NUM_EPISODES)[env_config.type].values()
    times = []
    for _ in range(turns + 1):
        theirs, begun = _time_lerobot(env, env_config, policy)
        ours, records = _time_ours(env, policy, begun)
        if [record.episode for record in records] != begun or any(record.length < 50 for record in records):
            raise SimulatorError("The two evaluations are not of the same episodes: their times say nothing.")
        times.append((ours, theirs))
    env.close()
    mine, baseline = np.array(times[1:]).T / NUM_EPISODES  # the first turn imports the renderer
    return Measurement(
        name=f"evaluation of ACT, {config.env.image_size}×{config.env.image_size}, LeRobot / ours",
        ours_s=median(mine),
        baseline_s=median(baseline),
        ratio=median(baseline / mine),
        goal=f"goal ≥ {GOAL:.0f}",
    )


def _quick_policy() -> tuple[Any, Any]:
    """Returns the configuration of ``preset=quick`` and its policy, with weights as they begin."""
    import policies
    from roboverse_learn.collect import dataset_layout
    from roboverse_learn.config.compose import compose
    from roboverse_learn.train import plain_stats

    config = compose("train", ["policy=act", f"task={TASK}", "preset=quick"])
    features, _, _ = dataset_layout(config)
    return config, policies.create("act", features, plain_stats(features), config.policy)


def _time_lerobot(env: Any, env_config: Any, policy: Any) -> tuple[float, list[int]]:
    """Returns the seconds that LeRobot's evaluation takes, and the episodes that it began with."""
    import torch
    from lerobot.envs.factory import make_env_pre_post_processors
    from lerobot.scripts.lerobot_eval import eval_policy

    before, after = make_env_pre_post_processors(env_cfg=env_config, policy_cfg=policy.model.config)
    begun: list[int] = []
    reset = env.reset

    def noted_reset(**options: Any) -> Any:
        result = reset(**options)
        begun[:] = env.episodes.tolist()
        return result

    env.reset = noted_reset
    with torch.no_grad():
        started = time.perf_counter()
        steps = (before, after, policy.preprocessor, policy.postprocessor)
        eval_policy(env, policy.model, *steps, NUM_EPISODES, start_seed=SEED)
        seconds = time.perf_counter() - started
    env.reset = reset
    return seconds, begun


def _time_ours(env: Any, policy: Any, episodes: list[int]) -> tuple[float, list[Any]]:
    from benchmark.runner import evaluate_cell

    started = time.perf_counter()
    records = evaluate_cell(policy, env, episodes, split=SPLIT, level=LEVEL, seed=SEED, policy_name="act")
    return time.perf_counter() - started, records


def main(words: Sequence[str] | None = None) -> int:
    """Logs the measurement; the exit code is 1 where the goal is missed."""
    return run_program("python -m roboverse_learn.speed.evaluation", NoSettings, _measure_all, words)


def _measure_all(_: NoSettings) -> int:
    logging.basicConfig(level=logging.WARNING, format="%(message)s", stream=sys.stdout)
    log.setLevel(logging.INFO)
    os.environ.setdefault("HF_HUB_OFFLINE", "1")
    os.environ.setdefault("TQDM_DISABLE", "1")
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    measurement = measure_evaluation()
    log.info("%s", measurement)
    return int(measurement.ratio < GOAL)


if __name__ == "__main__":
    sys.exit(main())
