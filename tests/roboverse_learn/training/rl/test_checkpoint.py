"""Checkpoints of agents: what is saved comes back, all of it or nothing."""

import pytest
import torch

from envs.core.errors import CheckpointError
from roboverse_learn.training.checkpoint import last_checkpoint
from roboverse_learn.training.rl import checkpoint as checkpoint


class Weights:
    """Stands in for a policy."""

    def save(self, directory):
        directory.mkdir()
        (directory / "config.json").write_text("{}")


def state(step=7, **changes):
    content = {
        "step": step,
        "elapsed_s": 1.5,
        "settings": {"seed": 0, "task": "PickCube"},
        "numbers": {"updates": 3},
        "tensors": {"algorithm.a": torch.arange(3.0), "env.b": torch.ones(2, dtype=torch.bool)},
    }
    return checkpoint.AgentState(**(content | changes))


def test_what_is_saved_comes_back(tmp_path):
    folder = checkpoint.save_agent(tmp_path, Weights(), state())
    assert folder == tmp_path / "checkpoints/000000007/pretrained_model"
    loaded = checkpoint.load_agent(last_checkpoint(tmp_path), {"seed": 0, "task": "PickCube"})
    assert (loaded.step, loaded.elapsed_s, loaded.numbers) == (7, 1.5, {"updates": 3})
    assert checkpoint.part(loaded.tensors, "algorithm")["a"].tolist() == [0.0, 1.0, 2.0]
    assert checkpoint.part(loaded.tensors, "env")["b"].dtype is torch.bool


def test_earlier_checkpoints_keep_their_policy_alone(tmp_path):
    for step in (999_999, 1_000_000, 12_000_000):
        checkpoint.save_agent(tmp_path, Weights(), state(step))
    folders = sorted((tmp_path / "checkpoints").glob("[0-9]*"))
    assert [path.name for path in folders] == ["000999999", "001000000", "012000000"]
    assert [(path / "training_state").exists() for path in folders] == [False, False, True]
    assert all((path / "pretrained_model/config.json").exists() for path in folders)
    (tmp_path / "checkpoints/last").unlink()  # killed before the link
    assert last_checkpoint(tmp_path).name == "012000000"


@pytest.mark.parametrize("text", ["{", "[]", '{"format": 9}', '{"format": 1}'])
def test_a_damaged_checkpoint_is_an_error(tmp_path, text):
    checkpoint.save_agent(tmp_path, Weights(), state())
    (tmp_path / "checkpoints/last/training_state/state.json").write_text(text)
    with pytest.raises(CheckpointError, match=r"training_state' cannot be read .*begin a new run"):
        checkpoint.load_agent(tmp_path / "checkpoints/last", {})


def test_another_configuration_is_named(tmp_path):
    checkpoint.save_agent(tmp_path, Weights(), state())
    with pytest.raises(CheckpointError, match="task was PickCube and is StackCube"):
        checkpoint.load_agent(tmp_path / "checkpoints/last", {"seed": 0, "task": "StackCube"})


def test_moments_come_back_exactly():
    def stepped(parameter, optimizer):
        parameter.grad = torch.full_like(parameter, 0.5)
        optimizer.step()

    first, second = (torch.nn.Parameter(torch.ones(3)) for _ in range(2))
    one, other = (torch.optim.Adam([parameter], lr=0.1) for parameter in (first, second))
    stepped(first, one)
    second.data.copy_(first.data)
    checkpoint.load_moments(other, checkpoint.moments(one, "o"), "o")
    for parameter, optimizer in ((first, one), (second, other)):
        stepped(parameter, optimizer)
    assert first.equal(second)
