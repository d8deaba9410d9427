"""Sequences of a replay buffer: ours, and TorchRL's slices of the same episodes."""

from collections.abc import Callable
from typing import Any

STEPS, ENVS, EPISODE = 100_000, 100, 1000
SEQUENCES, HORIZON = 256, 4


def our_sequences(observed: int, actions: int, device: str) -> Callable[[], Any]:
    """Returns the draw of a batch of :class:`roboverse_learn.training.rl.replay_buffer.ReplayBuffer`.

    Args:
        observed: Numbers of an observation.
        actions: Numbers of an action.
        device: Torch device.
    """
    import torch

    from roboverse_learn.training.rl.replay_buffer import ReplayBuffer, Transitions

    where = torch.device(device)
    buffer = ReplayBuffer(STEPS, ENVS, observed, actions, where, horizon=HORIZON)
    seen, done = torch.randn(ENVS, observed, device=where), torch.rand(ENVS, actions, device=where)
    nothing = torch.zeros(ENVS, device=where)
    step = Transitions(seen, done, nothing, nothing, seen)
    for moment in range(STEPS // ENVS):
        buffer.add(step, torch.full((ENVS,), (moment + 1) % EPISODE == 0, device=where))
    return lambda: buffer.sequences(SEQUENCES)


def torchrl_slices(observed: int, actions: int, device: str) -> Callable[[], Any]:
    """Returns the draw of a batch by TorchRL's ``SliceSampler``, which knows where episodes begin and end.

    Args:
        observed: Numbers of an observation.
        actions: Numbers of an action.
        device: Torch device.

    Raises:
        MissingExtraError: if TorchRL is not installed.
    """
    import torch

    from envs.core.errors import MissingExtraError

    try:
        from tensordict import TensorDict
        from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
        from torchrl.data.replay_buffers.samplers import SliceSampler
    except ModuleNotFoundError as error:
        raise MissingExtraError(
            f"parts=[replay] compares with TorchRL, and the package '{error.name}' is not installed. "
            "Install it with: pip install 'roboverse-learn[torchrl]'."
        ) from error

    # It looks for the episodes once: with cache_values=False it would do so for every batch.
    sampler = SliceSampler(slice_len=HORIZON, traj_key="episode", cache_values=True)
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(STEPS, device=device), sampler=sampler, batch_size=SEQUENCES * HORIZON
    )
    fields = {
        "observation": torch.randn(STEPS, observed),
        "action": torch.rand(STEPS, actions),
        "reward": torch.zeros(STEPS),
        "terminated": torch.zeros(STEPS),
        "next_observation": torch.randn(STEPS, observed),
        "episode": torch.arange(STEPS) // EPISODE,
    }
    buffer.extend(TensorDict(fields, batch_size=[STEPS]).to(device))
    return buffer.sample
