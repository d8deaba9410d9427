"""Sizes, weights and inputs of the tiny Octo of ``flax_reference.json``: numbers that follow from names."""

import zlib

import numpy as np

SIZES = {
    "width": 24,
    "layers": 2,
    "heads": 3,
    "mlp": 40,
    "horizon": 3,
    "stem": (32, 32, 32, 32),
    "stem_out": 12,
}
HEAD = {
    "action_dim": 3,
    "action_horizon": 2,
    "hidden_dim": 16,
    "num_blocks": 2,
    "time_dim": 8,
    "diffusion_steps": 5,
}
TEXT = {"d_model": 16, "d_kv": 8, "d_ff": 24, "num_layers": 2, "num_heads": 2, "vocab_size": 40}
CAMERAS = {"primary": 48, "wrist": 32}
"""Pixels a side."""

WORDS = [[3, 9, 14, 1, 0, 0], [7, 30, 1, 0, 0, 0]]
PRESENT = [[0, 1], [1, 1]]
BATCH, STEPS = 2, 2


def wave(name, shape, scale=1.0):
    """Returns numbers that follow from a name and a shape, float32."""
    start = zlib.crc32(name.encode()) % 1000
    return (
        (scale * np.sin(12.9898 * np.arange(int(np.prod(shape))) + start)).astype(np.float32).reshape(shape)
    )


def weight_of(name, shape):
    """Returns a parameter: small numbers, around 1 for the scale of a normalization."""
    is_scale = name.endswith("/scale") or ("norm" in name and name.endswith("/weight"))
    return wave(name, shape, 0.2) + np.float32(is_scale)


def images_of(name):
    """Returns a camera's images (B, T, S, S, 3) uint8."""
    size = CAMERAS[name]
    return np.round(127.5 + 127.5 * wave(name, (BATCH, STEPS, size, size, 3))).astype(np.uint8)
