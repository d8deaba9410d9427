"""Episodes to view: rolled out by the expert, recorded in a dataset, or filmed in an evaluation."""

import json
from collections.abc import Collection
from contextlib import closing
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from envs.core.errors import ConfigError, ResultError
from envs.spec import EnvSpec
from envs.vector_env import RoboVerseVectorEnv
from roboverse_learn.config.other_commands import ViewConfig
from roboverse_learn.viewer.recording import EpisodeRecording


def record_expert(config: ViewConfig) -> EpisodeRecording:
    """Records an episode of the task's expert.

    Raises:
        ConfigError: The task has no expert, or the split no such episode.
    """
    from envs.experts.actor import ExpertActor
    from envs.rollout import Episode, rollout

    spec = _with_all_cameras(config.env)
    if not type(spec.make_task()).has_expert:
        raise ConfigError(
            f"{spec.task} has no scripted expert to view. Take dataset=<folder> or result=<file> instead."
        )
    env = spec.make(1, split=config.split, observation="state", protocol_seed=config.protocol_seed)
    indices = env.split_indices
    _check_index(config.episode, len(indices), f"{config.split} split")
    index = int(indices[config.episode])
    recording = EpisodeRecording(env, f"{spec.task} {config.split} {index}")

    def log(running: Episode) -> None:
        if running.length == 0:
            recording.start(_text(env, "the expert"))
        images = env.handler.render(None, ("rgb",), [0])
        shown = {camera: kinds["rgb"][0] for camera, kinds in images.items()}
        recording.add(running.length / env.control_hz, env.get_states([0]), shown)

    list(rollout(env, ExpertActor(env), [index], on_step=log))
    return recording


def record_dataset(config: ViewConfig) -> EpisodeRecording:
    """Records an episode of a dataset: its states and its videos.

    Raises:
        DatasetError: There is no dataset, or it holds no raw states.
        ConfigError: It has no such episode.
    """
    from envs.state import State
    from roboverse_learn.data.dataset.info import DatasetInfo
    from roboverse_learn.data.dataset.recording import RecordingReader

    info = DatasetInfo.open(config.dataset)
    _check_index(config.episode, info.num_episodes, "dataset")
    recorded = RecordingReader(config.dataset).read(config.episode)
    facts = recorded.metadata
    images = {key.rpartition(".")[2]: _frames(info, key, config.episode) for key in info.camera_keys}
    known = {item.name for item in fields(EnvSpec)}
    spec = EnvSpec.from_json({key: value for key, value in facts.items() if key in known})
    spec = spec.replace(cameras=tuple(images), materials=config.env.materials)
    if images:
        spec = spec.replace(image_size=next(iter(images.values())).shape[1])
    env = spec.make(1, split=facts["split"], observation="state", protocol_seed=facts.get("protocol_seed", 0))
    env.reset_envs([0], [int(facts["episode"])], recorded.states.select([0]))
    recording = EpisodeRecording(env, f"{Path(config.dataset).name} {config.episode}")
    recording.start(_text(env, f"episode {config.episode} of {config.dataset}"))
    for step in range(recorded.num_steps + 1):
        state: State = recorded.states.select([step])
        shown = {camera: frames[step] for camera, frames in images.items() if step < len(frames)}
        recording.add(step / info.fps, state, shown)
    return recording


