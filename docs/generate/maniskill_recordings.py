"""Our experts in ManiSkill's own physics, recorded by ManiSkill, and what our importer makes of the files.

    uv venv original
    uv pip install --python original mani_skill==3.0.1 "numpy<2"
    python -m docs.generate.maniskill_recordings env_id=PushT-v1 python=original/bin/python folder=/tmp/PushT

The expert plans from the states there, and ManiSkill follows its joint targets; episodes that ManiSkill calls
a success are kept in ``<folder>/t.h5``. Then it reads that file: at how many moments our rule says what
ManiSkill's says, and how many episodes pass by their states and by their controls. Without ``python=`` it
reads a file that is there, such as one of ManiSkill's motion planner.
"""

import json
import logging
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import torch

from envs.core.arguments import run_program
from envs.core.errors import ConfigError
from envs.spec import EnvSpec
from envs.state import EntityState, State
from envs.vector_env import RoboVerseVectorEnv
from roboverse_learn.data.importers.maniskill import (
    GRIPPER_RANGE_M,
    ROOT,
    SCENES,
    ManiSkillFile,
    placed_objects,
)
from roboverse_learn.data.importers.maniskill_sizes import peg_sizes
from roboverse_learn.data.importers.replayer import REPLAYS, Replayer

logger = logging.getLogger(__name__)

MOST_STEPS, STEPS_AFTER = 900, 5
MARK = "@@"
"""Begins the server's answers; see :data:`docs.generate.maniskill_server.MARK`."""


@dataclass(frozen=True, kw_only=True, slots=True)
class RecordingSettings:
    """Settings of the program.

    Attributes:
        env_id: ManiSkill's name of the environment.
        folder: Folder of ``t.h5``.
        python: Python of an environment that has ManiSkill; without it nothing is recorded.
        episodes: How many are recorded.
    """

    env_id: str
    folder: Path
    python: str = ""
    episodes: int = 3


