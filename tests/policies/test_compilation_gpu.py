"""The gradients of compiled networks on a GPU are those of eager code."""

from dataclasses import replace

import pytest
import torch

import policies
from policies.compilation import INDUCTOR_OPTIONS
from tests.policies.examples import FEATURES, IMAGE, SIZE, stats

pytestmark = [
    pytest.mark.gpu,
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),  # of the compiler itself
    pytest.mark.filterwarnings("ignore:TensorFloat32 tensor cores:UserWarning"),  # fp32 is what is compared
    pytest.mark.skipif(not torch.cuda.is_available(), reason="needs an NVIDIA GPU"),
]
BATCH, BATCHES = 32, 12


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


def gradients(policy, objective, seed):
    policy.model.zero_grad(set_to_none=True)
    torch.manual_seed(seed)
    objective(frames(policy, seed))[0].backward()
    return {name: p.grad for name, p in policy.model.named_parameters() if p.grad is not None}


@pytest.mark.parametrize("name", ["act", "diffusion"])
def test_every_parameter_gets_the_gradient_of_eager_code(name, monkeypatch):
    """One that the compiler leaves unwritten holds what lay there before, so several batches are compared."""
    monkeypatch.setattr(torch.backends.cudnn, "allow_tf32", False)
    config = policies.config_class(name)()
    if name == "act":
        config = replace(config, dropout=0.0, chunk_size=40, n_action_steps=10)
    policy = policies.create(name, FEATURES, stats(), config, "cuda")
    policy.begin_training()
    eager, compiled = policy.objective(), policy.objective()
    noise_of_eager_code = {"fallback_random": True}
    compiled.compile(fullgraph=True, dynamic=False, options=INDUCTOR_OPTIONS | noise_of_eager_code)
    for seed in range(BATCHES):
        expected = {key: value.clone() for key, value in gradients(policy, eager, seed).items()}
        got = gradients(policy, compiled, seed)
        scale = torch.stack([value.norm() for value in expected.values()]).norm()
        for key, value in expected.items():
            error = (got[key] - value).norm() / (value.norm() + 1e-3 * scale)
            assert float(error) < 0.05, (seed, key, float(value.norm()), float(got[key].norm()))
