"""The published sizes of TD-MPC2, layer by layer."""

import pytest
import torch

from policies.tdmpc2.config import ARCHITECTURES, Tdmpc2Config
from policies.tdmpc2.world_model import WorldModel

D, A, TASKS, TASK_DIM, BINS = 39, 6, 80, 96, 101
"""The largest observation and action of the authors' 80 tasks, which name the sizes."""


def normed(a, b):
    return a * b + b + 2 * b


def head(a, width, out):
    return normed(a, width) + normed(width, width) + width * out + out


def by_hand(size):
    """Parameters of the parts of the authors' model, for their 80 tasks."""
    known = ARCHITECTURES[size]
    encoder = normed(D + TASK_DIM, known.enc_dim)
    encoder += (known.num_enc_layers - 2) * normed(known.enc_dim, known.enc_dim)
    encoder += normed(known.enc_dim, known.latent_dim)
    state, width = known.latent_dim + TASK_DIM, known.mlp_dim
    dynamics = normed(state + A, width) + normed(width, width) + normed(width, known.latent_dim)
    return {
        "task_embedding": TASKS * TASK_DIM,
        "encoder": encoder,
        "dynamics": dynamics,
        "reward_head": head(state + A, width, BINS),
        "prior_head": head(state, width, 2 * A),
        "q": known.num_q * head(state + A, width, BINS),
    }


@pytest.mark.slow
@pytest.mark.parametrize("size", ARCHITECTURES)
def test_every_part_has_the_parameters_of_the_authors_layers(size):
    with torch.device("meta"):
        model = WorldModel(Tdmpc2Config(model_size=size, episodic=False), (D,), (A,) * TASKS)
    found: dict[str, int] = {}
    for name, parameter in model.named_parameters():
        if parameter.requires_grad:
            part = name.partition(".")[0]
            found[part] = found.get(part, 0) + parameter.numel()
    assert found == by_hand(size)


@pytest.mark.parametrize("size", ARCHITECTURES)
def test_a_size_is_called_by_its_millions_of_parameters(size):
    millions = sum(by_hand(size).values()) / 1e6
    assert int(millions) == size or millions == pytest.approx(size, rel=0.05)  # the first is 1.4


def test_an_end_of_episodes_adds_its_head_alone():
    config = Tdmpc2Config(model_size=1)
    with torch.device("meta"):
        with_ends, without = (
            WorldModel(Tdmpc2Config(model_size=1, episodic=episodic), (D,), (A,))
            for episodic in (True, False)
        )
    more = sum(p.numel() for p in with_ends.parameters()) - sum(p.numel() for p in without.parameters())
    assert more == head(config.architecture.latent_dim, config.architecture.mlp_dim, 1)
