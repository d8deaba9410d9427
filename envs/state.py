"""The state of N environments as batched tensors, the same for every simulator.

Units: metres, radians, seconds. Positions and linear velocities are in the world frame. Quaternions
are (w, x, y, z). Angular velocities are in the body's own frame, where a free joint keeps them, so
that setting a state and getting it back changes no bit. Treat the tensors as read-only: what never
changes, such as the base of a robot that is bolted down, is shared between states.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import torch
from torch import Tensor

from envs.core.errors import ConfigError, unknown_name


@dataclass(slots=True)
class EntityState:
    """One robot or object in N environments.

    Attributes:
        pos: Position of the root, (N, 3).
        rot: Orientation of the root, (N, 4).
        lin_vel: Linear velocity of the root, (N, 3).
        ang_vel: Angular velocity of the root in its own frame, (N, 3).
        joint_pos: Joint positions in the scenario's order, (N, J); J is 0 for a rigid object.
        joint_vel: Joint velocities, (N, J).
        joint_target: Position targets of the driven joints, (N, J) where all are; for a robot only.
        ee_pos: Position of the end effector, (N, 3); for a robot only, and ignored when a state is set.
        ee_rot: Orientation of the end effector, (N, 4); likewise.
        touched: Which of the T things that it feels touch it, 1 or 0, (N, T), as the last step found it; for
            what feels something only, and ignored when a state is set.
    """

    pos: Tensor
    rot: Tensor
    lin_vel: Tensor
    ang_vel: Tensor
    joint_pos: Tensor
    joint_vel: Tensor
    joint_target: Tensor | None = None
    ee_pos: Tensor | None = None
    ee_rot: Tensor | None = None
    touched: Tensor | None = None

    @classmethod
    def at_rest(cls, pos: np.ndarray, rot: np.ndarray, joint_pos: np.ndarray | None = None) -> "EntityState":
        """Returns the state of something that does not move, in float64.

        Args:
            pos: Positions, (N, 3), or one for all, (3,) (then ``rot`` is (N, 4)).
            rot: Orientations, (N, 4), or one for all, (4,).
            joint_pos: Joint positions, (N, J); none by default.
        """
        count = max(np.size(pos) // 3, np.size(rot) // 4)
        joints = np.zeros((count, 0)) if joint_pos is None else np.array(joint_pos, np.float64)
        still = torch.zeros((count, 3), dtype=torch.float64)
        return cls(
            pos=torch.from_numpy(np.tile(np.asarray(pos, np.float64), (count // (np.size(pos) // 3), 1))),
            rot=torch.from_numpy(np.tile(np.asarray(rot, np.float64), (count // (np.size(rot) // 4), 1))),
            lin_vel=still,
            ang_vel=still.clone(),
            joint_pos=torch.from_numpy(joints),
            joint_vel=torch.zeros(joints.shape, dtype=torch.float64),
        )

    def arrays(self) -> "EntityState":
        """Returns the same numbers as numpy arrays; from tensors on the CPU, without a copy."""
        values: dict[str, Any] = {f.name: getattr(self, f.name) for f in fields(self)}
        arrays: dict[str, Any] = {k: None if v is None else v.numpy() for k, v in values.items()}
        return EntityState(**arrays)

    def select(self, env_ids: Tensor) -> "EntityState":
        """Returns the rows ``env_ids`` as new tensors."""
        values: dict[str, Any] = {f.name: getattr(self, f.name) for f in fields(self)}
        rows: dict[str, Any] = {k: None if v is None else v[env_ids] for k, v in values.items()}
        return EntityState(**rows)


@dataclass(slots=True)
class State:
    """Every robot and object of N environments.

    Attributes:
        robots: Robot name to its state.
        objects: Object name to its state.
    """

    robots: dict[str, EntityState]
    objects: dict[str, EntityState]

    @property
    def num_envs(self) -> int:
        """N."""
        return next(iter({**self.robots, **self.objects}.values())).pos.shape[0]

    @property
    def device(self) -> torch.device:
        """Device of its tensors."""
        return next(iter({**self.robots, **self.objects}.values())).pos.device

    def entities(self) -> dict[str, EntityState]:
        """Returns robots and objects by name."""
        return {**self.robots, **self.objects}

    def arrays(self) -> "State":
        """Returns the same state in numpy arrays, for what takes them too: see :mod:`envs.array_ops`."""
        return State(
            {name: entity.arrays() for name, entity in self.robots.items()},
            {name: entity.arrays() for name, entity in self.objects.items()},
        )

    def to(self, device: torch.device | str, dtype: torch.dtype = torch.float64) -> "State":
        """Returns the state on another device, in another precision; itself where nothing changes."""
        device = torch.device(device)
        positions = [entity.pos for entity in self.entities().values()]
        if all(pos.device == device and pos.dtype == dtype for pos in positions):
            return self
        return State.unflatten({key: value.to(device, dtype) for key, value in self.flatten().items()})

    def select(self, env_ids) -> "State":
        """Returns the state of the environments ``env_ids`` only."""
        index = torch.as_tensor(env_ids, dtype=torch.long)
        return State(
            {name: entity.select(index) for name, entity in self.robots.items()},
            {name: entity.select(index) for name, entity in self.objects.items()},
        )

    def within(self, names: Collection[str]) -> "State":
        """Returns the state of only those robots and objects that are named."""
        return State(
            {name: entity for name, entity in self.robots.items() if name in names},
            {name: entity for name, entity in self.objects.items() if name in names},
        )

    def to_dict(self) -> dict[str, dict[str, dict[str, Tensor]]]:
        """Returns the nested form ``{"robots": {name: {"pos": …}}, "objects": {…}}``."""
        return {
            kind: {
                name: {
                    f.name: getattr(entity, f.name)
                    for f in fields(entity)
                    if getattr(entity, f.name) is not None
                }
                for name, entity in getattr(self, kind).items()
            }
            for kind in ("robots", "objects")
        }

    @classmethod
    def from_dict(cls, nested: Mapping[str, Mapping[str, Mapping[str, Tensor]]]) -> "State":
        """Builds a state from its nested form.

        Velocities that are absent are zero; joints that are absent are none.

        Raises:
            ConfigError: if ``pos`` or ``rot`` is absent.
            UnknownNameError: if a field has another name.
        """
        kinds = {
            kind: {name: _entity_from_dict(name, values) for name, values in nested.get(kind, {}).items()}
            for kind in ("robots", "objects")
        }
        return cls(**kinds)

    def flatten(self) -> dict[str, Tensor]:
        """Returns ``{"robots/franka/joint_pos": …}``, for storage."""
        return {
            f"{kind}/{name}/{field}": value
            for kind, entities in self.to_dict().items()
            for name, values in entities.items()
            for field, value in values.items()
        }

    @classmethod
    def unflatten(cls, flat: Mapping[str, Tensor]) -> "State":
        """Inverts :meth:`flatten`."""
        nested: dict[str, dict[str, dict[str, Tensor]]] = {}
        for key, value in flat.items():
            kind, name, field = key.split("/")
            nested.setdefault(kind, {}).setdefault(name, {})[field] = value
        return cls.from_dict(nested)


def _entity_from_dict(name: str, values: Mapping[str, Tensor]) -> EntityState:
    valid = [f.name for f in fields(EntityState)]
    for key in values:
        if key not in valid:
            raise unknown_name(f"field of '{name}' in a state", key, valid)
    missing = {"pos", "rot"} - set(values)
    if missing:
        raise ConfigError(f"The state of '{name}' lacks {' and '.join(sorted(missing))}.")
    pos = values["pos"]
    zeros = torch.zeros_like(pos)
    none = pos.new_zeros((pos.shape[0], 0))
    defaults = {"lin_vel": zeros, "ang_vel": zeros.clone(), "joint_pos": none, "joint_vel": none}
    if "joint_pos" in values:
        defaults["joint_vel"] = torch.zeros_like(values["joint_pos"])
    return EntityState(**{**defaults, **values})


def concatenated(states: Sequence[State]) -> State:
    """Returns the rows of several states as one."""
    flats = [state.flatten() for state in states]
    return State.unflatten({key: torch.cat([flat[key] for flat in flats]) for key in flats[0]})
