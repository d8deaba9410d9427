"""One environment of a batch, whose hand is steered."""

import threading
from dataclasses import replace
from typing import Any

import numpy as np

from envs.core.errors import ConfigError
from envs.hand_pose_controller import HandPoseController
from envs.rotations import from_matrix
from envs.scenario import CameraCfg, LightCfg, RobotCfg
from envs.state import State
from envs.vector_env import RoboVerseVectorEnv
from roboverse_learn.teleoperation.recording import scene_of


def check_steerable(env: RoboVerseVectorEnv) -> None:
    """Checks that a hand can be steered, and that the task's actions can be recorded.

    Raises:
        ConfigError: The task's actions are not the joint targets of an arm.
    """
    robot = env.task.only_robot("Teleoperation")
    if tuple(env.controller.names) != robot.joint_names or not robot.gripper_joints:
        raise ConfigError(
            f"{env.task.name} cannot be teleoperated: its actions are {', '.join(env.controller.names[:8])}, "
            "and needed are the joint targets of an arm with a gripper, as of PickCube, StackCube, CloseBox, "
            "MoveSliderLeft, PickChocolatePudding and NutAssembly."
        )


class Station:
    """One environment: episodes start by index, the hand moves by deltas, states are read in one row.

    Args:
        env: Environments of the train split; see :func:`check_steerable`.
        env_id: Which of them.
        drawing: Held while something is rendered, where several threads render.
        shadows: Whether images have shadows, which are a third of what an image costs.

    Attributes:
        env_id: See above.
        controller: Maps motions of the hand to joint targets.
        robot: The robot.
        control_hz: Control steps per second.
        scene: What decides how episodes go on, as JSON values.
        protocol_seed: Seed of the episodes.
        state: The present state, one row.
        cameras: Names of the cameras.
    """

    state: State

    def __init__(
        self,
        env: RoboVerseVectorEnv,
        env_id: int,
        drawing: "threading.Lock | None" = None,
        *,
        shadows: bool = True,
    ) -> None:
        self._env, self.env_id, self._drawing = env, env_id, drawing or threading.Lock()
        self._shadows = shadows
        self.robot: RobotCfg = env.scenario.robots[0]
        self.controller = HandPoseController(self.robot)
        self.control_hz = float(env.control_hz)
        self.cameras = env.camera_names
        self._looking: dict[str, CameraCfg] = {}
        self.scene = scene_of(env.env_spec)
        self.protocol_seed = env.protocol_seed
        self._read()  # where every episode is done already none starts, and a page asks for the hand

    @property
    def instruction(self) -> str:
        """What is to be done in the present episode, in words."""
        return self._env.instruction(self.env_id)

    @property
    def initial_state_hash(self) -> str:
        """Names the start of the present episode; see the environment's."""
        return self._env.initial_state_hash(self.env_id)

    def start(self, episode: int) -> None:
        """Starts an episode of the train split."""
        self._env.reset_envs([self.env_id], [episode])
        looks = self._env.randomizer.appearance(episode)
        self._looking = {camera.name: camera for camera in self._env.scenario.cameras} | dict(looks.cameras)
        if not self._shadows:
            lights = looks.lights or self._env.scenario.appearance.lights or (LightCfg(),)
            plain = tuple(replace(light, cast_shadow=False) for light in lights)
            self._env.handler.set_appearance(replace(looks, lights=plain), self.env_id)
        self._read()

    def actions_of(self, hand_action: np.ndarray) -> np.ndarray:
        """Returns the task's action (A,) float32 with the effect of the hand's action (7,)."""
        return self.controller.as_task_actions(self.state, hand_action[None])[0].astype(np.float32)

    def step(self, action: np.ndarray) -> tuple[bool, bool]:
        """Advances by one control step with an action of the task; returns whether it succeeded or failed."""
        result = self._env.step_envs([self.env_id], action[None])
        self._read()
        success = bool(result.success[0])
        return success, bool(result.terminated[0]) and not success

    def restore(self, state: State) -> None:
        """Puts the environment into a state of the present episode, one row."""
        handler = self._env.handler
        handler.set_states(state.to(handler.device, handler.dtype), [self.env_id])
        self._read()

    def gripper(self) -> float:
        """Returns the entry of the hand's action that keeps the gripper as it is."""
        return float(self.controller.hold(self.state)[0, -1])

    def hand(self) -> dict[str, Any]:
        """Returns where the targets put the hand, as JSON values: ``pos`` in m, ``rot`` wxyz, ``gripper``."""
        robot = self.state.robots[self.robot.name]
        assert robot.joint_target is not None, "a simulator gives every robot's targets"
        pos, rot = self.controller.target_pose(robot.joint_pos, robot.joint_target)
        return {
            "pos": np.round(pos[0].numpy(), 5).tolist(),
            "rot": np.round(from_matrix(rot[0].numpy()), 5).tolist(),
            "gripper": round(self.gripper(), 3),
        }

    def view_yaw(self, camera: str) -> float:
        """Returns the direction, about the world's z from +x, in which a camera looks, rad.

        A camera that moves with the robot is taken to look where the robot faces, which is +x.
        """
        placed = self._looking.get(camera)
        if placed is None or placed.mount is not None:
            return 0.0
        x, y = np.subtract(placed.look_at, placed.pos)[:2]
        return float(np.arctan2(y, x))

    def observe(self) -> dict[str, np.ndarray]:
        """Returns what a policy observes now, without the axis of environments; this renders."""
        with self._drawing:
            return {key: value[0] for key, value in self._env.observe([self.env_id]).items()}

    def _read(self) -> None:
        self.state = self._env.get_states([self.env_id]).to("cpu")
