"""Meta-World's own environments as functions of a state.

Meta-World keeps what an episode is about (goal, first poses, margins of its reward) in attributes that
``reset_model`` fills in. All of it follows from the episode's random vector. So a state that carries
this vector says everything: :class:`Original` makes the attributes of a vector once, keeps them, and puts
them back before it evaluates Meta-World at a state.
"""

import warnings
from collections import OrderedDict
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import metaworld
import mujoco
import numpy as np
from metaworld.env_dict import ALL_V3_ENVIRONMENTS
from metaworld.policies import ENV_POLICY_MAP

from envs.compat.mujoco4 import repair_metaworld

MAX_EPISODES_KEPT = 4096

FRAME_SIZE, OBSERVATION_SIZE = 18, 39
"""Meta-World observes this moment's frame, the last moment's, and the goal."""

_KINDS = (bool, int, float, str, tuple, list, np.ndarray, np.generic, type(None))
_KEPT_APART = {"np_random", "_np_random"}


@dataclass(frozen=True, slots=True)
class Pose:
    """Numbers that Meta-World's model is posed with, in its own order.

    Attributes:
        qpos: Joint positions, (nq,).
        qvel: Joint velocities, (nv,).
        ctrl: Targets of the fingers, (2,).
        mocap_pos: Where the hand is pulled to, m, (3,).
        body_pos: Positions of all bodies in their parents, m, (nbody, 3).
    """

    qpos: np.ndarray
    qvel: np.ndarray
    ctrl: np.ndarray
    mocap_pos: np.ndarray
    body_pos: np.ndarray


@dataclass(frozen=True, slots=True)
class Episode:
    """Values derived from a random vector.

    Attributes:
        start: How the episode begins.
        goal: Position of the goal, m, (3,).
        attributes: The environment's attributes after its reset.
        site_pos: Positions of all sites in their bodies, m, (nsite, 3).
    """

    start: Pose
    goal: np.ndarray
    attributes: dict[str, Any]
    site_pos: np.ndarray


