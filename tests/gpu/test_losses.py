"""Losses on a GPU: compiled, recorded, and the same numbers as on a CPU."""

import logging
from dataclasses import replace

import numpy as np
import pytest
import torch

import policies
from policies.compilation import compile_objective
from policies.cuda_graphs import RecordedObjective
from policies.learned_tasks import Instructions, LearnedTask
from roboverse_learn.training.imitation.fast_objective import NUM_BATCHES, EagerGradients, fast_objective
from roboverse_learn.training.imitation.optimizer import make_optimizer
from roboverse_learn.training.imitation.train import train
from roboverse_learn.training.metrics import read_metrics
from tests.gpu.draws import DrawnOnTheCpu
from tests.gpu.marks import COMPILES
from tests.policies.examples import (
    FEATURES,
    IMAGE,
    LEARNED,
    NARROW_CONFIGS,
    SHALLOW,
    generators,
    observation,
    stats,
)
from tests.roboverse_learn.training.frames import SquareFrames
from tests.roboverse_learn.training.imitation.test_train import CONFIG, KilledAt, losses

pytestmark = COMPILES

NAMES = LEARNED
BATCH, BATCHES, SIZE = 64, 6, 128
DATA = SquareFrames()
EXACT = {"act": {"use_vae": False}, "diffusion": {}, "mtact": {}}
"""Without the samples that depend on how a network is split into kernels; dropout is off in the examples."""


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
        **{key: torch.zeros(BATCH, dtype=torch.int64, device="cuda") for key in policy.columns},
    }


def of_frames(name, config):
    features = FEATURES | {IMAGE: FEATURES[IMAGE] | {"shape": (SIZE, SIZE, 3)}}
    policy = policies.create(name, features, stats(), config, "cuda")
    policy.begin_training()
    return policy, [frames(policy, seed) for seed in range(BATCHES)]


def tiny(name, device, **changes):
    config = replace(NARROW_CONFIGS[name], **EXACT[name], **changes)
    return policies.create(name, DATA.features, DATA.stats, config, device)


@pytest.mark.parametrize(
    ("name", "backbone"),
    [*((name, SHALLOW) for name in NAMES), ("act", "keypoints"), ("diffusion", "keypoints")],
)
def test_a_loss_that_is_compiled_and_recorded_has_the_gradients_of_eager_code(name, backbone, caplog):
    policy, batches = of_frames(name, replace(NARROW_CONFIGS[name], **EXACT[name], vision_backbone=backbone))
    with caplog.at_level(logging.WARNING):
        fast = fast_objective(policy, batches[:NUM_BATCHES], "bf16", compile=True, cuda_graphs=True)
    assert "changes the gradient" not in caplog.text
    assert isinstance(fast, RecordedObjective) and fast.objective._compiled_call_impl is not None


@pytest.mark.parametrize("norm", ["batch", "frozen", None])
def test_a_recorded_loss_of_full_size_has_the_gradients_of_eager_code(norm):
    policy, batches = of_frames(*full_size(norm))
    fast = RecordedObjective(policy.objective(), batches[0], "bf16")
    eager = EagerGradients(policy.model, policy.objective(), batches, "bf16")
    assert eager.first_disagreement(fast) is None


@pytest.mark.long
@pytest.mark.parametrize("cuda_graphs", [False, True])
@pytest.mark.parametrize("norm", ["batch", "frozen", None])
def test_a_compiled_loss_of_full_size_has_the_gradients_of_eager_code(norm, cuda_graphs):
    policy, batches = of_frames(*full_size(norm))
    fast = policy.objective()
    compile_objective(fast)
    if cuda_graphs:
        fast = RecordedObjective(fast, batches[0], "bf16")
    eager = EagerGradients(policy.model, policy.objective(), batches, "bf16")
    assert eager.first_disagreement(fast) is None


def full_size(norm):
    """Returns a policy's name and settings: ACT by the norms of its backbone, None for Diffusion Policy."""
    if norm is None:
        return "diffusion", policies.config_class("diffusion")()
    config = policies.config_class("act")(
        backbone_norm=norm, dropout=0.0, use_vae=False, chunk_size=40, n_action_steps=10
    )
    return "act", config


