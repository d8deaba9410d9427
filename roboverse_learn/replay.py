"""``python roboverse_learn/replay.py dataset=… simulator=…``: replays episodes in another simulator."""

import hashlib
import sys
from pathlib import Path

if __name__ == "__main__":  # as a script: this folder's `data` or `run` must not hide other packages
    sys.path[0] = str(Path(__file__).resolve().parents[1])

from typing import TYPE_CHECKING, Any

from envs.core.errors import DatasetError
from roboverse_learn.config.schema import ReplayConfig

if TYPE_CHECKING:
    from roboverse_learn.data.dataset.recording import Recording


def replay(config: ReplayConfig) -> Any:
    """Replays a dataset's episodes, writes a summary and the page; returns a printable report.

    Raises:
        DatasetError: There is no dataset, or it holds no raw states.
        ConfigError: The folder holds the replay of another dataset.
        WriteError: A file cannot be written.
    """
    from roboverse_learn.commands.report import replay_report
    from roboverse_learn.data.dataset.recording import read_recordings
    from roboverse_learn.sim2sim.parity import parity_page, summary

    recordings = read_recordings(config.dataset, config.episodes)
    first = hashlib.sha256(recordings[0].actions.tobytes()).hexdigest()[:16]
    of = {"dataset": config.dataset, "first_actions_hash": first}
    summary.refuse_to_replace(Path(config.out), of | _pair(recordings, config))
    values = of | replay_recordings(recordings, config)
    path = summary.write(Path(config.out), values)
    return replay_report(values, path, parity_page.write_page(Path(config.out)))


def replay_recordings(recordings: "list[Recording]", config: ReplayConfig) -> dict[str, Any]:
    """Replays recordings of one task; returns what :mod:`roboverse_learn.sim2sim.parity.summary` writes."""
    import envs
    from benchmark import provenance
    from roboverse_learn.commands.called_with import command_words
    from roboverse_learn.sim2sim.parity import tracks
    from roboverse_learn.sim2sim.parity.summary import SCHEMA_VERSION, summarize

    first = recordings[0].metadata
    settings = first.get("simulator_settings") if config.simulator == first["simulator"] else None
    env = envs.make_vec(
        first["task"],
        min(config.num_envs, len(recordings)),
        split=first["split"],
        simulator=config.simulator,
        observation="state",
        protocol_seed=first.get("protocol_seed", 0),
        task_kwargs=first.get("task_kwargs", {}),
        robot=first.get("robot", ""),
        scenario=first.get("scenario"),
        only=first.get("only"),  # a channel may have added objects, which are in the states
        simulator_settings=settings,
    )
    if len(env.controller.names) != recordings[0].actions.shape[1]:
        env.close()
        raise DatasetError(
            f"The actions of '{config.dataset}' have {recordings[0].actions.shape[1]} numbers; those of "
            f"{first['task']} have {len(env.controller.names)}: {', '.join(env.controller.names)}. "
            "Collect it again with: roboverse collect"
        )
    ways = {"states": tracks.by_states, "controls": tracks.by_controls}
    try:
        recorded = [tracks.recorded_success(env, recording) for recording in recordings]
        replays = {
            name: summarize(env.scenario, recordings, ways[name](env, recordings), recorded)
            for name in config.by
        }
        return {
            "schema_version": SCHEMA_VERSION,
            **_pair(recordings, config),
            "recorded_versions": first.get("versions", {}),
            "versions": provenance.package_versions(),
            "control_hz": float(env.control_hz),
            "num_episodes": len(recordings),
            "replays": replays,
            "note": config.note,
            "created": provenance.now(),
            "command": provenance.command_line(["roboverse_learn/replay.py", *command_words()]),
        }
    finally:
        env.close()


def _pair(recordings: "list[Recording]", config: ReplayConfig) -> dict[str, Any]:
    """Returns the task of recordings and both simulators, which a summary is named after."""
    first = recordings[0].metadata
    return {
        "task": first["task"],
        "task_kwargs": first.get("task_kwargs", {}),
        "recorded_in": first["simulator"],
        "replayed_in": config.simulator,
    }


if __name__ == "__main__":
    from roboverse_learn.cli import script

    script("replay")
