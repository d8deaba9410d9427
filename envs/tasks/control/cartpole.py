"""Cartpole, after Isaac Lab (``manager_based/classic/cartpole/cartpole_env_cfg.py``, BSD 3-Clause).

Mittal et al., "Orbit: A Unified Simulation Framework for Interactive Robot Learning Environments"
(arXiv:2301.04195). Observation, reward, ends and starts are Isaac Lab's; it has no success, so here an
episode is one when its return reaches 90 % of the largest, 5.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi
from typing import ClassVar, override

import numpy as np
import torch
from torch import Tensor

from envs.controllers import Controller, NormalizedPositionController
from envs.robots.cartpole import CARTPOLE
from envs.rotations import wrapped
from envs.scenario import CameraCfg, ScenarioCfg
from envs.state import EntityState, State
from envs.tasks.base import Task
from envs.tasks.control.scene import CONTROL_60_HZ, LOOKS, STEP_S
from envs.tasks.parameters import parameter


@dataclass(frozen=True, kw_only=True)
class Cartpole(Task):
    """Push a cart so that the pole on it stays upright, for 5 s.

    Attributes:
        bound_m: Distance of the cart from the middle at which an episode fails, m.
        start_m: Half width of the uniform start of the cart, m.
        start_m_s: Half width of its speed, m/s.
        start_rad: Half width of the pole's angle, rad, and of its speed, rad/s.
    """

    name: ClassVar[str] = "control/cartpole"
    instructions: ClassVar[tuple[str, ...]] = ("keep the pole upright",)
    max_episode_steps: ClassVar[int] = 300
    ends_on_success: ClassVar[bool] = False
    has_expert: ClassVar[bool] = False
    success_return: ClassVar[float | None] = 4.5

    bound_m: float = parameter(3.0, above=0.0)
    start_m: float = parameter(1.0, at_least=0.0, at_most=3.0)
    start_m_s: float = parameter(0.5, at_least=0.0)
    start_rad: float = parameter(pi / 4, at_least=0.0, at_most=pi)

    @property
    @override
    def scenario(self) -> ScenarioCfg:
        camera = CameraCfg(
            name="front", mount="cartpole/cart", turns=False, pos=(0.0, -4.0, 0.7), look_at=(0.0, 0.0, 0.0)
        )
        all_of_it = CameraCfg(name="rail", pos=(0.0, -8.0, 2.5), look_at=(0.0, 0.0, 2.0), fovy_deg=50.0)
        return ScenarioCfg(
            robots=(CARTPOLE,),
            cameras=(camera, all_of_it),
            appearance=LOOKS,
            table=None,
            room=None,
            ground_half_size_m=20.0,
            physics=CONTROL_60_HZ,
        )

    @property
    @override
    def controller(self) -> Controller:
        return NormalizedPositionController(CARTPOLE)

    @override
    def initial_state(self, rngs: Sequence[np.random.Generator]) -> State:
        half = np.array([self.start_m, self.start_rad, self.start_m_s, self.start_rad])
        sampled = np.stack([rng.uniform(-half, half) for rng in rngs])
        robot = EntityState.at_rest(
            np.array(CARTPOLE.pos), np.tile(CARTPOLE.rot, (len(rngs), 1)), sampled[:, :2]
        )
        robot.joint_vel = torch.from_numpy(sampled[:, 2:].copy())
        robot.joint_target = torch.zeros((len(rngs), 1), dtype=torch.float64)
        return State({CARTPOLE.name: robot}, {})

    @override
    def success(self, state: State) -> Tensor:
        """Returns False: the return decides."""
        return torch.zeros(state.num_envs, dtype=torch.bool, device=state.device)

    @override
    def failure(self, state: State) -> Tensor:
        return state.robots[CARTPOLE.name].joint_pos[:, 0].abs() > self.bound_m

    def reward(self, state: State) -> Tensor:
        """Returns being alive, less angle² and speeds, per step, (N,)."""
        robot = state.robots[CARTPOLE.name]
        lost = self.failure(state).to(robot.joint_pos.dtype)
        cart_speed, pole_speed = robot.joint_vel.abs().unbind(-1)
        angle = wrapped(robot.joint_pos[:, 1])
        reward = (1.0 - lost) - 2.0 * lost - angle**2 - 0.01 * cart_speed - 0.005 * pole_speed
        return STEP_S * reward

    def observe(self, state: State) -> Tensor:
        """Returns positions and speeds of cart and pole, m and rad, (N, 4)."""
        robot = state.robots[CARTPOLE.name]
        return torch.cat((robot.joint_pos, robot.joint_vel), dim=-1)

    @override
    def rl_observation(self, state: State) -> Tensor:
        return self.observe(state)