def record_result(config: ViewConfig) -> EpisodeRecording:
    """Records a filmed episode of an evaluation: its video, and the scene at its start.

    Raises:
        ResultError: The results file is damaged, or there are no videos beside it.
        ConfigError: It has no such video, or had materials and none are given.
    """
    from benchmark.results import read_result, video_dir

    path = Path(config.result)
    result = read_result(path)
    filmed = {f"{record.cell.name}-{record.episode}": record for record in result.records}
    videos = sorted(video_dir(path).glob("*.mp4"))
    videos = [video for video in videos if video.stem.rpartition("-")[0] in filmed]
    if not videos:
        raise ResultError(f"There are no videos in '{video_dir(path)}'. Evaluate with evaluate.videos=1.")
    _check_index(config.episode, len(videos), "folder of videos")
    video = videos[config.episode]
    record = filmed[video.stem.rpartition("-")[0]]
    spec = _with_all_cameras(result.env).replace(level=record.level or 0, only=record.only)
    spec = spec.replace(materials=_given_materials(config, result.env.materials))
    env = spec.make(1, split=record.split, observation="state", protocol_seed=record.seed)
    env.reset_envs([0], [record.episode])
    if record.instruction is not None:
        env.set_instruction(0, record.instruction)
    recording = EpisodeRecording(env, f"{result.run} {video.stem}")
    outcome = f"{record.policy}, {'success' if record.success else 'failure'}; the scene is that of the start"
    if record.switched_to is not None:
        outcome += f"; “{record.switched_to}” from step {record.switched_at} on"
    recording.start(_text(env, outcome))
    frames, fps = _video(video)
    for number, frame in enumerate(frames):
        state = env.get_states([0]) if number == 0 else None
        recording.add(number / fps, state, {env.camera_names[0]: frame})
    return recording


def _with_all_cameras(spec: EnvSpec) -> EnvSpec:
    """Returns a spec that names every camera of its task where it names none."""
    cameras = tuple(camera.name for camera in spec.make_task().scenario.cameras)
    return spec if spec.cameras else spec.replace(cameras=cameras)


def _given_materials(config: ViewConfig, recorded: str) -> str:
    """Returns the given materials; a result records a label of its own, which is no folder."""
    given = config.env.materials
    if recorded and not given:
        plus, name = "+" * recorded.startswith("+"), recorded.removeprefix("+").rpartition("-")[0]
        raise ConfigError(
            f"result={config.result} was evaluated with the materials '{recorded}', whose images it does not "
            f"hold: add materials={plus}<path of the folder '{name}'>."
        )
    return given


def _check_index(index: int, count: int, of: str) -> None:
    if index >= count:
        raise ConfigError(f"episode={index}: the {of} has {count}, numbered 0 to {count - 1}.")


def _text(env: RoboVerseVectorEnv, who: str) -> str:
    """Returns the Markdown text about the first environment's episode: what is done, and the draws."""
    spec = env.env_spec
    varied = f"{spec.only} alone" if spec.only else f"level {spec.level}"
    lines = [
        f"# {spec.task}, {varied}",
        f"“{env.instruction(0)}”, by {who}",
        f"{env.randomizer.split.name} split, episode {int(env.episodes[0])}",
    ]
    for channel, draw in env.draws(0).items():
        lines.append(f"## {channel}\n\n" + "\n".join(_rows(draw)))
    if not env.draws(0):
        lines.append("Nothing is randomized but the start.")
    return "\n\n".join(lines)


def _rows(value: Any, name: str = "") -> list[str]:
    """Returns a draw as lines of a list, one for each value."""
    if isinstance(value, dict):
        return [row for key, inner in value.items() for row in _rows(inner, f"{name} {key}".strip())]
    if isinstance(value, list | tuple) and any(isinstance(each, dict) for each in value):
        return [row for number, each in enumerate(value) for row in _rows(each, f"{name} {number}".strip())]
    if isinstance(value, float):
        return [f"- {name}: {value:.3g}"]
    if isinstance(value, Collection) and not isinstance(value, str):
        value = json.dumps([round(each, 3) if isinstance(each, float) else each for each in value])
    return [f"- {name}: {value}"]


def _frames(info: Any, key: str, episode: int) -> np.ndarray:
    """Returns a camera's recorded images of an episode, (T, H, W, 3) uint8."""
    from roboverse_learn.data.dataset.video import decode_video

    height, width, _ = info.shapes[key]
    length = int(info.episode_lengths[episode])
    out = np.empty((length, 3, height, width), np.uint8)
    first = info.episodes[episode][f"videos/{key}/from_timestamp"]
    times = first + np.arange(length) / info.fps
    decode_video(info.video_file(episode, key), times, np.arange(length), out)
    return out.transpose(0, 2, 3, 1)


def _video(path: Path) -> tuple[list[np.ndarray], float]:
    """Returns the frames (H, W, 3) uint8 of a video, and how many make a second."""
    import av

    with closing(av.open(str(path), "r")) as container:
        stream = container.streams.video[0]
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
        fps = float(stream.average_rate or 30)
    return frames, fps
