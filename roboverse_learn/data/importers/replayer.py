"""Replays demonstrations in one of our environments, by states or by controls.

By states, every recorded moment is set and looked at: exact. By controls, the first moment is set and the
recorded joint targets are given to our simulator: physics decides what comes of them. Either way our
task's checker decides what is a success.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np
import torch

from envs.core.errors import ConfigError, unknown_name
from envs.experts.rollout import TAIL_STEPS, Rollout
from envs.state import State
from envs.vector_env import RoboVerseVectorEnv
from roboverse_learn.data.importers.demonstration import Demonstration

Replay = Literal["states", "controls"]
REPLAYS: tuple[Replay, ...] = get_args(Replay)

HOLD_STEPS = 10
"""Steps for which the last targets are held: half a second for an arm that lags behind to arrive."""

_IMAGES = "observation.images."


@dataclass(slots=True)
class _Tape:
    """One running replay."""

    demonstration: Demonstration
    start: int
    length: int
    actions: list[np.ndarray] = field(default_factory=list)
    observations: list[dict[str, np.ndarray]] = field(default_factory=list)
    states: list[dict[str, np.ndarray]] = field(default_factory=list)
    rewards: list[float] = field(default_factory=list)
    success: bool = False
    steps_left: int | None = None

    @property
    def moment(self) -> int:
        """The recorded moment that was reached."""
        return self.start + len(self.actions)

    @property
    def over(self) -> bool:
        """Whether the recording or the steps after success are used up."""
        return self.steps_left == 0 or len(self.actions) >= self.length

    def next_action(self) -> np.ndarray:
        """Returns the targets that lead on from here, (J,) float32."""
        targets = self.demonstration.targets
        return targets[min(self.moment, len(targets) - 1)].astype(np.float32)

    def note(self, success: bool, reward: float) -> None:
        """Notes the outcome of a step; the first success leaves a few steps more."""
        self.rewards.append(reward)
        if self.steps_left is not None:
            self.steps_left -= 1
        elif success:
            self.success, self.steps_left = True, TAIL_STEPS


class Replayer:
    """Replays demonstrations in a batched env.

    Args:
        env: The env; an action must be the joint targets of its robot.

    Raises:
        ConfigError: The task's actions are something else.
    """

    def __init__(self, env: RoboVerseVectorEnv) -> None:
        robot = env.scenario.robots[0]
        if tuple(env.controller.names) != robot.joint_names:
            raise ConfigError(
                f"Demonstrations cannot be replayed in {env.task.name}: its actions are "
                f"{', '.join(env.controller.names)}, not the joint targets of '{robot.name}'."
            )
        self._env = env

    def replay(
        self, demonstrations: Sequence[Demonstration], episodes: Sequence[int], by: Replay
    ) -> Iterator[Rollout]:
        """Yields what a collection records of each demonstration, in order.

        Args:
            demonstrations: At most ``num_envs`` of them, those by states with recorded states.
            episodes: The episode of the env's split that each takes its looks and its words from.
            by: ``states`` or ``controls``.
        """
        for env_id, tape in enumerate(self._run(demonstrations, episodes, by, record=True)):
            yield self._rollout(env_id, tape)

    def passes(
        self, demonstrations: Sequence[Demonstration], episodes: Sequence[int], by: Replay
    ) -> list[bool]:
        """Returns which demonstrations succeed, without drawing a picture; see :meth:`replay`."""
        return [tape.success for tape in self._run(demonstrations, episodes, by, record=False)]

    def _run(
        self, demonstrations: Sequence[Demonstration], episodes: Sequence[int], by: Replay, *, record: bool
    ) -> list[_Tape]:
        if by not in REPLAYS:
            raise unknown_name("replay", by, REPLAYS)
        tapes = [_tape(demonstration, by) for demonstration in demonstrations]
        if not tapes:
            return []
        everyone = np.arange(len(tapes))
        self._env.reset_envs(everyone, np.asarray(episodes), _moments(tapes))
        if record:
            self._note_states(tapes, everyone)
        while len(active := np.array([i for i in everyone if not tapes[i].over], dtype=np.int64)):
            if record:
                observation = self._env.observe(active)
                for row, env_id in enumerate(active):
                    tapes[env_id].observations.append({k: v[row] for k, v in observation.items()})
            for env_id in active:
                tapes[env_id].actions.append(tapes[env_id].next_action())
            success, reward = self._advance([tapes[i] for i in active], active, by)
            if record:
                self._note_states(tapes, active)
            for row, env_id in enumerate(active):
                tapes[env_id].note(bool(success[row]), float(reward[row]))
        return tapes

    def _advance(self, tapes: list[_Tape], active: np.ndarray, by: Replay) -> tuple[np.ndarray, np.ndarray]:
        """Brings the active environments to their next moment; returns success and reward, each (n,)."""
        if by == "controls":
            result = self._env.step_envs(active, np.stack([tape.actions[-1] for tape in tapes]))
            return result.success, result.reward
        env = self._env
        env.handler.set_states(_moments(tapes), active)
        states = env.get_states(active)
        success = env.task.success(states).cpu().numpy()
        return success, np.where(success, 1.0, env.task.reward(states).cpu().numpy())

    def _note_states(self, tapes: list[_Tape], env_ids: np.ndarray) -> None:
        flat = {key: value.cpu().numpy() for key, value in self._env.get_states(env_ids).flatten().items()}
        for row, env_id in enumerate(env_ids):
            tapes[env_id].states.append({key: value[row] for key, value in flat.items()})

    def _rollout(self, env_id: int, tape: _Tape) -> Rollout:
        stacked = {key: np.stack([o[key] for o in tape.observations]) for key in tape.observations[0]}
        return Rollout(
            episode=int(self._env.episodes[env_id]),
            success=tape.success,
            instruction=self._env.instruction(env_id),
            initial_state_hash=self._env.initial_state_hash(env_id),
            observation_state=stacked["observation.state"],
            actions=np.stack(tape.actions),
            rewards=np.array(tape.rewards, np.float32),
            images={k.removeprefix(_IMAGES): v for k, v in stacked.items() if k.startswith(_IMAGES)},
            raw={key: np.stack([s[key] for s in tape.states]) for key in tape.states[0]},
        )


def _tape(demonstration: Demonstration, by: Replay) -> _Tape:
    steps = len(demonstration.targets)
    if by == "controls":
        return _Tape(demonstration, 0, steps + HOLD_STEPS)
    if not demonstration.has_states:
        raise ConfigError(
            f"Episode '{demonstration.name}' has no recorded states: only replay=controls is possible."
        )
    return _Tape(demonstration, demonstration.first_state, steps - demonstration.first_state)


def _moments(tapes: Sequence[_Tape]) -> State:
    """Returns the moments that the tapes are at, one row each."""
    flats = [tape.demonstration.states.select([tape.moment]).flatten() for tape in tapes]
    return State.unflatten({key: torch.cat([flat[key] for flat in flats]) for key in flats[0]})