class _ManiSkill:
    """ManiSkill in its own process."""

    def __init__(self, python: str, env_id: str, folder: Path) -> None:
        server = Path(__file__).with_name("maniskill_server.py")
        self._process = subprocess.Popen(
            [python, str(server), env_id, str(folder)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def ask(self, **request: Any) -> dict[str, Any]:
        """Returns the answer to a request."""
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write(json.dumps(request) + "\n")
        self._process.stdin.flush()
        for line in self._process.stdout:
            if line.startswith(MARK):
                return json.loads(line.removeprefix(MARK))
        raise ConfigError("ManiSkill's process ended; its message is above.")

    def close(self) -> None:
        """Ends the process once its file is written."""
        self._process.communicate()


def record(settings: RecordingSettings) -> None:
    """Records episodes that ManiSkill calls a success."""
    env = EnvSpec(task=SCENES[settings.env_id].task).make(1, observation="state", num_threads=1)
    theirs = _ManiSkill(settings.python, settings.env_id, settings.folder)
    kept, seed = 0, 0
    while kept < settings.episodes and seed < 10 * settings.episodes:
        won, steps = _episode(env, theirs, settings.env_id, seed)
        theirs.ask(do="flush", save=won)
        logger.info("seed %d: %s after %d steps", seed, "success" if won else "no success", steps)
        kept, seed = kept + won, seed + 1
    theirs.close()
    env.close()


def _episode(env: RoboVerseVectorEnv, theirs: _ManiSkill, env_id: str, seed: int) -> tuple[bool, int]:
    """Plays an episode; returns whether ManiSkill calls it a success, and its steps."""
    rng, planner = np.random.default_rng(seed), env.task.planner
    answer, held, steps = theirs.ask(do="reset", seed=seed), None, 0
    while steps < MOST_STEPS:
        plan = planner.plan(_ours(env, env_id, answer, held), rng)
        if not len(plan):
            break
        answer = theirs.ask(do="step", actions=_actions(env, plan), until_success=True)
        steps, held = steps + len(answer["won"]), plan[len(answer["won"]) - 1]
        if answer["won"][-1]:
            still = _actions(env, np.repeat(held[None], STEPS_AFTER, 0))
            theirs.ask(do="step", actions=still, until_success=False)
            return True, steps
    return False, steps


def _ours(env: RoboVerseVectorEnv, env_id: str, answer: dict[str, Any], held: np.ndarray | None) -> State:
    """Returns ManiSkill's state in our environment, with the targets that the robots hold."""
    names = sorted(name for name in answer["articulations"] if name.startswith("panda"))
    values = [np.array(answer["articulations"][name])[None] for name in names]
    actors = {name: np.array(one)[None] for name, one in answer["actors"].items()}
    robots, entities, at = env.scenario.robots, dict[str, EntityState](), 0
    for robot, one in zip(robots, values, strict=True):
        count = len(robot.joints)
        joints, speeds = one[:, ROOT : ROOT + count], one[:, ROOT + count :]
        own = EntityState.at_rest(np.array([robot.pos]), np.array([robot.rot]), joints)
        own.joint_vel = torch.from_numpy(speeds)
        targets = joints if held is None else held[None, at : at + count].astype(np.float64)
        own.joint_target = torch.from_numpy(targets)
        entities[robot.name], at = own, at + count
    objects = placed_objects(SCENES[env_id].objects, actors, robots[0], values[0])
    env.reset_envs(np.array([0]), env.split_indices[:1], State(entities, objects))
    return env.get_states()


def _actions(env: RoboVerseVectorEnv, plan: np.ndarray) -> list[list[float]]:
    """Returns ManiSkill's actions of joint targets."""
    low, high = GRIPPER_RANGE_M
    parts, at = [], 0
    for robot in env.scenario.robots:
        own, at = plan[:, at : at + len(robot.joints)], at + len(robot.joints)
        parts.append(own[:, list(robot.arm)])
        if robot.fingers:
            gripper = (own[:, robot.fingers[:1]] - low) / (high - low) * 2.0 - 1.0
            parts.append(gripper.clip(-1.0, 1.0))
    return np.concatenate(parts, axis=1).astype(float).tolist()


def judge(env_id: str, path: Path) -> str:
    """Returns in words what our importer makes of a file."""
    passed, agree, asked = dict.fromkeys(REPLAYS, 0), 0, 0
    with h5py.File(path) as file:
        names = list(file)
        for name in names:
            group: Any = file[name]
            spec = EnvSpec(task=SCENES[env_id].task, task_kwargs=_sizes(path, name, group))
            env = spec.make(1, observation="state", num_threads=1)
            demonstration = ManiSkillFile(path, env.task).read(name)
            for row, won in enumerate(group["success"][:].tolist(), start=1):
                env.reset_envs(np.array([0]), env.split_indices[:1], demonstration.states.select([row]))
                agree += bool(env.task.success(env.get_states())[0]) == won
                asked += 1
            for way in REPLAYS:
                passed[way] += Replayer(env).passes([demonstration], env.split_indices[:1].tolist(), way)[0]
            env.close()
    ways = " and ".join(f"{count} by {way}" for way, count in passed.items())
    return f"{env_id}: our rule agrees at {agree} of {asked} moments; of {len(names)} episodes pass {ways}"


def _sizes(path: Path, name: str, group: Any) -> dict[str, Any]:
    """Returns the options of the task that are an episode's own."""
    if "box_with_hole" not in group["env_states/actors"]:
        return {}
    episodes = json.loads(path.with_suffix(".json").read_text())["episodes"]
    (seed,) = [one["episode_seed"] for one in episodes if f"traj_{one['episode_id']}" == name]
    peg, box = (float(group[f"env_states/actors/{actor}"][0, 2]) for actor in ("peg", "box_with_hole"))
    return asdict(peg_sizes(peg, box, seed))


def _run(settings: RecordingSettings) -> None:
    if settings.env_id not in SCENES:
        raise ConfigError(f"env_id is one of {', '.join(sorted(SCENES))}; given {settings.env_id}.")
    if settings.python:
        record(settings)
    logger.info("%s", judge(settings.env_id, settings.folder / "t.h5"))


def main(words: Sequence[str] | None = None) -> int:
    """Records, if asked to, and reads; returns the exit code."""
    return run_program("python -m docs.generate.maniskill_recordings", RecordingSettings, _run, words)


if __name__ == "__main__":
    sys.exit(main())
