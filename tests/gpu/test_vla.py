"""A VLA on a GPU: its blocks, compiled, leave every gradient as it is."""

import logging
from importlib.util import find_spec

import pytest
import torch

import policies
from policies.zoo.config import LeRobotConfig
from roboverse_learn.training.imitation.fast_objective import fast_objective
from tests.gpu.marks import COMPILES
from tests.policies.examples import FEATURES, stats
from tests.policies.training_steps import batch
from tests.policies.zoo import tiny

pytestmark = [
    *COMPILES,
    pytest.mark.skipif(
        find_spec("transformers") is None or find_spec("num2words") is None,
        reason="VLAs need the extra vla: uv pip install -e '.[vla]'",
    ),
]


@pytest.mark.parametrize("precision", ["fp32", "bf16"])
def test_compiled_blocks_leave_the_gradients_as_they_are(tmp_path, caplog, precision):
    from torch._dynamo.utils import counters

    settings = tiny.smolvla(tmp_path / "vlm")
    policy = policies.create(
        "lerobot", FEATURES, stats(), LeRobotConfig(type="smolvla", settings=settings), "cuda"
    )
    policy.instructions = tiny.WORDS
    policy.begin_training()
    frames = [{key: value.to("cuda") for key, value in batch(policy).items()} for _ in range(2)]
    before = counters["stats"]["unique_graphs"]
    with caplog.at_level(logging.WARNING), torch.random.fork_rng(devices=[0]):
        fast_objective(policy, frames, precision, compile=True, cuda_graphs=False)
    assert counters["stats"]["unique_graphs"] > before
    assert "changes the gradient" not in caplog.text
