"""N environments of one task behind Gymnasium's vector interface, with NumPy arrays."""

import contextlib
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, Literal, override

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from envs.array_ops import to_numpy
from envs.batched_env import BatchedEnv, StepResult
from envs.core.errors import unknown_name
from envs.episode_hash import episode_digest
from envs.lazy_images import LazyPixels, rows_of
from envs.randomization import Randomizer, channel_rng
from envs.scenario import Appearance
from envs.simulators.base import EnvIds, Handler
from envs.state import State, concatenated
from envs.step_checks import check_step, read_reset_options
from envs.tasks.base import Task
from envs.tasks.outcomes import Outcome, outcome

OBSERVATIONS = ("pixels", "state", "full")

ACTIONS = ("task", "rl")

STATE_LIMIT = 100.0
"""Bound of every entry of ``environment_state``, m: nothing falls farther in an episode."""


class RoboVerseVectorEnv(gymnasium.vector.VectorEnv, BatchedEnv):
    """N environments of one task: Gymnasium's vector interface, and episodes by index.

    An episode is an index into the task's pool: object poses, appearance and instruction follow from it and
    from the randomizer's seed, whatever ``num_envs`` is. Success and failure end an episode
    (``terminated``), the task's time limit cuts it off (``truncated``); see :class:`~envs.tasks.base.Task`.
    Make one with :meth:`envs.spec.EnvSpec.make`.

    Args:
        task: The task.
        handler: Its simulator, not yet launched.
        randomizer: Draws the appearance and the instruction of episodes, with the same task; its split is the
            environment's.
        observation: ``"pixels"`` (cameras and joint positions), ``"state"`` (joints and objects), or
            ``"full"`` (the task's ``rl_observation`` as environment state).
        actions: ``"task"`` for those of the task's ``controller``, ``"rl"`` for those of its
            ``rl_controller``.
        autoreset_mode: Gymnasium's: what ``step`` does with an environment whose episode is over.

    Raises:
        UnknownNameError: There is no such observation or kind of actions.
    """

    def __init__(
        self,
        task: Task,
        handler: Handler,
        randomizer: Randomizer,
        *,
        observation: Literal["pixels", "state", "full"] = "pixels",
        actions: Literal["task", "rl"] = "task",
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ) -> None:
        if observation not in OBSERVATIONS:
            raise unknown_name("observation", str(observation), OBSERVATIONS)
        if actions not in ACTIONS:
            raise unknown_name("kind of actions", str(actions), ACTIONS)
        controller = task.controller if actions == "task" else task.rl_controller
        BatchedEnv.__init__(self, task, handler, controller)
        self.observation, self.randomizer = observation, randomizer
        self._num_starts, self._places = task.num_fixed_starts, {}
        self._in_arrays = task.takes_arrays and handler.device.type == "cpu"
        # Inference mode makes operations on tensors 1.5× faster; entering it costs more than NumPy needs.
        self._judging = contextlib.nullcontext if self._in_arrays else torch.inference_mode
        self._every = np.arange(self.num_envs)
        self.episodes = np.full(self.num_envs, -1)
        self.elapsed_steps = np.zeros(self.num_envs, np.int64)
        self.returns = np.zeros(self.num_envs)
        self._instructions = [task.description] * self.num_envs
        self._starts: list[tuple[State, int, Appearance] | None] = [None] * self.num_envs
        self._over = np.zeros(self.num_envs, bool)
        self._rngs = [np.random.default_rng(i) for i in range(self.num_envs)]
        self._make_spaces(AutoresetMode(autoreset_mode))

    def _make_spaces(self, autoreset_mode: AutoresetMode) -> None:
        box = gymnasium.spaces.Box
        low, high = (np.array(limits, np.float32) for limits in self.task.state_limits)
        self.single_action_space = box(self.controller.low, self.controller.high, dtype=np.float32)
        spaces: dict[str, gymnasium.Space] = {"agent_pos": box(low, high, dtype=np.float32)}
        if self.observation == "pixels":
            spaces["pixels"] = gymnasium.spaces.Dict(
                {c.name: box(0, 255, (c.height, c.width, 3), np.uint8) for c in self.scenario.cameras}
            )
        else:
            self.reset_envs(self._every[:1], self.split_indices[:1])
            size = self._environment_state(self._present(self._every[:1])).shape[-1]
            self.episodes[0], self._starts[0] = -1, None  # it was started for its size alone
            limit = np.inf if self.observation == "full" else STATE_LIMIT  # speeds have no bound
            spaces["environment_state"] = box(-limit, limit, (size,), np.float32)
        self.single_observation_space = gymnasium.spaces.Dict(spaces)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        fps = round(self.control_hz)
        self.metadata = {"render_modes": ["rgb_array"], "render_fps": fps, "autoreset_mode": autoreset_mode}
        self.render_mode = "rgb_array"
        self._autoreset = autoreset_mode

    # -- properties ---------------------------------------------------------------------------------

    @cached_property
    @override
    def observation_space(self) -> gymnasium.Space:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Of all environments; made when it is asked for, since the bounds of 500 images take a second."""
        return batch_space(self.single_observation_space, self.num_envs)

    @property
    def simulator(self) -> str:
        """Name of the simulator."""
        return self.env_spec.simulator

    @property
    def renderer(self) -> str:
        """Name of the renderer."""
        return self.env_spec.renderer

    @property
    def channels(self) -> tuple[str, ...]:
        """Randomization channels that vary."""
        return self.randomizer.channels

    @property
    def protocol_seed(self) -> int:
        """Seed of every random number."""
        return self.randomizer.seed

    @property
    def split_indices(self) -> np.ndarray:
        """Episodes of this environment's split, in their frozen order."""
        return self.randomizer.split.episodes

    @property
    def state_names(self) -> tuple[str, ...]:
        """What the entries of ``observation.state`` are: the robot's joints, unless the task has others."""
        return self.task.state_names

    def initial_state_hash(self, env_id: int) -> str:
        """Returns the first 16 hex digits of the SHA-256 of the episode's initial state and appearance."""
        start = self._starts[env_id]
        if start is None:
            return ""
        states, row, appearance = start
        return episode_digest(states.select([row]), appearance)

    def instruction(self, env_id: int) -> str:
        """Returns the instruction of the present episode."""
        return self._instructions[env_id]

    def set_instruction(self, env_id: int, instruction: str) -> None:
        """Gives the present episode of an environment another instruction, from its next observation on."""
        self._instructions[env_id] = instruction

    def draws(self, env_id: int) -> dict[str, Any]:
        """Returns the channels' sampled values for the present episode, as JSON values."""
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
            states: Initial states in place of the task's samples, one row each; absent robots and objects
                start as sampled.

        Raises:
            ConfigError: An episode is not in this environment's split.
        """
        env_ids, episodes = np.asarray(env_ids), np.asarray(episodes)
        looks = [self.randomizer.appearance(int(episode)) for episode in episodes]
        rngs = [channel_rng(self.protocol_seed, "task", int(episode)) for episode in episodes]
        sampled = self._fixed_starts(episodes) if self._num_starts else self.task.initial_state(rngs)
        given = states
        if states is None:
            states = sampled
        states = State(sampled.robots | states.robots, sampled.objects | states.objects)
        if self.randomizer.changes_starts:
            states = self._varied(states, episodes, given)
        order = np.argsort(env_ids)
        self.handler.set_states(states.select(order), env_ids[order])
        for row, (env_id, episode) in enumerate(zip(env_ids.tolist(), episodes.tolist(), strict=True)):
            self.handler.set_appearance(looks[row], env_id)
            self._instructions[env_id] = self.randomizer.instruction(episode)
            self._starts[env_id] = (states, row, looks[row])
        self.episodes[env_ids] = episodes
        self._clear(env_ids)
        self._over[env_ids] = False

    def _varied(self, states: State, episodes: np.ndarray, given: State | None) -> State:
        """Returns the starts of episodes as the channels change them; what was given stays."""
        rows = [
            self.randomizer.start(int(episode), states.select([row])) for row, episode in enumerate(episodes)
        ]
        varied = concatenated(rows)
        if given is None:
            return varied
        return State(varied.robots | given.robots, varied.objects | given.objects)

    def step_envs(self, env_ids: Sequence[int] | np.ndarray, actions: np.ndarray) -> StepResult:
        """Steps these environments by one control step; ``actions`` (n, A) are the controller's."""
        order = np.argsort(env_ids)
        _, result = self._advance(np.asarray(actions)[order], np.asarray(env_ids)[order])
        back = np.argsort(order)
        return StepResult(*(values[back] for values in result))

    def observe(self, env_ids: Sequence[int] | np.ndarray | None = None) -> dict[str, np.ndarray]:
        """Returns LeRobot's observation of these environments now, and renders their images.

        Returns:
            ``observation.state`` (n, S) float32; ``observation.images.<camera>`` (n, H, W, 3) uint8 or
            ``observation.environment_state`` (n, D) float32; and the instructions as ``task``, (n,) strings.
        """
        ids = self._every if env_ids is None else np.asarray(env_ids)
        order = np.argsort(ids)
        back, ordered = np.argsort(order), ids[order]
        states = self._present(ordered)
        out = {"observation.state": self._agent_pos(states)[back]}
        if self.observation == "pixels":
            for camera, images in self.handler.render(None, ("rgb",), ordered).items():
                out[f"observation.images.{camera}"] = self.as_observed(images["rgb"])[back]
        else:
            out["observation.environment_state"] = self._environment_state(states)[back]
        out["task"] = np.array([self._instructions[env_id] for env_id in ids])
        return out

    @override
    def _judge(self, states: State) -> Outcome:
        with self._judging():
            reward, terminated, success = map(to_numpy, outcome(self.task, states))
        return Outcome(reward.astype(np.float64, copy=False), terminated, success)

    @override
    def _present(self, env_ids: EnvIds = None) -> State:
        states = self.handler.get_states(env_ids)
        return states.arrays() if self._in_arrays else states

    # -- Gymnasium ----------------------------------------------------------------------------------

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Starts new episodes.

        Args:
            seed: Environment i gets seed + i (or the i-th of a list); equal seeds give equal episodes. Where
                a task has fixed starts, seeds in a row give starts in a row.
            options: ``episodes``: the episode of each environment to reset; ``reset_mask`` (N,) bool:
                which environments to reset (all of them by default).

        Raises:
            ConfigError: The episodes or the mask do not fit the environments; nothing has changed then.
            UnknownNameError: There is no such option.
        """
        ids, episodes = read_reset_options(options, self.num_envs)
        if seed is not None:
            seeds = [seed + i for i in range(self.num_envs)] if isinstance(seed, int) else list(seed)
            for env_id, value in enumerate(seeds):
                if value is not None:
                    self._rngs[env_id] = np.random.default_rng(value)
            if self._num_starts and None not in seeds and episodes is None:
                episodes = [int(self.split_indices[seeds[i] % self._num_starts]) for i in ids]
        self._restart(ids, episodes)
        return self._gym_observation(self._present()), self._info(np.zeros(self.num_envs, bool))

    def step(
        self, actions: np.ndarray
    ) -> tuple[dict[str, Any], np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Steps every environment; ``actions`` (N, A) are the controller's.

        Raises:
            InvalidActionError: They have another shape, or are not finite.
            ResetNeededError: An environment was never reset.
        """
        restarts = self._autoreset is AutoresetMode.NEXT_STEP and self._over.any()
        states, result = self._checked_step(np.asarray(actions))
        if restarts:
            started = self._over.copy()
            self._restart(started.nonzero()[0])
            result = StepResult(*(np.where(started, 0, v).astype(v.dtype) for v in result))
            states = self._present()
        self._over = result.over
        info, observation = self._info(result.success), self._gym_observation(states)
        if self._autoreset is AutoresetMode.SAME_STEP and self._over.any():
            info |= {"final_obs": rows_of(observation, self._over), "final_info": dict(info)}
            info |= {"_final_obs": self._over.copy(), "_final_info": self._over.copy()}
            self._restart(self._over.nonzero()[0])
            observation = self._gym_observation(self._present())
        return observation, result.reward, result.terminated, result.truncated, info

    def step_without_restarts(self, actions: np.ndarray) -> tuple[dict[str, Any], StepResult]:
        """Does what :meth:`step` does with ``AutoresetMode.DISABLED``, and makes no ``info``.

        Returns:
            The observations, and the outcome of the step.
        """
        states, result = self._checked_step(actions)
        self._over = result.over
        return self._gym_observation(states), result

    def _checked_step(self, actions: np.ndarray) -> tuple[State, StepResult]:
        check_step(actions, self.controller.names, self.episodes)
        return self._advance(actions)

    def _restart(self, env_ids: np.ndarray, episodes: Sequence[int] | None = None) -> None:
        """Starts episodes in these environments, by default ones that their generators sample."""
        if episodes is None:
            episodes = [self._rngs[env_id].choice(self.split_indices) for env_id in env_ids]
        self.reset_envs(env_ids, episodes)

    def _gym_observation(self, states: State) -> dict[str, Any]:
        observation: dict[str, Any] = {"agent_pos": self._agent_pos(states)}
        if self.observation != "pixels":
            observation["environment_state"] = self._environment_state(states)
            return observation
        jobs = self.handler.snapshot()

        def draw() -> dict[str, np.ndarray]:
            images = self.handler.render_jobs(jobs)
            return {name: self.as_observed(kinds["rgb"]) for name, kinds in images.items()}

        observation["pixels"] = LazyPixels(self.camera_names, draw)
        return observation

    def _environment_state(self, states: State) -> np.ndarray:
        observe = self.task.rl_observation if self.observation == "full" else self.task.observe
        with self._judging():
            return to_numpy(observe(states)).astype(np.float32)

    def _agent_pos(self, states: State) -> np.ndarray:
        return to_numpy(self.task.proprioception(states)).astype(np.float32)

    def as_observed(self, images: np.ndarray) -> np.ndarray:
        """Returns images (n, H, W, 3) as a policy gets them."""
        return np.ascontiguousarray(images[:, :, ::-1]) if self.task.mirrored_images else images

    def _fixed_starts(self, episodes: np.ndarray) -> State:
        """Returns the fixed starts of episodes: the k-th of the split begins in the k-th, and then again."""
        if not self._places:
            self._places = {int(episode): place for place, episode in enumerate(self.split_indices)}
        return self.task.fixed_starts([self._places[int(e)] % self._num_starts for e in episodes])

    def _info(self, success: np.ndarray) -> dict[str, Any]:
        present = np.ones(self.num_envs, bool)
        info = {key: success.copy() for key in ("success", "is_success")}  # LeRobot reads the second
        return info | {f"_{key}": present for key in info}

    def render(self) -> tuple[np.ndarray, ...]:
        """Returns the first camera's image of every environment, each (H, W, 3) uint8."""
        return tuple(self.handler.render(self.camera_names[:1])[self.camera_names[0]]["rgb"])

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Returns the value of ``name`` for each environment: what LeRobot's evaluation calls.

        Raises:
            AttributeError: ``name`` is none of ``task``, ``task_description``, ``_max_episode_steps`` and
                ``render``.
        """
        known: dict[str, Callable[[], tuple[Any, ...]]] = {
            "render": self.render,
            "task_description": lambda: tuple(self._instructions),
            "task": lambda: (self.task.name,) * self.num_envs,
            "_max_episode_steps": lambda: (self.max_episode_steps,) * self.num_envs,
        }
        if name not in known:
            raise AttributeError(
                f"RoboVerse's vector env has no '{name}' to call; it has {', '.join(known)}."
            )
        return known[name]()

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Returns the value of ``name`` for each environment; see :meth:`call`."""
        return self.call(name)

    def close_extras(self, **_: Any) -> None:
        """Frees the simulator."""
        BatchedEnv.close(self)
