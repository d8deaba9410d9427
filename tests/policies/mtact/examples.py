"""Small multi-task policies and their frames."""

import pytest
import torch

import policies
from policies.learned_tasks import Instructions, LearnedTask
from policies.mtact.config import MtActConfig
from policies.mtact.vision import Film
from tests.policies.examples import CONFIGS, FEATURES, IMAGE, SIZE, observation, stats

CONFIG = CONFIGS["mtact"]
HEADS = pytest.mark.parametrize("head", ["regression", "flow"])
WIDE = LearnedTask(name="Wide", state_size=9, action_size=9)
NARROW_TASK = LearnedTask(name="Narrow", state_size=7, action_size=5)
TWO = Instructions(
    texts=("lift the red cube", "raise the red cube", "open the drawer"),
    tasks=(WIDE, NARROW_TASK),
    task_of=(0, 0, 1),
)


def make(config: MtActConfig = CONFIG, instructions: Instructions = TWO):
    policy = policies.create("mtact", FEATURES, stats(), config)
    policy.learn_instructions(instructions)
    return policy


def with_film(policy):
    """Sets FiLM, which starts as nothing, to random numbers, as training does."""
    torch.manual_seed(0)
    for module in policy.model.modules():
        if isinstance(module, Film):
            torch.nn.init.normal_(module.linear.weight, std=0.3)
    return policy


def frames(indices=(0, 1, 2, 2), seed: int = 0) -> dict[str, torch.Tensor]:
    draw = torch.Generator().manual_seed(seed)
    n = len(indices)
    return {
        IMAGE: torch.randint(0, 256, (n, 3, SIZE, SIZE), dtype=torch.uint8, generator=draw),
        "observation.state": torch.randn(n, 9, generator=draw),
        "action": torch.randn(n, 6, 9, generator=draw),
        "action_is_pad": torch.zeros(n, 6, dtype=torch.bool),
        "task_index": torch.tensor(indices),
    }


def loss_of(policy, batch, seed: int = 0) -> torch.Tensor:
    torch.manual_seed(seed)
    return policy.objective()(batch)[0]


def seen(policy, text: str, n: int = 2):
    return observation(policy, n) | {"task": [text] * n}


# --- the instruction ----------------------------------------------------------------------------
