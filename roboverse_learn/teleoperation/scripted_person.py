"""A scripted person: the task's expert, who steers the hand by the same messages as a browser."""

from collections import deque
from typing import override

import numpy as np
import torch

from envs.kinematics.forward import rotation_vector
from envs.randomization import channel_rng
from envs.state import State
from envs.tasks.planner import Planner
from roboverse_learn.teleoperation.protocol import Button, Move, Press
from roboverse_learn.teleoperation.session import Phase, Session
from roboverse_learn.teleoperation.station import Station


class ExpertHand:
    """Turns the joint targets of an expert's plans into motions of the hand.

    Args:
        station: The environment that is steered.
        planner: Makes the plans.
        seed: Seed of the episodes.
    """

    def __init__(self, station: Station, planner: Planner, seed: int = 0) -> None:
        self._station, self._planner, self._seed = station, planner, seed
        self._plan: deque[np.ndarray] = deque()
        self._seq = 0

    def begin(self, episode: int) -> None:
        """Prepares for an episode."""
        self._rng = channel_rng(self._seed, "expert", episode)
        self._plan.clear()

    def replan(self) -> None:
        """Drops the plan: the next motion is planned from the state that there is then."""
        self._plan.clear()

    def move(self, state: State) -> Move | None:
        """Returns the next motion from a state of one row; None where the expert gives up."""
        if not self._plan:
            self._plan.extend(self._planner.plan(state, self._rng))
        if not self._plan:
            return None
        self._seq += 1
        rate, gripper = self.towards(state, self._plan.popleft())
        return Move(seq=self._seq, rate=rate, gripper=gripper, device="expert")

    def path(self, state: State) -> np.ndarray:
        """Returns where the hand goes if the expert solves the task from a state, m, (T, 3)."""
        plan = torch.as_tensor(self._planner.plan(state, self._rng), dtype=torch.float64)
        joints = state.robots[self._station.robot.name].joint_pos
        pos, _ = self._station.controller.target_pose(joints.expand(len(plan), -1), plan)
        return pos.numpy()

    def towards(self, state: State, targets: np.ndarray) -> tuple[tuple[float, ...], float]:
        """Returns the rate and the gripper of a motion that puts the hand where joint targets (D,) put it."""
        controller, robot = self._station.controller, state.robots[self._station.robot.name]
        assert robot.joint_target is not None, "a simulator gives every robot's targets"
        wanted = torch.as_tensor(targets, dtype=torch.float64)[None]
        pos, rot = controller.target_pose(robot.joint_pos, wanted)
        now, turned = controller.target_pose(robot.joint_pos, robot.joint_target)
        way = (pos - now)[0] / controller.delta_m
        turn = rotation_vector(rot @ turned.transpose(1, 2))[0] / controller.delta_rad
        rate = torch.cat([way, turn]).clamp(-1.0, 1.0).tolist()
        return tuple(rate), float(controller.gripper_entry(wanted)[0].clamp(-1.0, 1.0))


class ExpertPerson:
    """Presses the buttons of a session and steers it as the expert would, one tick at a time.

    Args:
        session: The session.
        hand: The expert's hand in its environment.
    """

    def __init__(self, session: Session, hand: ExpertHand) -> None:
        self._session, self._hand, self._episode = session, hand, -1
        session.operator, session.connected = "expert", True

    def tick(self) -> None:
        """Submits what is pressed and moved before the session's next tick."""
        session = self._session
        episode = session.episode
        if session.phase is Phase.OVER or episode is None:
            return
        if session.phase is not Phase.RUNNING:
            session.submit(Press(button=Button.START))
            self._hand.begin(episode)
        move = self._hand.move(session.station.state)
        session.submit(self._given_up() if move is None else move)

    def _given_up(self) -> Press:
        """Returns what ends an episode in which the expert gives up; one not begun is passed over."""
        return Press(button=Button.FINISH if self._session.step else Button.DISCARD)


STRAYED_M = 0.08
"""Distance of the hand from the expert's path at which a policy has strayed."""

PATIENCE = 0.6
"""Share of the task's steps after which a policy that has not solved it has strayed, too."""


class ExpertCorrector(ExpertPerson):
    """Lets a policy act, and takes over where it strays: by deviation from the expert's path, or by time.

    Args:
        session: A session with a policy.
        hand: The expert's hand in its environment.
        max_steps: The task's control steps.
    """

    def __init__(self, session: Session, hand: ExpertHand, max_steps: int) -> None:
        super().__init__(session, hand)
        self._patience = round(PATIENCE * max_steps)
        self._path = np.zeros((0, 3))

    @override
    def tick(self) -> None:
        session = self._session
        episode = session.episode
        if session.phase is Phase.OVER or episode is None:
            return
        if session.phase is not Phase.RUNNING:
            session.submit(Press(button=Button.START))
            self._hand.begin(episode)
            self._path = self._hand.path(session.station.state)
            self._hand.begin(episode)
        elif session.acting == "policy" and self._strayed():
            session.submit(Press(button=Button.TAKEOVER))
            self._hand.replan()
        acts = session.acting == "person" or self._strayed()
        move = self._hand.move(session.station.state) if acts else Move(device="expert")
        session.submit(self._given_up() if move is None else move)

    def _strayed(self) -> bool:
        pos = np.array(self._session.station.hand()["pos"])
        return self._session.step >= self._patience or (
            len(self._path) > 0 and np.linalg.norm(self._path - pos, axis=1).min() > STRAYED_M
        )
