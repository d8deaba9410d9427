"""Replays demonstrations in one of our environments, by their states or by their controls.

By states, every recorded state is set and judged: exact. By controls, the first state is set and the recorded
joint targets are given to our simulator: physics decides. Either way our task decides what is a success.
"""

from collections.abc import Collection, Iterator, Sequence
from typing import Literal, get_args

from envs.core.errors import ConfigError, unknown_name
from envs.playback import HOLD_STEPS, PlaybackEnv, ReplayActor
from envs.rollout import Episode, in_order, rollout
from envs.tasks.plan_following import TAIL_STEPS
from envs.vector_env import RoboVerseVectorEnv
from roboverse_learn.data.importers.demonstration import Demonstration

Replay = Literal["states", "controls"]
REPLAYS: tuple[Replay, ...] = get_args(Replay)


class Replayer:
    """Replays demonstrations in a batched env.

    Args:
        env: The env; an action must be the joint targets of its robot.

    Raises:
        ConfigError: The task's actions are something else.
    """

    def __init__(self, env: RoboVerseVectorEnv) -> None:
        robots = env.scenario.robots
        names = robots[0].joint_names
        if len(robots) > 1:
            names = tuple(f"{robot.name}/{name}" for robot in robots for name in robot.joint_names)
        if tuple(env.controller.names) != names:
            raise ConfigError(
                f"Demonstrations cannot be replayed in {env.task.name}: its actions are "
                f"{', '.join(env.controller.names)}, not the joint targets of "
                f"{' and '.join(repr(robot.name) for robot in robots)}."
            )
        self._env = env

    def replay(
        self,
        demonstrations: Sequence[Demonstration],
        episodes: Sequence[int],
        by: Replay,
        *,
        record: Collection[str] = ("images", "states"),
    ) -> Iterator[Episode]:
        """Yields the episode that each demonstration becomes, in order.

        Args:
            demonstrations: At most ``num_envs`` of them, those by states with recorded states.
            episodes: The episode of the env's split that each takes its appearance and instruction from.
            by: ``states`` or ``controls``.
            record: What to record; see :func:`envs.rollout.rollout`.

        Raises:
            ConfigError: A demonstration has no recorded states and is replayed by them.
        """
        if by not in REPLAYS:
            raise unknown_name("replay", by, REPLAYS)
        for demonstration in demonstrations:
            if by == "states" and not demonstration.has_states:
                raise ConfigError(
                    f"Episode '{demonstration.name}' has no recorded states: only replay=controls is "
                    "possible."
                )
        firsts = [each.first_state if by == "states" else 0 for each in demonstrations]
        pairs = list(zip(demonstrations, firsts, strict=True))
        actor = ReplayActor(
            [each.states.select([first]) for each, first in pairs],
            [each.targets[first:] for each, first in pairs],
            hold_steps=HOLD_STEPS if by == "controls" else 0,
            tail_steps=TAIL_STEPS,
        )
        recorded = [each.states.select(range(first, each.states.num_envs)) for each, first in pairs]
        env = self._env if by == "controls" else PlaybackEnv(self._env, recorded)
        return in_order(rollout(env, actor, episodes, record=record))

    def passes(
        self, demonstrations: Sequence[Demonstration], episodes: Sequence[int], by: Replay
    ) -> list[bool]:
        """Returns which demonstrations succeed, without rendering; see :meth:`replay`."""
        return [episode.success for episode in self.replay(demonstrations, episodes, by, record=())]
