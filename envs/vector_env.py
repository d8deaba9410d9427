"""N environments of one task, stepped together: a handler, a task and a randomizer."""

import contextlib
from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from envs.array_ops import to_numpy
from envs.core.errors import ConfigError, unknown_name
from envs.episode_hash import episode_digest
from envs.lazy_images import LazyPixels, row_of
from envs.randomization import MaterialLibrary, Randomizer, channel_rng, channels_of, load_split
from envs.scenario import Appearance
from envs.simulators.hybrid import make_handler
from envs.state import State
from envs.step_checks import check_step
from envs.tasks.make import make_task
from envs.tasks.outcomes import outcome, solved

OBSERVATIONS = ("pixels", "state", "full")

ACTIONS = ("task", "rl")

STATE_LIMIT = 100.0
"""Bound of every entry of ``environment_state``: farther, m, than anything falls in an episode."""


class StepResult(NamedTuple):
    """What a control step did to n environments; each array is (n,)."""

    reward: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    success: np.ndarray


class RoboVerseVectorEnv(gymnasium.vector.VectorEnv):
    """A Gymnasium vector env, and what collection and evaluation need beside it.

    An episode is an index into the task's pool: object poses, looks and instruction follow from it and
    from ``protocol_seed``, whatever ``num_envs`` is. Success and failure end an episode (``terminated``),
    the task's horizon cuts it off (``truncated``); see :class:`~envs.tasks.base.Task`.

    Args:
        task: Name of a task.
        num_envs: Number of environments.
        split: ``"train"`` or ``"test"``: which episodes.
        level: Level of randomization, 0 to 3.
        only: One channel to vary instead of a level.
        simulator: Name of a simulator.
        renderer: Name of a renderer, or of another simulator that draws the pictures.
        observation: ``"pixels"`` (cameras and joint positions), ``"state"`` (joints and objects), or
            ``"full"`` (the task's ``rl_observation`` as environment state).
        cameras: Names of the cameras that are observed; none or None is the task's first.
        image_size: Height and width of every camera, or None for the scenario's.
        protocol_seed: Seeds every draw.
        materials: Folder of pictures in place of the built-in materials, with ``+`` before it beside them.
        num_threads: Threads of the simulator; 0 means one per core.
        autoreset_mode: Gymnasium's: what ``step`` does with an environment whose episode is over.
        task_kwargs: Options of the task.
        simulator_settings: Settings of the simulator that replace the scenario's, such as ``impratio`` of
            MuJoCo.
        scenario: What is changed of the task's scene; see :func:`envs.tasks.make.make_task`.
        actions: ``"task"`` for those of the task's ``controller``, ``"rl"`` for those of its
            ``rl_controller``.
    """

    def __init__(
        self,
        task: str,
        num_envs: int = 1,
        *,
        split: str,
        level: int | str = 0,
        only: str | None = None,
        simulator: str = "mujoco",
        renderer: str = "warp",
        observation: Literal["pixels", "state", "full"] = "pixels",
        cameras: Sequence[str] | None = None,
        image_size: int | None = None,
        protocol_seed: int = 0,
        materials: str | None = None,
        num_threads: int = 0,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        task_kwargs: Mapping[str, Any] | None = None,
        simulator_settings: Mapping[str, Any] | None = None,
        scenario: Mapping[str, Any] | None = None,
        actions: Literal["task", "rl"] = "task",
    ) -> None:
        if num_envs < 1:
            raise ConfigError(f"num_envs must be at least 1, given {num_envs}.")
        if observation not in OBSERVATIONS:
            raise unknown_name("observation", str(observation), OBSERVATIONS)
        if actions not in ACTIONS:
            raise unknown_name("kind of actions", str(actions), ACTIONS)
        self.task = make_task(task, task_kwargs, scenario)
        self.num_envs, self.observation = num_envs, observation
        self.simulator, self.renderer = simulator, renderer
        self.channels, self.protocol_seed = channels_of(level, only), protocol_seed
        scene = self.task.scenario.seen_by(cameras, image_size).tuned(simulator, simulator_settings or {})
        library = MaterialLibrary.chosen(materials)
        self.split = load_split(split, library)
        self.randomizer = Randomizer(
            scene.appearance,
            self.task.scenario.cameras,  # drawn for all, so that an episode does not depend on who looks
            channels=self.channels,
            split=self.split,
            seed=protocol_seed,
            library=library,
            scenario=self.task.scenario,
        )
        self.handler = make_handler(
            simulator,
            scene,
            num_envs,
            renderer=renderer,
            num_threads=num_threads,
            textures=library.texture,
        )
        self.handler.launch()
        self.scenario = scene
        self.controller = self.task.controller if actions == "task" else self.task.rl_controller
        self._robot = scene.robots[0]
        self._substeps = scene.physics.decimation
        self._in_arrays = self.task.takes_arrays and self.handler.device.type == "cpu"
        # An operation on tensors takes a third less time so; to enter it takes longer than one on arrays.
        self._judging = contextlib.nullcontext if self._in_arrays else torch.inference_mode
        self._every = np.arange(num_envs)
        self.episodes = np.full(num_envs, -1)
        self.elapsed_steps = np.zeros(num_envs, np.int64)
        self.returns = np.zeros(num_envs)
        self._instructions = [self.task.description] * num_envs
        self._began: list[tuple[State, int, Appearance] | None] = [None] * num_envs
        self._over = np.zeros(num_envs, bool)
        self._rngs = [np.random.default_rng(i) for i in range(num_envs)]
        self._make_spaces(AutoresetMode(autoreset_mode))

    def _make_spaces(self, autoreset_mode: AutoresetMode) -> None:
        box = gymnasium.spaces.Box
        low, high = np.array([joint.range for joint in self._robot.joints], np.float32).T
        self.single_action_space = box(self.controller.low, self.controller.high, dtype=np.float32)
        # Joint limits are soft: a collision can push a joint beyond its range by a little.
        spaces: dict[str, gymnasium.Space] = {"agent_pos": box(low - 1.0, high + 1.0, dtype=np.float32)}
        if self.observation == "pixels":
            spaces["pixels"] = gymnasium.spaces.Dict(
                {c.name: box(0, 255, (c.height, c.width, 3), np.uint8) for c in self.scenario.cameras}
            )
        else:
            self.reset_envs(self._every[:1], self.split_indices[:1])
            size = self._known(self._present(self._every[:1])).shape[-1]
            self.episodes[0], self._began[0] = -1, None  # that was no episode of anybody
            limit = np.inf if self.observation == "full" else STATE_LIMIT  # speeds have no bound
            spaces["environment_state"] = box(-limit, limit, (size,), np.float32)
        self.single_observation_space = gymnasium.spaces.Dict(spaces)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.metadata = {
            "render_modes": ["rgb_array"],
            "render_fps": round(self.control_hz),
            "autoreset_mode": autoreset_mode,
        }
        self.render_mode = "rgb_array"
        self._autoreset = autoreset_mode

    # -- what every caller may ask ------------------------------------------------------------------

    @property
    def control_hz(self) -> float:
        """Control steps per second."""
        return self.scenario.physics.control_hz

    @property
    def split_indices(self) -> np.ndarray:
        """Episodes of this env's split, in their frozen order."""
        return self.split.episodes

    @property
    def not_shown(self) -> tuple[str, ...]:
        """Properties of the looks that the renderer cannot show."""
        return self.handler.not_shown

    @property
    def camera_names(self) -> tuple[str, ...]:
        """Names of the cameras."""
        return tuple(camera.name for camera in self.scenario.cameras)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the robot's joints, the entries of ``observation.state``."""
        return self._robot.joint_names

    def initial_state_hash(self, env_id: int) -> str:
        """Returns the first 16 hex digits of the SHA-256 of how the present episode began and looks."""
        began = self._began[env_id]
        if began is None:
            return ""
        states, row, look = began
        return episode_digest(states.select([row]), look)

    def instruction(self, env_id: int) -> str:
        """Returns the instruction of the present episode."""
        return self._instructions[env_id]

    def draws(self, env_id: int) -> dict[str, Any]:
        """Returns what the channels drew for the present episode, as JSON values."""
        return self.randomizer.draws(int(self.episodes[env_id]))

    # -- episodes by index --------------------------------------------------------------------------

    def reset_envs(
        self,
        env_ids: Sequence[int] | np.ndarray,
        episodes: Sequence[int] | np.ndarray,
        states: State | None = None,
    ) -> None:
        """Starts these episodes, one per environment.

        Args:
            env_ids: The environments.
            episodes: Their episodes.
            states: How they begin, one row each, instead of as the task draws it; what it does not name
                begins as drawn.

        Raises:
            ConfigError: if an episode is not of this env's split.
        """
        env_ids, episodes = np.asarray(env_ids), np.asarray(episodes)
        looks = [self.randomizer.appearance(int(episode)) for episode in episodes]
        rngs = [channel_rng(self.protocol_seed, "task", int(episode)) for episode in episodes]
        drawn = self.task.initial_state(rngs)
        if states is None:
            states = drawn
        states = State(drawn.robots | states.robots, drawn.objects | states.objects)
        order = np.argsort(env_ids)
        self.handler.set_states(states.select(order), env_ids[order])
        for row, (env_id, episode) in enumerate(zip(env_ids.tolist(), episodes.tolist(), strict=True)):
            self.handler.set_appearance(looks[row], env_id)
            words = channel_rng(self.protocol_seed, "instruction", episode)
            self._instructions[env_id] = self.task.instruction(words)
            self._began[env_id] = (states, row, looks[row])
        self.episodes[env_ids] = episodes
        self.elapsed_steps[env_ids] = 0
        self.returns[env_ids] = 0.0
        self._over[env_ids] = False

    def step_envs(self, env_ids: Sequence[int] | np.ndarray, actions: np.ndarray) -> StepResult:
        """Steps these environments by one control step; ``actions`` (n, A) are the controller's."""
        order = np.argsort(env_ids)
        result = self._advance(np.asarray(env_ids)[order], np.asarray(actions)[order])
        back = np.argsort(order)
        return StepResult(*(values[back] for values in result))

    def observe(self, env_ids: Sequence[int] | np.ndarray | None = None) -> dict[str, np.ndarray]:
        """Returns LeRobot's observation of these environments now; pictures are drawn here.

        Returns:
            ``observation.state`` (n, J) float32, and ``observation.images.<camera>`` (n, H, W, 3) uint8
            or ``observation.environment_state`` (n, D) float32.
        """
        ids = self._every if env_ids is None else np.asarray(env_ids)
        order = np.argsort(ids)
        back, ids = np.argsort(order), ids[order]
        states = self._present(ids)
        out = {"observation.state": self._agent_pos(states)[back]}
        if self.observation == "pixels":
            for camera, pictures in self.handler.render(None, ("rgb",), ids).items():
                out[f"observation.images.{camera}"] = pictures["rgb"][back]
        else:
            out["observation.environment_state"] = self._known(states)[back]
        return out

    def get_states(self, env_ids: Sequence[int] | np.ndarray | None = None) -> State:
        """Returns the state of these environments."""
        return self.handler.get_states(env_ids)

    def _advance(self, env_ids: np.ndarray | None, actions: np.ndarray) -> StepResult:
        self.controller.advance(self.handler, actions, self._substeps, env_ids)
        self._states = states = self._present(env_ids)
        with self._judging():
            reward, terminated, success = map(to_numpy, outcome(self.task, states))
        rows = slice(None) if env_ids is None else env_ids
        self.elapsed_steps[rows] += 1
        self.returns[rows] += reward
        cut_off = self.elapsed_steps[rows] >= self.task.max_episode_steps
        success = solved(self.task, success, terminated | cut_off, self.returns[rows])
        return StepResult(reward.astype(np.float64, copy=False), terminated, cut_off & ~terminated, success)

    def _present(self, env_ids: np.ndarray | None = None) -> State:
        """Returns the states as the task takes them with least effort: in arrays, where it can."""
        states = self.handler.get_states(env_ids)
        return states.arrays() if self._in_arrays else states

    # -- Gymnasium ----------------------------------------------------------------------------------

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Starts new episodes.

        Args:
            seed: Environment i gets seed + i (or the i-th of a list); equal seeds give equal episodes.
            options: ``episodes``: the episode of each environment to reset; ``reset_mask`` (N,) bool:
                which environments to reset (all of them by default).
        """
        options = options or {}
        ids = np.flatnonzero(options.get("reset_mask", np.ones(self.num_envs, bool)))
        if seed is not None:
            seeds = [seed + i for i in range(self.num_envs)] if isinstance(seed, int) else list(seed)
            for env_id, value in enumerate(seeds):
                if value is not None:
                    self._rngs[env_id] = np.random.default_rng(value)
        episodes = options.get("episodes")
        if episodes is None:
            episodes = [self._rngs[env_id].choice(self.split_indices) for env_id in ids]
        self.reset_envs(ids, np.asarray(episodes))
        success = np.zeros(self.num_envs, bool)
        return self._gym_observation(self._present()), self._info(success)

    def step(
        self, actions: np.ndarray
    ) -> tuple[dict[str, Any], np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Steps every environment; ``actions`` (N, A) are the task's controller's.

        Raises:
            InvalidActionError: They have another shape, or are not finite.
            ResetNeededError: An environment was never reset.
        """
        actions = np.asarray(actions)
        check_step(actions, self.controller.names, self.episodes)
        begin = self._over.nonzero()[0] if self._autoreset == AutoresetMode.NEXT_STEP else self._every[:0]
        result = self._advance(None, actions)
        info = self._info(result.success)
        if len(begin):
            self._restart(begin)
            result = StepResult(
                *(np.where(np.isin(self._every, begin), 0, v).astype(v.dtype) for v in result)
            )
            info = self._info(result.success)
            self._states = self._present()
        self._over = result.terminated | result.truncated
        observation = self._gym_observation(self._states)
        if self._autoreset == AutoresetMode.SAME_STEP and self._over.any():
            info |= {"final_obs": self._rows_of(observation), "final_info": dict(info)}
            info |= {"_final_obs": self._over.copy(), "_final_info": self._over.copy()}
            self._restart(self._over.nonzero()[0])
            observation = self._gym_observation(self._present())
        return observation, result.reward, result.terminated, result.truncated, info

    def _restart(self, env_ids: np.ndarray) -> None:
        self.reset_envs(env_ids, [self._rngs[env_id].choice(self.split_indices) for env_id in env_ids])

    def _rows_of(self, observation: dict[str, Any]) -> np.ndarray:
        rows = np.full(self.num_envs, None, dtype=object)
        for env_id in self._over.nonzero()[0]:
            rows[env_id] = row_of(observation, int(env_id))
        return rows

    def _gym_observation(self, states: State) -> dict[str, Any]:
        observation: dict[str, Any] = {"agent_pos": self._agent_pos(states)}
        if self.observation != "pixels":
            observation["environment_state"] = self._known(states)
            return observation
        jobs = self.handler.snapshot()

        def draw() -> dict[str, np.ndarray]:
            return {name: kinds["rgb"] for name, kinds in self.handler.render_jobs(jobs).items()}

        observation["pixels"] = LazyPixels(self.camera_names, draw)
        return observation

    def _known(self, states: State) -> np.ndarray:
        observe = self.task.rl_observation if self.observation == "full" else self.task.observe
        with self._judging():
            return to_numpy(observe(states)).astype(np.float32)

    def _agent_pos(self, states: State) -> np.ndarray:
        return to_numpy(states.robots[self._robot.name].joint_pos).astype(np.float32)

    def _info(self, success: np.ndarray) -> dict[str, Any]:
        present = np.ones(self.num_envs, bool)
        told = {key: success.copy() for key in ("success", "is_success")}  # LeRobot asks for the second
        return told | {f"_{key}": present for key in told}

    def picture(self, env_id: int) -> np.ndarray:
        """Returns the first camera's picture of one environment, (H, W, 3) uint8, whatever is observed."""
        camera = self.camera_names[:1]
        return self.handler.render(camera, ("rgb",), [env_id])[camera[0]]["rgb"][0]

    def render(self) -> tuple[np.ndarray, ...]:
        """Returns the first camera's picture of every environment, each (H, W, 3) uint8."""
        return tuple(self.handler.render(self.camera_names[:1])[self.camera_names[0]]["rgb"])

    def close_extras(self, **_: Any) -> None:
        """Frees the simulator."""
        self.handler.close()
