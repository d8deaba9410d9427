"""N environments of one task as batched tensors, for agents that learn by reward.

Shapes: N environments, D entries of an observation, A entries of an action, K initial states.
"""

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol

import numpy as np
import torch
from torch import Tensor

from envs.core.errors import ConfigError
from envs.scenario import ScenarioCfg
from envs.simulators import HANDLERS
from envs.simulators.base import Handler
from envs.start_states import BANK_SIZE, expert_bank, initial_bank
from envs.state import State
from envs.tasks.make import make_task
from envs.tasks.outcomes import outcome, solved


class EnvStep(NamedTuple):
    """What a control step did to every environment.

    Attributes:
        obs: What is seen next, (N, D): already of the new episode where one is over.
        reward: What the agent learns from, (N,).
        terminated: The episode is over for good: nothing comes after it, (N,) bool.
        truncated: The episode was cut off: its value goes on with ``final_obs``, (N,) bool.
        final_obs: The last observation of the episode that the step belongs to, (N, D).
        success: Whether the episode is solved, (N,) bool.
    """

    obs: Tensor
    reward: Tensor
    terminated: Tensor
    truncated: Tensor
    final_obs: Tensor
    success: Tensor


class EpisodeStatistics(NamedTuple):
    """Means over the episodes that ended since the last call.

    Attributes:
        episodes: Their number; the means are NaN where it is 0.
        episode_return: Return, of the task's own reward.
        length: Control steps.
        success_rate: Share that was solved.
        by_task: The same of each task by its name, where there are several.
    """

    episodes: int
    episode_return: float
    length: float
    success_rate: float
    by_task: "Mapping[str, EpisodeStatistics]" = MappingProxyType({})

    def means(self) -> dict[str, float]:
        """Returns what is logged: nothing of no episode, and of a task as in ``success_rate/PickCube``."""
        own = {
            "episode_return": self.episode_return,
            "episode_length": self.length,
            "success_rate": self.success_rate,
        }
        return (own if self.episodes else {}) | {
            f"{name}/{task}": value
            for task, statistics in self.by_task.items()
            for name, value in statistics.means().items()
        }


class BatchedEnv(Protocol):
    """What the adapters in :mod:`envs.adapters` take: this module's class, or a test's chain of states."""

    num_envs: int
    device: torch.device
    observation_size: int
    action_size: int
    max_episode_steps: int
    elapsed_steps: Tensor

    def reset(self, mask: Tensor | None = None) -> Tensor:
        """Starts new episodes everywhere, or where ``mask`` (N,) says so; returns observations (N, D)."""
        ...

    def step(self, actions: Tensor) -> EnvStep:
        """Steps every environment."""
        ...

    def seed(self, seed: int) -> None:
        """Seeds what is drawn from now on."""
        ...

    def close(self) -> None:
        """Frees the simulator."""
        ...


