"""Runs episodes in a batch of environments: one loop for policies, experts and replays.

``rollout(env, actor, episodes)`` starts episodes by index, gets chunks of actions from an :class:`Actor`, and
yields each episode when it is over. The schedule follows from what the actor and the simulator need:

* If the actor uses observations, rendering is expensive: an environment that needs a chunk waits until all
  of them do, so that one batch of images and one inference serves all. Other actors are called at once.
* Most simulators step single environments at proportional cost: each starts its next episode when its own is
  over. With ``steps_together``, an actor without observations runs in waves: all environments start together,
  finished ones repeat their last action until all are done, and images stay on the device until read.

An episode depends on its index alone, never on the number of environments or on the schedule.
Shapes: n = some environments, T = control steps of an episode, A = action size, D = state size.
"""

import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from envs.core.errors import SimulatorError
from envs.episode import Columns, Episode, Step, to_state, unflatten

if TYPE_CHECKING:
    from envs.state import State

OnStep = Callable[["Episode"], None]


class EpisodeEnv(Protocol):
    """A batch of environments whose episodes start by index; ``env_ids`` are sorted and unique."""

    num_envs: int
    task: Any
    max_episode_steps: int
    single_action_space: Any

    def reset_envs(self, env_ids: np.ndarray, episodes: np.ndarray, /) -> None:
        """Starts these episodes in these environments."""

    def observe(self, env_ids: np.ndarray, /) -> dict[str, np.ndarray]:
        """Returns the observations of these environments now; only this renders."""
        ...

    def step_envs(self, env_ids: np.ndarray, actions: np.ndarray, /) -> Any:
        """Steps these environments; returns reward, terminated, truncated and success, each (n,)."""

    def initial_state_hash(self, env_id: int, /) -> str:
        """Returns the hash of the initial state and appearance of an environment's episode."""
        ...

    def instruction(self, env_id: int, /) -> str:
        """Returns the instruction of an environment's episode."""
        ...


class Actor(ABC):
    """Chooses actions.

    Attributes:
        n_obs_steps: Observations that :meth:`act` looks at; 0 if it looks at states or at nothing.
        tail_steps: None if the environment ends an episode. A number makes it a demonstration, which ends
            so many control steps after its first success, or when the actor gives up.
    """

    n_obs_steps: int = 0
    tail_steps: float | None = None

    def begin(self, episodes: Sequence[Episode]) -> "State | None":
        """Prepares for episodes that are about to start, for instance by setting their ``memory``.

        Returns:
            Their initial states, one row each, or None for those that the task samples.
        """
        del episodes

    @abstractmethod
    def act(self, episodes: Sequence[Episode], states: Callable[[], "State"]) -> Sequence[np.ndarray]:
        """Chooses the next actions of episodes whose plans are used up.

        Args:
            episodes: The episodes.
            states: Returns their present states, one row each, float64 on the CPU.

        Returns:
            A chunk of actions (n, A) for each episode; an empty one gives up, which ends the episode.
        """


def rollout(
    env: Any,
    actor: Actor,
    episodes: Iterable[int],
    *,
    record: Collection[str] = (),
    on_step: OnStep = lambda episode: None,
) -> Iterator[Episode]:
    """Runs every episode once, each in whichever environment is free.

    Args:
        env: An :class:`EpisodeEnv`; a :class:`~envs.vector_env.RoboVerseVectorEnv` to record, or for an actor
            that does not look at observations.
        actor: Chooses the actions.
        episodes: Indices in the task's pool of episodes.
        record: Extra data to record: ``"states"``, and ``"images"`` if the environment observes pixels.
        on_step: Called with an episode after its reset and after each of its steps.

    Yields:
        Episodes in order of finishing; :func:`in_order` restores the order of ``episodes``. Until the next
        one is requested, the environment is in the state in which the episode ended.

    Raises:
        SimulatorError: An episode did not end after the task's number of steps.
    """
    return _Rollout(env, actor, episodes, record, on_step).run()


def in_order(finished: Iterable[Episode]) -> Iterator[Episode]:
    """Yields finished episodes in the order in which they were requested."""
    early: dict[int, Episode] = {}
    position = 0
    for episode in finished:
        early[episode.position] = episode
        while position in early:
            yield early.pop(position)
            position += 1


