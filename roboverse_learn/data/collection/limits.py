"""Limits the processes and environments of a collection to this machine's cores and memory."""

import dataclasses
import logging

from envs.core.machine import num_cores
from roboverse_learn.config.schema import CollectConfig
from roboverse_learn.data.free_memory import free_memory_bytes
from roboverse_learn.data.shared_images import can_share

WORKER_BYTES = 700 << 20
"""Memory of one process: Python, torch and a compiled scene."""

LEAST_CORES = 8
"""Cores from which on processes encode for one that collects; threads do with fewer."""

MOST_ENCODERS = 16
"""Processes that encode; 16 cores take 250 episodes a second, of two cameras, 90 frames and 128 pixels."""

EPISODES_OF_ENCODER = 16
"""Episodes that are worth the start of a process, which is a second or two."""

_STATE_BYTES = 2 << 20
"""Memory of one environment's simulation."""

_LOG = logging.getLogger(__name__)


def within_machine(config: CollectConfig) -> CollectConfig:
    """Returns the configuration with no more workers and environments than fit, and logs what it lowers.

    ``num_workers=0`` becomes one process per core, or a single one where the simulator steps all environments
    at once, as on a GPU.
    """
    from envs.simulators import HANDLERS

    requested = config.collect
    cores, free = num_cores(), free_memory_bytes()
    default = 1 if HANDLERS.get(config.env.simulator).steps_together else cores
    workers = max(1, min(requested.num_workers or default, cores, free // WORKER_BYTES))
    envs = max(1, min(requested.num_envs, (free // workers - WORKER_BYTES) // _bytes_of_env(config)))
    if workers < requested.num_workers or envs < requested.num_envs:
        _LOG.warning(
            "num_workers=%d with num_envs=%d is more than this machine holds (%d cores, %.1f GB free); "
            "num_workers=%d with num_envs=%d is used.",
            *(requested.num_workers or default, requested.num_envs, cores, free / 1e9, workers, envs),
        )
    collect = dataclasses.replace(requested, num_workers=workers, num_envs=envs)
    return dataclasses.replace(config, collect=collect)


def num_encoders(config: CollectConfig) -> int:
    """Returns how many processes encode beside a single one that collects, within the machine.

    None do where a simulator steps environments one by one: there, processes collect and encode each its own.
    """
    from envs.simulators import HANDLERS

    together = HANDLERS.get(config.env.simulator).steps_together and config.collect.num_workers == 1
    if not together or num_cores() < LEAST_CORES or not can_share():
        return 0
    return min(num_cores() // 2, MOST_ENCODERS, config.collect.num_demos // EPISODES_OF_ENCODER)


def _bytes_of_env(config: CollectConfig) -> int:
    """Memory of one environment and of the images of an episode of the longest kind.

    Half of those are of the episode under way, and half of finished ones: up to half a batch is encoded.
    """
    task = config.env.make_task()
    scenario = task.scenario.seen_by(config.env.cameras, config.env.image_size)
    pixels = sum(camera.height * camera.width for camera in scenario.cameras)
    return _STATE_BYTES + 3 * pixels * task.max_episode_steps