class Original:
    """One of Meta-World's environments.

    Args:
        name: Its name, such as ``"drawer-open-v3"``.

    Attributes:
        env: The environment; its goal is observed, as in MT1.
        model: Its model.
        last_answers: The last queried pose, as bytes, and its results.
    """

    def __init__(self, name: str) -> None:
        repair_metaworld()
        with warnings.catch_warnings():
            # Gymnasium wonders at a space of float64 and at a version that is not the newest.
            warnings.simplefilter("ignore")
            self.env: Any = ALL_V3_ENVIRONMENTS[name]()
        # The space was made while the goal was still hidden; it bounds what is observed of it.
        self.env.__dict__.pop("sawyer_observation_space", None)
        self.env._partially_observable = False
        self.env._set_task_called = True
        self.model: mujoco.MjModel = self.env.model
        self._data: mujoco.MjData = self.env.data
        self._policy = ENV_POLICY_MAP[name]()
        none = np.zeros(0)
        self.last_answers: tuple[bytes, tuple[np.ndarray, np.ndarray, np.ndarray]] = b"-", (none, none, none)
        self._episodes: OrderedDict[bytes, Episode] = OrderedDict()
        self._settle()

    @property
    def scene(self) -> str:
        """Asset reference of the scene's file."""
        root = Path(metaworld.__file__).parent
        return f"metaworld:{Path(self.env.model_name).resolve().relative_to(root.resolve()).as_posix()}"

    @property
    def vector_size(self) -> int:
        """Length of a random vector."""
        return int(self.env._random_reset_space.low.size)

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        """Draws the random vector of an episode from Meta-World's own distribution."""
        env = self.env
        env._freeze_rand_vec, env.seeded_rand_vec, env.np_random = False, True, rng
        self._reset_but_hand()
        return np.array(env._last_rand_vec, np.float64)

    def episode(self, vector: np.ndarray) -> Episode:
        """Returns the episode of a random vector."""
        vector = np.array(vector, np.float64)
        key = vector.tobytes()
        if key in self._episodes:
            self._episodes.move_to_end(key)
        else:
            self._episodes[key] = self._begin(vector)
            if len(self._episodes) > MAX_EPISODES_KEPT:
                self._episodes.popitem(last=False)
        return self._episodes[key]

    def evaluate(self, vector: np.ndarray, pose: Pose) -> tuple[np.ndarray, float, bool]:
        """Returns Meta-World's observation (39,), reward in [0, 10] and success of a pose.

        Both frames of the observation are the present one: a state has no history.
        """
        self._restore(self.episode(vector), pose)
        action = np.array([0.0, 0.0, 0.0, pose.ctrl[0]], np.float32)
        observation, reward, info = self._ask(action)
        return observation, reward, bool(info["success"])

    def action(self, observation: np.ndarray) -> np.ndarray:
        """Returns the scripted policy's action (4,) float32 for an observation (39,), in [-1, 1]."""
        with warnings.catch_warnings():
            # It warns that actions beyond 1 are clipped.
            warnings.simplefilter("ignore")
            action = self._policy.get_action(np.array(observation, np.float64))  # it writes into it
        return np.clip(action, -1.0, 1.0)

    def _settle(self) -> None:
        """Sets every attribute, so that an episode does not depend on what ran before it."""
        rng = np.random.default_rng(0)
        self.env._freeze_rand_vec, self.env.seeded_rand_vec, self.env.np_random = False, True, rng
        self.env.reset()

    def _reset_but_hand(self) -> None:
        """Meta-World's reset without the 250 physics steps that bring the hand to its place."""
        self.env._reset_hand = lambda steps=50: None
        self.env.reset_model()
        del self.env._reset_hand

    def _begin(self, vector: np.ndarray) -> Episode:
        env, model, data = self.env, self.model, self._data
        env._freeze_rand_vec, env._last_rand_vec = True, vector
        # Meta-World's reset runs reset_model twice; of the first run, the bodies' places are left.
        self._reset_but_hand()
        mujoco.mj_resetData(model, data)
        env.reset_model()
        start = Pose(
            qpos=data.qpos.copy(),
            qvel=data.qvel.copy(),
            ctrl=data.ctrl.copy(),
            mocap_pos=data.mocap_pos[0].copy(),
            body_pos=model.body_pos.copy(),
        )
        goal = np.array(env._target_pos, np.float64)
        # Some attributes are made by the first evaluation.
        self._forward()
        self._ask(np.array([0.0, 0.0, 0.0, data.ctrl[0]], np.float32))
        return Episode(start, goal, self._attributes(), model.site_pos.copy())

    def _attributes(self) -> dict[str, Any]:
        """Returns the attributes; arrays that look into the simulation stay such views."""
        kept = {}
        for name, value in vars(self.env).items():
            if isinstance(value, _KINDS) and name not in _KEPT_APART:
                kept[name] = _apart(value)
        return kept

    def _restore(self, episode: Episode, pose: Pose) -> None:
        for name, value in episode.attributes.items():
            setattr(self.env, name, _apart(value))
        data = self._data
        self.model.site_pos[:] = episode.site_pos
        self.model.body_pos[:] = pose.body_pos
        data.qpos[:], data.qvel[:], data.ctrl[:] = pose.qpos, pose.qvel, pose.ctrl
        data.mocap_pos[0] = pose.mocap_pos
        data.mocap_quat[0] = (1.0, 0.0, 1.0, 0.0)
        data.qacc_warmstart[:] = 0.0
        self._forward()

    def _forward(self) -> None:
        for site, pos in self.env._target_site_config:
            self.env._set_pos_site(site, pos)
        mujoco.mj_forward(self.model, self._data)

    def _ask(self, action: np.ndarray) -> tuple[np.ndarray, float, dict[str, Any]]:
        env = self.env
        env._prev_obs = env._get_curr_obs_combined_no_goal()
        space = env.sawyer_observation_space
        observation = np.clip(env._get_obs(), space.low, space.high)
        reward, info = env.evaluate_state(observation, action)
        return observation, float(reward), info


def _apart(value: Any) -> Any:
    """Copies an array that is no view of another one."""
    return value.copy() if isinstance(value, np.ndarray) and value.base is None else value


@cache
def original(name: str) -> Original:
    """Returns the environment of that name; there is one of each in a process."""
    return Original(name)
