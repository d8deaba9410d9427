"""The policy of a checkpoint that is evaluated, and what it sees."""

from pathlib import Path
from typing import Any

from roboverse_learn.commands.tested_checkpoint import TestedCheckpoint


def load_policy(tested: TestedCheckpoint) -> Any:
    """Returns the policy, or the baseline, that is evaluated."""
    import policies
    from benchmark.runner import Baseline
    from roboverse_learn.commands.foreign_checkpoint import show_cameras

    if tested.checkpoint is None:
        return Baseline(tested.baseline)
    policy = policies.load(tested.checkpoint, tested.device)
    policy.task = tested.env.task
    show_cameras(policy, tested.env, tested.rename_map)
    return policy


def view_of(checkpoint: Path | None) -> dict[str, Any]:
    """Returns what a policy observes, and what its actions mean."""
    import policies
    from policies.checkpoint import policy_type, seen_cameras

    if checkpoint is None:
        return {"observation": "state", "actions": "task"}
    actions = policies.policy_class(policy_type(checkpoint)).actions_of
    return {"observation": "pixels" if seen_cameras(checkpoint) else "full", "actions": actions}
