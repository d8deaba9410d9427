"""Random number generators of an episode, by channel.

An episode is the same whatever the number of environments, their order, or which other channels are
on: each channel has its own stream, keyed by the channel's name and the episode's index alone.
"""

import zlib

import numpy as np


def channel_rng(seed: int, channel: str, index: int) -> np.random.Generator:
    """Returns the random numbers of one channel in one episode.

    Args:
        seed: The protocol's seed.
        channel: The channel's name; another name gives an independent stream.
        index: The episode's index in the pool.
    """
    key = (zlib.crc32(channel.encode()), int(index))
    return np.random.default_rng(np.random.SeedSequence(entropy=int(seed), spawn_key=key))