@pytest.mark.parametrize("name", NAMES)
def test_the_losses_of_the_first_steps_are_those_of_the_cpu(name):
    found = {}
    for device in ("cuda", "cpu"):
        policy = tiny(name, device)
        policy.begin_training()
        objective, optimizer = policy.objective(), make_optimizer(policy, CONFIG)
        torch.manual_seed(0)
        found[device] = []
        for step in range(3):
            keys = [*policy.features, *policy.columns]
            batch = DATA.sample(np.arange(8) + step, policy.delta_indices, keys=keys)
            with DrawnOnTheCpu():
                loss, _ = objective({key: value.to(device) for key, value in batch.items()})
            loss.backward()
            optimizer.step()
            optimizer.zero_grad()
            found[device].append(loss.item())
    assert found["cuda"][0] == pytest.approx(found["cpu"][0], rel=1e-2)
    assert found["cuda"] == pytest.approx(found["cpu"], rel=5e-2)
    assert len(set(found["cpu"])) == 3


@pytest.mark.parametrize("name", NAMES)
def test_actions_are_those_of_the_cpu(name):
    actions = {}
    for device in ("cuda", "cpu"):
        policy = tiny(name, device)
        actions[device] = policy.act(observation(policy, 3), generators(3))
    scale = np.abs(actions["cpu"]).mean()
    np.testing.assert_allclose(actions["cuda"], actions["cpu"], atol=2e-2 * scale, rtol=0)


@pytest.mark.parametrize("name", NAMES)
def test_killed_recorded_training_resumes_to_the_same_losses(name, tmp_path, caplog):
    config = replace(CONFIG, steps=6, save_every=3, compile=False, cuda_graphs=True)
    train(tiny(name, "cuda"), DATA, config, tmp_path / "straight")
    with pytest.raises(KeyboardInterrupt):
        train(tiny(name, "cuda"), DATA, config, tmp_path / "killed", reporter=KilledAt(5))
    assert list(losses(tmp_path / "killed"))[-1] == 5
    result = train(tiny(name, "cuda"), DATA, config, tmp_path / "killed")
    assert (result.steps, result.precision) == (6, "fp32")
    assert "changes the gradient" not in caplog.text
    straight = losses(tmp_path / "straight")
    assert losses(tmp_path / "killed") == pytest.approx(straight, rel=2e-2)
    assert list(straight) == list(range(1, 7))
    assert read_metrics(tmp_path / "killed")[-1]["lr"] == read_metrics(tmp_path / "straight")[-1]["lr"]
    policy = policies.load(result.checkpoint, "cuda")
    assert all(value.is_cuda and value.isfinite().all() for value in policy.state_dict().values())


@pytest.mark.parametrize("head", ["regression", "flow"])
@pytest.mark.parametrize("compile", [False, True])
def test_a_recorded_loss_of_several_tasks_has_the_gradients_of_eager_code(head, compile, caplog):
    config = replace(policies.config_class("mtact")(), head=head, swap_wordings=head == "flow")
    policy, batches = of_frames("mtact", config)
    tasks = tuple(LearnedTask(name=f"task{size}", state_size=size, action_size=size) for size in (9, 7))
    policy.learn_instructions(Instructions(texts=("lift", "raise", "open"), tasks=tasks, task_of=(0, 0, 1)))
    rng = torch.Generator("cuda").manual_seed(0)
    for batch in batches:
        batch["task_index"] = torch.randint(0, 3, (BATCH,), device="cuda", generator=rng)
    with caplog.at_level(logging.WARNING):
        fast = fast_objective(policy, batches[:NUM_BATCHES], "bf16", compile=compile, cuda_graphs=True)
    assert "changes the gradient" not in caplog.text
    assert isinstance(fast, RecordedObjective)
    eager = EagerGradients(policy.model, policy.objective(), batches, "bf16")
    assert eager.first_disagreement(fast) is None
