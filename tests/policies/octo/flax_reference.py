"""Writes ``flax_reference.json``: outputs of a tiny Octo in Flax, which our network has to repeat.

It is no part of the tests. It runs in an environment of its own, without Octo and without this package::

    uv venv flax && uv pip install --python flax jax[cpu]==0.4.38 flax==0.10.2 transformers==4.49.0
    flax/bin/python tests/policies/octo/flax_reference.py

The layers follow the equations of Octo's code (github.com/octo-models/octo) in Flax's own modules, under the
names of its parameters. Every weight follows from its name, so that the file holds shapes and outputs alone.
"""

# pyright: reportMissingImports=false

import json
from pathlib import Path

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
from flax_numbers import BATCH, CAMERAS, HEAD, PRESENT, SIZES, STEPS, TEXT, WORDS, images_of, wave, weight_of
from transformers import FlaxT5EncoderModel, T5Config


class StdConv(nn.Conv):
    def param(self, name, *args, **kwargs):
        value = super().param(name, *args, **kwargs)
        if name != "kernel":
            return value
        value = value - value.mean((0, 1, 2))
        return value / (value.std((0, 1, 2)) + 1e-5)


class SmallStem16(nn.Module):
    @nn.compact
    def __call__(self, pixels):
        for index, features in enumerate(SIZES["stem"]):
            pixels = StdConv(features, (3, 3), (2, 2), padding=1, name=f"StdConv_{index}")(pixels)
            pixels = nn.relu(nn.GroupNorm(name=f"GroupNorm_{index}")(pixels))
        return nn.Conv(SIZES["stem_out"], (1, 1), padding="VALID", name="embedding")(pixels)


class Tokenizer(nn.Module):
    @nn.compact
    def __call__(self, images):
        images = jnp.concatenate([images, jnp.zeros_like(images)], -1)
        pixels = images.astype(jnp.float32) / 127.5 - 1.0
        found = SmallStem16(name="SmallStem16_0")(pixels.reshape(-1, *pixels.shape[2:]))
        return found.reshape(*images.shape[:2], -1, found.shape[-1])


class MlpBlock(nn.Module):
    @nn.compact
    def __call__(self, tokens):
        inner = nn.gelu(nn.Dense(SIZES["mlp"])(tokens))  # modules are numbered in the order of their calls
        return nn.Dense(tokens.shape[-1])(inner)


class EncoderBlock(nn.Module):
    @nn.compact
    def __call__(self, tokens, mask):
        normed = nn.LayerNorm()(tokens)
        tokens = tokens + nn.MultiHeadDotProductAttention(num_heads=SIZES["heads"])(normed, normed, mask=mask)
        return tokens + MlpBlock()(nn.LayerNorm()(tokens))


class Transformer(nn.Module):
    @nn.compact
    def __call__(self, tokens, mask):
        for layer in range(SIZES["layers"]):
            tokens = EncoderBlock(name=f"encoderblock_{layer}")(tokens, mask)
        return nn.LayerNorm(name="encoder_norm")(tokens)


class BlockTransformer(nn.Module):
    @nn.compact
    def __call__(self, tokens, mask):
        return Transformer(name="Transformer_0")(tokens, mask)


class OctoTransformer(nn.Module):
    repeats_text: bool
    right_groups: bool

    @nn.compact
    def __call__(self, images, words, present):
        width = SIZES["width"]

        def place(name, shape):
            return self.param(f"{name}_pos_embedding", nn.initializers.normal(0.02), shape)

        task = nn.Dense(width, name="task_language_projection")(words)
        task = task + place("task_language", (1, *task.shape[1:]))
        groups, shown = [], []
        for name in CAMERAS:
            tokens = Tokenizer(name=f"observation_tokenizers_{name}")(images[name])
            tokens = nn.Dense(width, name=f"obs_{name}_projection")(tokens)
            tokens = tokens + place(f"obs_{name}", (1, SIZES["horizon"], *tokens.shape[2:]))[:, :STEPS]
            groups.append((f"obs_{name}", tokens))
            shown.append(jnp.broadcast_to(present[:, :, None], tokens.shape[:3]))
        if self.repeats_text:
            groups.append(("obs_task_language", jnp.tile(task[:, None], (1, STEPS, 1, 1))))
            shown.append(jnp.ones(groups[-1][1].shape[:3], bool))
        readout = place("readout_action", (1, SIZES["horizon"], 1, width))[:, :STEPS]
        groups.append(("readout_action", jnp.tile(readout, (BATCH, 1, 1, 1))))
        shown.append(jnp.ones((BATCH, STEPS, 1), bool))
        together = jnp.concatenate([tokens for _, tokens in groups], 2)
        rules = rule_table(task.shape[1], groups, self.right_groups)
        seen = jnp.concatenate(
            [jnp.ones(task.shape[:2], bool), jnp.concatenate(shown, 2).reshape(BATCH, -1)], 1
        )
        mask = rules[None, None] & seen[:, None, None]
        tokens = jnp.concatenate([task, together.reshape(BATCH, -1, width)], 1)
        out = BlockTransformer(name="BlockTransformer_0")(tokens, mask)
        return out[:, task.shape[1] :].reshape(BATCH, STEPS, -1, width)[:, :, -1]