class _Rollout:
    """The loop of :func:`rollout`."""

    def __init__(
        self, env: Any, actor: Actor, episodes: Iterable[int], record: Collection[str], on_step: OnStep
    ) -> None:
        self._env, self._actor, self._on_step = env, actor, on_step
        self._records_states = "states" in record
        self._records_images = "images" in record and env.observation == "pixels"
        self._waves = not actor.n_obs_steps and env.handler.steps_together
        self._waiting = deque(enumerate(int(episode) for episode in episodes))
        self._free = list(range(env.num_envs))
        self._running: list[Episode] = []  # ordered by environment
        self._wave: list[Episode] = []  # all that started together, also those that are over
        self._columns: Columns = {}  # of flattened states
        self._robots = tuple(robot.name for robot in env.task.robots) if self._records_states else ()

    def run(self) -> Iterator[Episode]:
        while self._waiting or self._running:
            started = time.perf_counter()
            wave_runs = self._waves and self._running
            if self._waiting and self._free and not wave_runs:
                self._start()
            over = self._plan()
            if ready := [episode for episode in self._running if episode.plan]:
                over += self._step(ready)
            share = (time.perf_counter() - started) / len(self._running)
            for episode in self._running:
                episode.wall_time_s += share
            if over:
                self._running = [episode for episode in self._running if episode not in over]
                self._free = sorted(self._free + [episode.env_id for episode in over])
                yield from over

    def _start(self) -> None:
        """Starts waiting episodes in the free environments."""
        count = min(len(self._free), len(self._waiting))
        ids, self._free = self._free[:count], self._free[count:]
        self._wave = begun = [
            Episode(
                position=position,
                episode=episode,
                env_id=env_id,
                observations=deque(maxlen=self._actor.n_obs_steps),
                _columns=self._columns,
                _robots=self._robots,
            )
            for env_id, (position, episode) in zip(ids, [self._waiting.popleft() for _ in ids], strict=True)
        ]
        states = self._actor.begin(begun)
        indices = np.array([episode.episode for episode in begun], dtype=np.int64)
        self._env.reset_envs(_ids(begun), indices, *([] if states is None else [states]))
        self._running = sorted(self._running + begun, key=lambda episode: episode.env_id)
        numbers = self._numbers(begun) if self._records_states else [None] * count
        for episode, row in zip(begun, numbers, strict=True):
            episode.instruction = self._env.instruction(episode.env_id)
            episode.initial_state_hash = self._env.initial_state_hash(episode.env_id)
            episode._initial_state = row
            self._on_step(episode)

    def _plan(self) -> list[Episode]:
        """Asks the actor for the next chunks; returns the episodes in which it gives up."""
        starved = [episode for episode in self._running if not episode.plan]
        if (history := self._actor.n_obs_steps) and len(starved) < len(self._running):
            self._observe([episode for episode in self._running if 0 < len(episode.plan) < history])
            return []
        if history:
            self._observe(starved)
        if starved:
            chunks = self._actor.act(starved, lambda: self._states(starved))
            for episode, chunk in zip(starved, chunks, strict=True):
                episode.plan.extend(chunk)
        return [episode for episode in starved if not episode.plan]

    def _observe(self, episodes: Sequence[Episode]) -> None:
        if episodes:
            observation = self._env.observe(_ids(episodes))
            for row, episode in enumerate(episodes):
                episode.observations.append({key: value[row] for key, value in observation.items()})

    def _step(self, ready: Sequence[Episode]) -> list[Episode]:
        """Executes one action of each episode; returns those that are over."""
        images = self._images(ready) if self._records_images else {}
        actions = given = np.stack([episode.plan.popleft() for episode in ready])
        stepping, rows = ready, slice(None)
        if self._waves:  # environment i is row i
            stepping, rows = self._wave, _ids(ready)
            held = [episode.last_action for episode in stepping]
            given = np.stack([actions[0] if action is None else action for action in held])
            given[rows] = actions
        outcome = self._env.step_envs(_ids(stepping), given)
        states = self._numbers(stepping)[rows] if self._records_states else None
        step = Step(actions, outcome.reward[rows], outcome.success[rows], states, images)
        ended = (outcome.terminated | outcome.truncated)[rows]
        over = []
        for row, episode in enumerate(ready):
            episode._steps.append((step, row))
            episode.episode_return += float(step.rewards[row])
            if self._judge(episode, success=bool(step.success[row]), ended=bool(ended[row])):
                over.append(episode)
            self._on_step(episode)
        return over

    def _judge(self, episode: Episode, *, success: bool, ended: bool) -> bool:
        """Notes the success of a step; returns whether it was the last one."""
        if success and episode.solved_at is None:
            episode.solved_at = episode.length
        episode.success = success
        if self._actor.tail_steps is not None:
            episode.success = episode.solved_at is not None
            return episode.success and episode.length - (episode.solved_at or 0) >= self._actor.tail_steps
        if not ended and episode.length >= self._env.max_episode_steps:
            raise SimulatorError(
                f"Episode {episode.episode} of {self._env.task.name} did not end after {episode.length} "
                "steps, which is its limit. The environment must report truncation there."
            )
        return ended

    def _states(self, episodes: Sequence[Episode]) -> "State":
        """Returns the present states of episodes, one row each; those that are recorded, if they are."""
        recorded: list[Any] = [episode.last_state for episode in episodes]
        numbers = np.stack(recorded) if self._records_states else self._numbers(episodes)
        return to_state(unflatten(numbers, self._columns))

    def _numbers(self, episodes: Sequence[Episode]) -> np.ndarray:
        """Returns the present states of environments (n, D) float64, moved to the CPU in one piece."""
        everyone = len(episodes) == self._env.num_envs
        flat = self._env.get_states(None if everyone else _ids(episodes)).flatten()
        if not self._columns:
            ends = np.cumsum([value[0].numel() for value in flat.values()]).tolist()
            for (key, value), start, end in zip(flat.items(), [0, *ends], ends, strict=False):
                self._columns[key] = slice(start, end), value.shape[1:]
        import torch

        return torch.cat([value.flatten(1) for value in flat.values()], 1).cpu().double().numpy()

    def _images(self, episodes: Sequence[Episode]) -> dict[str, Any]:
        """Renders environments: camera to (n, H, W, 3) uint8, in waves on the simulator's device."""
        handler, ids = self._env.handler, _ids(episodes)
        if self._waves:
            rendered = handler.render_tensors(handler.snapshot(ids))
        else:
            rendered = handler.render(None, ("rgb",), ids)
        return {camera: kinds["rgb"] for camera, kinds in rendered.items()}


def _ids(episodes: Sequence[Episode]) -> np.ndarray:
    return np.array([episode.env_id for episode in episodes], dtype=np.int64)