class TorchVectorEnv:
    """A task for an agent that learns by reward: tensors in, tensors out, on the simulator's device.

    Actions are those of the task's ``rl_controller``, observations those of ``rl_observation``, float32.
    An episode that is over starts anew in the same step. Episodes begin at states that the task drew for
    episodes of the split, once; how they look is not drawn, for nothing is seen.

    Reward: where success ends an episode, the agent is paid the task's reward less 1, which is what it
    would get if it stayed solved for ever at 1 a step, moved by a constant: going on next to the goal, at
    nearly 1 a step, never pays more than reaching it. A failure pays for the steps that are left.
    :meth:`pop_statistics` tells the task's own return. ``shift_reward=False`` pays the task's own reward.

    Args:
        task: Name of a task.
        num_envs: N.
        simulator: Name of a simulator.
        split: ``"train"`` or ``"test"``: of which episodes the initial states are.
        device: Where tensors come out; the simulator's device by default.
        seed: Seeds which initial states are drawn.
        max_episode_steps: Control steps after which an episode is cut off; the task's by default.
        task_kwargs: Options of the task.
        shift_reward: See above.
        protocol_seed: Seed of the episodes.
        bank_size: K, initial states that are drawn.
        num_threads: Threads of the simulator; 0 means one per core.
        simulator_settings: Settings of the simulator that replace the scenario's.
        scenario: What is changed of the task's scene; see :func:`envs.tasks.make.make_task`.
        substeps: Physics steps per control step; the task's by default. Fewer are longer, faster to
            simulate, and coarser.
        expert_starts: Share of the episodes that begin somewhere on the expert's way; see
            :mod:`envs.start_states`.
    """

    def __init__(
        self,
        task: str,
        num_envs: int,
        *,
        simulator: str = "mujoco",
        split: str = "train",
        device: str | torch.device | None = None,
        seed: int = 0,
        max_episode_steps: int | None = None,
        task_kwargs: Mapping[str, Any] | None = None,
        shift_reward: bool = True,
        protocol_seed: int = 0,
        bank_size: int = BANK_SIZE,
        num_threads: int = 0,
        simulator_settings: Mapping[str, Any] | None = None,
        scenario: Mapping[str, Any] | None = None,
        substeps: int | None = None,
        expert_starts: float = 0.0,
    ) -> None:
        if num_envs < 1:
            raise ConfigError(f"num_envs must be at least 1, given {num_envs}.")
        if not 0.0 <= expert_starts <= 1.0:
            raise ConfigError(f"expert_starts is a share from 0 to 1, given {expert_starts}.")
        self.task = make_task(task, task_kwargs, scenario)
        self.num_envs = num_envs
        scene = self.task.scenario.tuned(simulator, simulator_settings or {})
        if substeps is not None:
            scene = replace(scene, physics=scene.physics.divided(substeps))
        self.handler = self._make_handler(simulator, scene, num_threads)
        self.handler.launch()
        self.controller = self.task.rl_controller
        self.device = torch.device(device) if device is not None else self.handler.device
        self.action_size = len(self.controller.names)
        self.max_episode_steps = max_episode_steps or self.task.max_episode_steps
        self._substeps = scene.physics.decimation
        self._shift = 1.0 if shift_reward and self.task.ends_on_success else 0.0
        self._bank, self._late = initial_bank(self.task, self.handler, split, protocol_seed, bank_size), None
        if expert_starts:
            self._late = expert_bank(self.task, self.handler, split, protocol_seed, self._substeps)
        self._late_share = expert_starts
        zeros = torch.zeros(num_envs, device=self.device)
        self.elapsed_steps, self.returns = zeros.long(), zeros.clone()
        self._sums = torch.zeros(4, device=self.device, dtype=torch.float64)
        self.seed(seed)
        seen = self.reset().shape[1:]
        self.observation_shape, self.observation_size = tuple(seen), seen.numel()

    def _make_handler(self, simulator: str, scene: ScenarioCfg, num_threads: int) -> Handler:
        return HANDLERS.get(simulator)(scene, self.num_envs, num_threads=num_threads)

    def seed(self, seed: int) -> None:
        """Seeds which initial states are drawn from now on."""
        self._generator = torch.Generator(self.handler.device).manual_seed(seed)

    def random_state(self) -> Tensor:
        """Returns which initial states are drawn next, which :meth:`set_random_state` takes back."""
        return self._generator.get_state()

    def set_random_state(self, state: Tensor) -> None:
        """Goes on drawing initial states where :meth:`random_state` was."""
        self._generator.set_state(state)

    @torch.no_grad()
    def reset(self, mask: Tensor | None = None) -> Tensor:
        """Starts new episodes everywhere, or where ``mask`` (N,) says so; returns observations (N, D)."""
        ids = torch.arange(self.num_envs) if mask is None else mask.nonzero()[:, 0]
        if len(ids):
            self._restart(ids)
        return self._observe_begun(ids)

    @torch.no_grad()
    def step(self, actions: Tensor) -> EnvStep:
        """Steps every environment by one control step; ``actions`` (N, A) in [-1, 1]."""
        given = actions.detach().clamp(-1.0, 1.0).to(self.handler.device)
        self.controller.advance(self.handler, given, self._substeps)
        states = self.handler.get_states()
        judged = outcome(self.task, states)
        reward, terminated, success = (values.to(self.device) for values in judged)
        reward = reward.float()
        final_obs = self._observe(states)
        self.elapsed_steps += 1
        self.returns += reward
        cut_off = self.elapsed_steps >= self.max_episode_steps
        over = terminated | cut_off
        success = solved(self.task, success, over, self.returns)
        if self._shift:
            left = (self.max_episode_steps - self.elapsed_steps) * (terminated & ~success)
            reward = reward - 1.0 - left
        self._count(over, success)
        ids = over.nonzero()[:, 0]  # the one place where the host waits for the device
        obs = final_obs
        if len(ids):
            self._restart(ids)
            obs = self._observe_begun(ids)
        return EnvStep(obs, reward, terminated, cut_off & ~terminated, final_obs, success)

    def _count(self, over: Tensor, success: Tensor) -> None:
        done = over.double()
        rows = (done, done * self.returns, done * self.elapsed_steps, done * success)
        self._sums += torch.stack([row.sum() for row in rows])

    def pop_statistics(self) -> EpisodeStatistics:
        """Returns what the episodes came to that ended since the last call, and forgets them."""
        count, *sums = self._sums.tolist()
        self._sums.zero_()
        returns, length, success = (value / count if count else float("nan") for value in sums)
        return EpisodeStatistics(int(count), returns, length, success)

    def _restart(self, ids: Tensor) -> None:
        device = self.handler.device
        if self._late is None:
            self._place(ids, self._bank)
        else:
            draws = torch.rand(len(ids), generator=self._generator, device=device)
            late = (draws < self._late_share).to(ids.device)
            self._place(ids[~late], self._bank)
            self._place(ids[late], self._late)
        ids = ids.to(self.device)
        self.elapsed_steps[ids] = 0
        self.returns[ids] = 0.0

    def _place(self, ids: Tensor, bank: State) -> None:
        """Puts environments to states of a bank."""
        if not len(ids):
            return
        device = self.handler.device
        rows = torch.randint(bank.num_envs, (len(ids),), generator=self._generator, device=device)
        where: Any = ids.cpu().numpy() if device.type == "cpu" else ids
        self.handler.set_states(bank.select(rows), where)

    def stagger(self) -> None:
        """Lets every environment be somewhere in its episode, so that not all of them end at once."""
        generator = torch.Generator(self.device).manual_seed(int(self._generator.initial_seed()))
        self.elapsed_steps = torch.randint(
            self.max_episode_steps, (self.num_envs,), generator=generator, device=self.device
        )

    def state_dict(self) -> dict[str, Tensor]:
        """Returns where every environment is, which :meth:`load_state_dict` takes back."""
        states = self.handler.get_states().flatten()
        flat = {f"states/{key}": value.clone() for key, value in states.items()}  # some may share memory
        return flat | {"elapsed_steps": self.elapsed_steps.clone(), "returns": self.returns.clone()}

    def load_state_dict(self, state: Mapping[str, Tensor]) -> Tensor:
        """Puts every environment to a saved state; returns observations (N, D)."""
        of_handler = {key.removeprefix("states/"): value for key, value in state.items() if "/" in key}
        self.handler.set_states(State.unflatten(of_handler).to(self.handler.device, self.handler.dtype))
        self.elapsed_steps = state["elapsed_steps"].to(self.device, copy=True)
        self.returns = state["returns"].to(self.device, copy=True)
        return self._observe(self.handler.get_states())

    def _observe(self, states: State) -> Tensor:
        """Returns what is seen after a step that ended in ``states``, (N, D)."""
        return self.task.rl_observation(states).to(device=self.device, dtype=torch.float32)

    def _observe_begun(self, ids: Tensor) -> Tensor:
        """Returns what is seen when the episodes of the environments ``ids`` have just begun, (N, D)."""
        del ids  # all states are as they were, or new
        return self._observe(self.handler.get_states())

    def picture(self, env_id: int = 0) -> np.ndarray:
        """Returns the first camera's picture of one environment, (H, W, 3) uint8."""
        camera = self.handler.scenario.cameras[0].name
        return self.handler.render((camera,), ("rgb",), [env_id])[camera]["rgb"][0]

    def close(self) -> None:
        """Frees the simulator."""
        self.handler.close()
