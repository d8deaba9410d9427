"""What the starts of a task of another benchmark must be, for environments of two."""

import torch

from envs.randomization import channel_rng


def check_it_stays_unsolved(env, hold_of) -> None:
    """Starts every environment and holds the arm: nothing is solved, and no object moves 5 mm in 20 steps.

    Args:
        env: The environments.
        hold_of: Returns the actions that hold the arm, from the state at the start.
    """
    ids = range(env.num_envs)
    env.reset_envs(ids, env.split_indices[: env.num_envs])
    before = env.get_states()
    assert not env.task.success(before).any()
    hold = hold_of(before)
    for _ in range(20):
        assert not env.step_envs(ids, hold).success.any()
    after = env.get_states()
    for name, entity in before.objects.items():
        moved = torch.linalg.vector_norm(after.objects[name].pos - entity.pos, dim=-1)
        assert moved.max() < 5e-3, name


def check_it_is_not_solved_by_nan(task, state) -> None:
    """Makes the objects' positions NaN: that is no success."""
    for entity in state.objects.values():
        entity.pos[:] = torch.nan
    assert not task.success(state).any()


def check_starts_follow_from_their_generators(task) -> None:
    """Draws starts together and alone: they are the same, and differ from each other."""
    together = task.initial_state([channel_rng(0, "task", i) for i in range(3)])
    alone = task.initial_state([channel_rng(0, "task", 1)])
    for key, value in alone.flatten().items():
        assert torch.equal(value[0], together.flatten()[key][1]), key
    flat = torch.cat([value.flatten(1) for value in together.flatten().values()], dim=1)
    assert len(torch.unique(flat, dim=0)) == 3
