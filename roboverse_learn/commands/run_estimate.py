"""How long a run takes beside its training: one demonstration is timed on this machine."""

import contextlib
import time
from collections.abc import Collection
from dataclasses import dataclass

from envs.core.machine import num_cores
from envs.spec import EnvSpec
from roboverse_learn.commands.collected import num_collected
from roboverse_learn.config.schema import TrainRunConfig


@dataclass(frozen=True, kw_only=True, slots=True)
class DemonstrationTime:
    """What one demonstration takes one core.

    Attributes:
        seconds: All in: physics, the expert and the images of every step.
        without_images_s: The same without images.
        steps: Its control steps.
        collected_s: All in, with the looks that it has in a collection.
    """

    seconds: float
    without_images_s: float
    steps: int
    collected_s: float


@dataclass(frozen=True, kw_only=True, slots=True)
class BesideTraining:
    """Estimated seconds of the other stages of a run."""

    collect_s: float
    evaluate_s: float


def beside_training(config: TrainRunConfig) -> BesideTraining | None:
    """Estimates the time to collect the demonstrations that are missing, and to evaluate.

    Returns:
        None where one demonstration says too little: a run of several tasks, without an expert's
        demonstrations, or in a simulator that steps all environments together.
    """
    from envs.simulators import HANDLERS

    one = len(config.tasks) == 1 and config.source == "expert" and not config.dataset
    if not one or HANDLERS.get(config.env.simulator).steps_together:
        return None
    timed = time_demonstration(config.env, config.collect.steps_per_look)
    missing = max(config.collect.num_demos - num_collected(config), 0)
    return BesideTraining(
        collect_s=missing * timed.collected_s / num_cores(), evaluate_s=_evaluation_s(config, timed)
    )


def time_demonstration(spec: EnvSpec, steps_per_look: int = 0) -> DemonstrationTime:
    """Times the expert's first training episode on one core, with its images and without.

    Args:
        spec: The environment.
        steps_per_look: Control steps after which the look changes in a collection; 0 keeps it.
    """
    from envs.experts.actor import expert_episodes
    from envs.rollout import OnStep
    from roboverse_learn.data.sources.changing_looks import changing_looks

    with contextlib.closing(spec.make(1, num_threads=1)) as env:
        first = env.split_indices[:1].tolist()
        env.reset(options={"episodes": first})[0]["pixels"].copy()  # compiles what is not compiled yet

        def timed(record: Collection[str], on_step: OnStep = lambda episode: None) -> tuple[float, int]:
            start = time.perf_counter()
            (episode,) = expert_episodes(env, first, record=record, on_step=on_step)
            return time.perf_counter() - start, episode.length

        all_in = ("images", "states")
        seconds, steps = timed(all_in)
        return DemonstrationTime(
            seconds=seconds,
            without_images_s=min(timed(("states",))[0], seconds),
            steps=steps,
            collected_s=timed(all_in, changing_looks(env, steps_per_look))[0] if steps_per_look else seconds,
        )


def _evaluation_s(config: TrainRunConfig, timed: DemonstrationTime) -> float:
    """At levels that training knows, episodes last as long as a demonstration; elsewhere the whole limit."""
    from roboverse_learn.commands.tested_checkpoint import protocol_of

    protocol, limit = protocol_of(config.evaluate), config.env.make_task().max_episode_steps
    trained = config.env.level if config.env.only is None else -1
    known = [cell.level is not None and cell.level <= trained for cell in protocol.cells()]
    steps = protocol.episodes * sum(timed.steps if each else limit for each in known)
    act_s, chunk_size = time_policy(config)
    images_s = timed.seconds - timed.without_images_s  # read before each chunk
    env_s = (timed.without_images_s + images_s / chunk_size) / max(timed.steps, 1)
    return steps * (env_s / num_cores() + act_s / chunk_size)


def time_policy(config: TrainRunConfig) -> tuple[float, int]:
    """Returns the seconds in which an untrained policy of a run acts once, and for how many steps it acts."""
    import torch

    import policies
    from roboverse_learn.checks.policies import random_observation
    from roboverse_learn.commands.dataset_layout import dataset_layout
    from roboverse_learn.training.imitation.estimate import plain_stats

    features, _, _ = dataset_layout(config)
    policy = policies.create(config.policy_name, features, plain_stats(features), config.policy, "cpu")
    observation = random_observation(features, policy.n_obs_steps, config.env.make_task().description, 1)
    seconds = []
    for _ in range(2):  # the first call is slower
        start = time.perf_counter()
        policy.act(observation, [torch.Generator()])
        seconds.append(time.perf_counter() - start)
    return min(seconds), policy.n_action_steps
