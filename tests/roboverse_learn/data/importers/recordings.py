"""Files of other projects' formats, made of an episode that our own expert played."""

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from envs.rollout import Episode
from envs.rotations import rotate

PANDA = [f"panda_joint{i}" for i in range(1, 8)] + ["panda_finger_joint1", "panda_finger_joint2"]

# The Panda of robosuite 1.0 without what is seen: bodies, joints and the grip site.
ROBOSUITE_XML = """
<mujoco model="base"><compiler angle="radian" meshdir="nowhere/"/>
<asset><mesh name="seen" file="/of/another/machine.stl"/></asset>
<worldbody><light pos="0 0 3"/><include file="/etc/passwd"/>
<body name="table" pos="0 0 0.775"><geom type="box" size="0.4 0.4 0.025"/>
 <site name="table_top" pos="0 0 0.025"/></body>
<body name="robot0_link0" pos="-0.615 0 {base_z}"><geom type="mesh" mesh="seen"/>
 <body name="b1" pos="0 0 0.333"><joint name="robot0_joint1" axis="0 0 1"/>
 <body name="b2" quat="0.707107 -0.707107 0 0"><joint name="robot0_joint2" axis="0 0 1"/>
 <body name="b3" pos="0 -0.316 0" quat="0.707107 0.707107 0 0"><joint name="robot0_joint3" axis="0 0 1"/>
 <body name="b4" pos="0.0825 0 0" quat="0.707107 0.707107 0 0"><joint name="robot0_joint4" axis="0 0 1"/>
 <body name="b5" pos="-0.0825 0.384 0" quat="0.707107 -0.707107 0 0">
 <joint name="robot0_joint5" axis="0 0 1"/>
 <body name="b6" quat="0.707107 0.707107 0 0"><joint name="robot0_joint6" axis="0 0 1"/>
 <body name="b7" pos="0.088 0 0" quat="0.707107 0.707107 0 0"><joint name="robot0_joint7" axis="0 0 1"/>
 <body name="hand" pos="0 0 0.1065" quat="0.924 0 0 -0.383">
 <body name="grip" quat="0.707107 0 0 -0.707107"><site name="gripper0_grip_site" pos="0 0 0.097"/>
  <body pos="0 0 0.05"><geom size="0.01"/>
   <joint name="gripper0_finger_joint1" type="slide" axis="0 1 0" range="0 0.04"/></body>
  <body pos="0 0 0.05"><geom size="0.01"/>
   <joint name="gripper0_finger_joint2" type="slide" axis="0 1 0" range="-0.04 0"/></body>
 </body></body></body></body></body></body></body></body></body></body>
<body name="cube" pos="0 0 0.82"><joint type="free" name="cube_jnt0"/><geom type="box" size=".02 .02 .02"/>
</body></worldbody></mujoco>
"""


def arrays(played: Episode) -> dict[str, np.ndarray]:
    """Returns an episode's raw arrays under short names."""
    out = {}
    for key, values in played.raw.items():
        _, entity, name = key.split("/")
        out[f"{entity}/{name}"] = values
    return out


def write_maniskill(path: Path, episodes: list[Episode], **env_kwargs: Any) -> Path:
    """Writes ``<path>.h5`` and ``<path>.json``; returns the former."""
    described = []
    with h5py.File(path.with_suffix(".h5"), "w") as file:
        for index, played in enumerate(episodes):
            raw, group = arrays(played), file.create_group(f"traj_{index}")
            fingers = (played.actions[:, 7:8] + 0.01) / 0.05 * 2 - 1
            group["actions"] = np.concatenate([played.actions[:, :7], fingers], 1).astype(np.float32)
            for name, actor in (("cube", "cube"), ("goal", "goal_site")):
                turning = rotate(raw[f"{name}/rot"], raw[f"{name}/ang_vel"])
                parts = [raw[f"{name}/{field}"] for field in ("pos", "rot", "lin_vel")]
                group[f"env_states/actors/{actor}"] = np.concatenate([*parts, turning], 1)
            root = np.zeros((len(raw["franka/joint_pos"]), 13))
            root[:, [0, 3]] = -0.615, 1.0
            parts = [root, raw["franka/joint_pos"], raw["franka/joint_vel"]]
            group["env_states/articulations/panda"] = np.concatenate(parts, 1)
            success = np.zeros(len(played.actions), bool)
            success[-1] = True
            group["success"] = success
            described.append({"episode_id": index, "control_mode": "pd_joint_pos", "success": True})
    info = {"env_info": {"env_id": "PickCube-v1", "env_kwargs": env_kwargs}, "episodes": described}
    path.with_suffix(".json").write_text(json.dumps(info))
    return path.with_suffix(".h5")


def roboverse_episode(played: Episode, *, states: bool = True) -> dict[str, Any]:
    """Returns an episode in RoboVerse's v2 layout, of plain Python values."""
    raw = arrays(played)

    def frame(row: int) -> dict[str, Any]:
        cube = {"pos": raw["cube/pos"][row].tolist(), "rot": raw["cube/rot"][row].tolist()}
        robot = {"pos": [-0.615, 0.0, 0.0], "rot": [1.0, 0.0, 0.0, 0.0]}
        robot["dof_pos"] = dict(zip(PANDA, raw["franka/joint_pos"][row].tolist(), strict=True))
        return {"cube": cube, "franka": robot}

    targets = [dict(zip(PANDA, row, strict=True)) for row in played.actions.astype(float).tolist()]
    return {
        "init_state": frame(0),
        "actions": [{"dof_pos_target": target} for target in targets],
        "states": [frame(row) for row in range(1, len(targets) + 1)] if states else None,
    }


def write_robosuite(path: Path, episodes: list[Episode], *, base_z: float = 0.8, env: str = "Lift") -> Path:
    """Writes a robosuite file whose table top is at z = 0.8 m; returns its path."""
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        data.attrs["env"] = env
        data.attrs["env_info"] = json.dumps({"robots": "Panda"})
        for index, played in enumerate(episodes):
            raw, group = arrays(played), data.create_group(f"demo_{index + 1}")
            qpos = raw["franka/joint_pos"] * np.array([1.0] * 8 + [-1.0])
            pose = np.concatenate([raw["cube/pos"] + [0, 0, 0.8], raw["cube/rot"]], 1)
            speed = [raw["franka/joint_vel"], raw["cube/lin_vel"], raw["cube/ang_vel"]]
            time = np.arange(len(qpos))[:, None] / 20.0
            group["states"] = np.concatenate([time, qpos, pose, *speed], 1)
            shut = np.where(played.actions[:, 7] < 0.02, 1.0, -1.0)
            actions = np.zeros((len(qpos), 7))
            actions[:-1, 6] = shut
            group["actions"] = actions
            group.attrs["model_file"] = ROBOSUITE_XML.format(base_z=base_z)
    return path
