"""Repairs of robosuite 1.5.1 and Meta-World 3.0.0, which were written for MuJoCo 3, under MuJoCo 4.

They replace a few functions of those packages in memory, and are applied only where one of the packages
is used: by the Meta-World tasks, and by tests that compare with robosuite. Applying one twice changes
nothing.

What they repair, and when they can be removed:

- robosuite 1.5.1 compares joint types, which MuJoCo gives as numpy integers since 3.12, with members of
  an enumeration (``utils/binding_utils.py``), and calls ``mj_fullM(model, dst, data.qM)``, which is
  ``mj_fullM(model, data, dst)`` since 3.10 and has no ``qM`` since 3.11. :func:`repair_robosuite` can
  go with the first robosuite that supports MuJoCo 4 and is compatible with LeRobot's numpy (1.5.2 pins
  ``mink==0.0.5``, which needs numpy below 2).
- Meta-World 3.0.0 writes eleven numbers into ``eq_data``, which has twelve columns since MuJoCo 3.17
  (``sawyer_xyz_env.py``, ``reset_mocap_welds``). :func:`repair_metaworld` can go with the first
  Meta-World that supports MuJoCo 4 (3.1.1 pins ``mujoco==3.3.0``).
"""

from typing import Any, cast

import mujoco
import numpy as np

_WELD_DATA = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 5.0)
"""Meta-World's weld: anchor, position and orientation (-1, 0, 0, 0), weight of turning against moving."""

_DONE = "_repaired_for_mujoco_4"


def repair_metaworld() -> None:
    """Patches MuJoCo so that Meta-World 3.0.0 can make its environments."""
    from metaworld.sawyer_xyz_env import SawyerMocapBase

    if hasattr(SawyerMocapBase, _DONE):
        return

    def reset_mocap_welds(self: Any) -> None:
        welds = self.model.eq_type == int(mujoco.mjtEq.mjEQ_WELD)
        self.model.eq_data[welds, : len(_WELD_DATA)] = _WELD_DATA

    SawyerMocapBase.reset_mocap_welds = reset_mocap_welds
    setattr(SawyerMocapBase, _DONE, True)


def repair_robosuite() -> None:
    """Patches MuJoCo for robosuite 1.5.1, whose controllers read the mass matrix."""
    from robosuite.utils import binding_utils

    if hasattr(binding_utils, _DONE):
        return
    free, ball = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_BALL)

    def address(self: Any, name: str, starts: np.ndarray, sizes: dict[int, int]) -> Any:
        joint = self.joint_name2id(name)
        start, size = starts[joint], sizes.get(int(self.jnt_type[joint]), 1)
        return start if size == 1 else (start, start + size)

    def get_joint_qpos_addr(self: Any, name: str) -> Any:
        return address(self, name, self.jnt_qposadr, {free: 7, ball: 4})

    def get_joint_qvel_addr(self: Any, name: str) -> Any:
        return address(self, name, self.jnt_dofadr, {free: 6, ball: 3})

    new_full_m = mujoco.mj_fullM

    def mj_fullM(model: mujoco.MjModel, first: Any, second: Any) -> None:  # noqa: N802 (MuJoCo's name)
        # robosuite: (model, destination, data.qM), where qM below is the data itself.
        new_full_m(model, *((second, first) if isinstance(first, np.ndarray) else (first, second)))

    binding_utils.MjModel.get_joint_qpos_addr = get_joint_qpos_addr
    binding_utils.MjModel.get_joint_qvel_addr = get_joint_qvel_addr
    if not hasattr(mujoco.MjData, "qM"):
        package, data_class = cast("Any", mujoco), cast("Any", binding_utils.MjData)
        package.mj_fullM = mj_fullM
        data_class.qM = property(lambda self: self._data)
    setattr(binding_utils, _DONE, True)
