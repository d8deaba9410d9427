"""Scripted experts: waypoints of the gripper, followed by inverse kinematics."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from envs.experts.rollout import ExpertRunner, Rollout, rollout

__all__ = ["ExpertRunner", "Rollout", "rollout"]


def __getattr__(name: str) -> Any:
    if name in __all__:
        from envs.experts import rollout as module

        return getattr(module, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
