"""Datasets of expert demonstrations without images, and demonstrations straight from a rollout."""

from pathlib import Path
from typing import Any

from envs.experts.actor import expert_episodes
from envs.spec import EnvSpec
from envs.tasks.base import Task
from roboverse_learn.data import DatasetWriter, EpisodeData, make_features
from roboverse_learn.data.augmentation.recording import HandReader, SourceDemo


def expert_demos(task: str, count: int = 2) -> tuple[Task, list[SourceDemo]]:
    """Returns a task, and demonstrations of its expert."""
    env = EnvSpec(task=task).make(count, observation="state", num_threads=1)
    reader = HandReader.of(env.task)
    episodes = expert_episodes(env, env.split_indices[:count].tolist(), record=("states",))
    demos = [reader.demo(row, episode.states) for row, episode in enumerate(episodes)]
    env.close()
    return env.task, demos


def write_demos(root: Path, task: str, count: int, **metadata: Any) -> Path:
    """Writes demonstrations of the expert in the first episodes of the train split."""
    env = EnvSpec(task=task).make(count, observation="state", num_threads=1)
    features = make_features(env.state_names, env.controller.names, {})
    with DatasetWriter(root, fps=20, features=features, robot_type="franka") as writer:
        for episode in expert_episodes(env, env.split_indices[:count].tolist(), record=("states",)):
            facts = {"task": task, "episode": episode.episode, "split": "train", "simulator": "mujoco"}
            writer.add_episode(
                EpisodeData(
                    states=episode.observation_state,
                    actions=episode.actions,
                    images={},
                    task=episode.instruction,
                    raw=episode.raw,
                    metadata=facts | metadata,
                )
            )
    env.close()
    return root
