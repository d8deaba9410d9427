"""The gradients of compiled and of recorded networks on a GPU are those of eager code."""

from dataclasses import replace

import pytest
import torch

import policies
from policies.compilation import compile_objective
from policies.cuda_graphs import RecordedObjective
from roboverse_learn.training.imitation.fast_objective import EagerGradients
from tests.policies.examples import FEATURES, IMAGE, stats

pytestmark = [
    pytest.mark.gpu,
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),  # of the compiler itself
    pytest.mark.filterwarnings("ignore::UserWarning:torch"),  # what it could not make faster
    pytest.mark.skipif(not torch.cuda.is_available(), reason="needs an NVIDIA GPU"),
]
BATCH, BATCHES, SIZE = 64, 6, 128


def frames(policy, seed):
    rng = torch.Generator("cuda").manual_seed(seed)
    steps = len(policy.delta_indices["action"])
    time = (policy.n_obs_steps,) if policy.n_obs_steps > 1 else ()
    return {
        IMAGE: torch.randint(
            0, 256, (BATCH, *time, 3, SIZE, SIZE), dtype=torch.uint8, device="cuda", generator=rng
        ),
        "observation.state": torch.randn(BATCH, *time, 9, device="cuda", generator=rng),
        "action": torch.rand(BATCH, steps, 9, device="cuda", generator=rng) - 0.5,
        "action_is_pad": torch.rand(BATCH, steps, device="cuda", generator=rng) < 0.1,
    }


@pytest.mark.parametrize(("compile", "cuda_graphs"), [(True, False), (False, True), (True, True)])
@pytest.mark.parametrize("norm", ["batch", "frozen", None])
def test_every_parameter_gets_the_gradient_of_eager_code(norm, compile, cuda_graphs):
    """In bf16; the norms are those of ACT's backbone, None stands for Diffusion Policy."""
    features = FEATURES | {IMAGE: FEATURES[IMAGE] | {"shape": (SIZE, SIZE, 3)}}
    name = "diffusion" if norm is None else "act"
    config = policies.config_class(name)()
    if norm is not None:
        config = replace(
            config, backbone_norm=norm, dropout=0.0, use_vae=False, chunk_size=40, n_action_steps=10
        )
    policy = policies.create(name, features, stats(), config, "cuda")
    policy.begin_training()
    eager, fast = policy.objective(), policy.objective()
    batches = [frames(policy, seed) for seed in range(BATCHES)]
    if compile:
        compile_objective(fast)
    if cuda_graphs:
        fast = RecordedObjective(fast, batches[0], "bf16")
    assert EagerGradients(policy.model, eager, batches, "bf16").first_disagreement(fast) is None