def rule_table(prefix, groups, right):
    """Asks the rule for every pair of tokens."""
    ends = np.cumsum([tokens.shape[2] for _, tokens in groups])

    def who(index):
        if index < prefix:
            return "task_language", -1
        step, place = divmod(index - prefix, ends[-1])
        return groups[np.searchsorted(ends, place, side="right" if right else "left")][0], step

    def may(one, other):
        (name, time), (theirs, then) = who(one), who(other)
        allowed = {"task": ("task_",), "obs_": ("task_", "obs_"), "read": ("task_", "obs_", "readout_")}
        return theirs.startswith(allowed[name[:4]]) and then <= time

    total = prefix + STEPS * int(ends[-1])
    return np.array([[may(one, other) for other in range(total)] for one in range(total)])


class Fourier(nn.Module):
    @nn.compact
    def __call__(self, time):
        kernel = self.param("kernel", nn.initializers.normal(0.2), (HEAD["time_dim"] // 2, 1))
        angles = 2 * jnp.pi * time @ kernel.T
        return jnp.concatenate([jnp.cos(angles), jnp.sin(angles)], -1)


class Mlp(nn.Module):
    @nn.compact
    def __call__(self, features):
        features = nn.swish(nn.Dense(2 * HEAD["time_dim"])(features))
        return nn.Dense(HEAD["time_dim"])(features)


class MLPResNetBlock(nn.Module):
    @nn.compact
    def __call__(self, features):
        inner = nn.swish(nn.Dense(4 * features.shape[-1])(nn.LayerNorm()(features)))
        return features + nn.Dense(features.shape[-1])(inner)


class MLPResNet(nn.Module):
    @nn.compact
    def __call__(self, features):
        features = nn.Dense(HEAD["hidden_dim"])(features)
        for _ in range(HEAD["num_blocks"]):
            features = MLPResNetBlock()(features)
        return nn.Dense(HEAD["action_dim"] * HEAD["action_horizon"])(nn.swish(features))


class Score(nn.Module):
    @nn.compact
    def __call__(self, readout, actions, time):
        features = Mlp(name="cond_encoder")(Fourier(name="time_preprocess")(time))
        return MLPResNet(name="reverse_network")(jnp.concatenate([features, readout, actions], -1))


def filled(tree, prefix, shapes):
    """Returns a tree of weights that follow from their names, and notes their shapes."""
    out = {}
    for key, value in tree.items():
        name = f"{prefix}/{key}"
        if isinstance(value, dict):
            out[key] = filled(value, name, shapes)
        else:
            shapes[name] = list(value.shape)
            out[key] = weight_of(name, value.shape)
    return out


def main():
    shapes: dict = {}
    text = FlaxT5EncoderModel(T5Config(**TEXT))
    prefix = "octo_transformer/task_tokenizers_language/hf_model"
    tokens = np.array(WORDS)
    params = filled(text.params, prefix, shapes)
    words = text.module.apply({"params": params}, tokens, tokens != 0).last_hidden_state
    images = {name: images_of(name) for name in CAMERAS}
    present = np.array(PRESENT, bool)
    out: dict = {"words": words, "readouts": {}}
    for repeats in (False, True):
        for right in (False, True):
            model = OctoTransformer(repeats_text=repeats, right_groups=right)
            tree = model.init(jax.random.PRNGKey(0), images, words, present)["params"]
            variables = {"params": filled(tree, "octo_transformer", shapes)}
            for kind, shown in (("all", np.ones_like(present)), ("padded", present)):
                found = model.apply(variables, images, words, shown)
                out["readouts"][f"{int(repeats)}{int(right)}{kind}"] = found
    numbers = HEAD["action_dim"] * HEAD["action_horizon"]
    readout, noisy = wave("readout", (BATCH, SIZES["width"])), wave("noisy", (BATCH, numbers))
    time = np.array([[0], [3]], np.float32)
    score = Score()
    tree = score.init(jax.random.PRNGKey(0), readout, noisy, time)["params"]
    out["noise"] = score.apply(
        {"params": filled(tree, "heads_action/diffusion_model", shapes)}, readout, noisy, time
    )
    out = jax.tree_util.tree_map(lambda value: np.asarray(value, np.float64).round(7).tolist(), out)
    text = json.dumps({"shapes": shapes, **out}, sort_keys=True)
    Path(__file__).with_suffix(".json").write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
