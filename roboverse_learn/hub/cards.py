"""Pages of what is published, in the hub's form: facts for its search, then text."""

import json
import shlex
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from benchmark.records import Result
from envs.core.json_values import flat, to_json_values
from envs.spec import EnvSpec

if TYPE_CHECKING:
    from huggingface_hub import EvalResult

    from roboverse_learn.config.schema import TrainRunConfig
    from roboverse_learn.data import DatasetInfo

_TAGS = ("robotics", "lerobot", "roboverse")

_OF_POLICY = ("cameras", "image_size", "level", "only")
"""Fields of the environment that an evaluation takes from the checkpoint, or varies."""


def checkpoint_card(
    name: str, policy: str, config: "TrainRunConfig", results: Sequence[Result], licence: str, lerobot: bool
) -> str:
    """Returns the page of a checkpoint: what it is, its results with intervals, how to run it.

    Args:
        name: Name on the hub.
        policy: Label of the policy.
        config: Configuration of its run.
        results: Evaluations of this checkpoint.
        licence: Licence, in the hub's words; empty for none.
        lerobot: Whether LeRobot's own commands run it.
    """
    from huggingface_hub import ModelCardData

    facts = ModelCardData(
        library_name="lerobot" if lerobot else "roboverse",
        pipeline_tag="robotics",
        tags=[*_TAGS, policy],
        license=licence or None,
        model_name=name,
        eval_results=[row for result in results for row in _metrics(result)] or None,
    )
    env = config.env
    demonstrations = f" on demonstrations of {_looks(config)}" if lerobot else ""
    seen = f", from the cameras {', '.join(env.cameras)} at {env.image_size} pixels" if env.cameras else ""
    lines = [
        f"# {name.split('/')[1]}",
        "",
        f"Policy `{policy}` for {', '.join(config.tasks)}, trained by RoboVerse Learn{demonstrations} in "
        f"`{env.simulator}`{seen}; seed {config.seed}.",
    ]
    if results:
        lines += ["", "## Success", "", *_table(results)]
    own = {key: value for key, value in env.to_json().items() if key not in _OF_POLICY}
    use = f"roboverse evaluate policy.path={name} {_words(own)}"
    lines += ["", "## Use", "", "```bash", use]
    if lerobot:
        seen_too = _lerobot_words(own | {"cameras": list(env.cameras), "image_size": env.image_size})
        lines.append(f"lerobot-eval --policy.path={name} --env.type=roboverse {seen_too}")
    lines += ["```", ""]
    return f"---\n{facts.to_yaml()}\n---\n\n" + "\n".join(lines)


def dataset_card(name: str, info: "DatasetInfo", licence: str) -> str:
    """Returns the page of a dataset: what it holds, where it is from, how to train on it.

    Args:
        name: Name on the hub.
        info: The dataset.
        licence: Licence, in the hub's words; empty for none.
    """
    from huggingface_hub import DatasetCardData

    facts = DatasetCardData(
        license=licence or None,
        task_categories=["robotics"],
        tags=["LeRobot", *_TAGS],
        configs=[{"config_name": "default", "data_files": "data/*/*.parquet"}],
    )
    named = info.named_tasks
    levels = sorted({each["level"] for each in info.episode_metadata if each.get("level") is not None})
    lines = [
        f"# {name.split('/')[1]}",
        "",
        f"A LeRobotDataset: {info.num_episodes} episodes, {info.num_frames:,} frames at {info.fps} Hz"
        + (f", robot `{info.robot_type}`." if info.robot_type else "."),
        "",
        *([f"- Task: {', '.join(named)}"] if named else []),
        *([f"- Randomization level: {', '.join(map(str, levels))}"] if levels else []),
        f"- Instructions: {'; '.join(info.tasks[:5])}{' …' if len(info.tasks) > 5 else ''}",
        f"- Features: {', '.join(f'`{key}`' for key in info.features)}",
        "",
        "```bash",
        f"roboverse dataset get from={name} out=datasets/{name}",
        f"roboverse train policy=act dataset=datasets/{name} {_training_words(info)}",
        f"lerobot-train --dataset.repo_id={name} --policy.type=act --policy.push_to_hub=false",
        "```",
        "",
    ]
    return f"---\n{facts.to_yaml()}\n---\n\n" + "\n".join(lines)


def _looks(config: "TrainRunConfig") -> str:
    return f"varied `{config.env.only}` alone" if config.env.only else f"level {config.env.level}"


def _training_words(info: "DatasetInfo") -> str:
    """Returns the words of ``roboverse train`` that a dataset needs beside its folder."""
    from roboverse_learn.data.collection.schedule import read_record
    from roboverse_learn.data.dataset.info import is_collected_here

    if not is_collected_here(info.root):
        return f"task={next(iter(info.named_tasks), '<task>')}"
    return _words(read_record(info.root)[0])


def _words(settings: Mapping[str, Any]) -> str:
    """Returns the settings of an environment that differ from the usual ones as words of a command."""
    from roboverse_learn.config.value_text import as_text

    changed = flat(_changed(settings)).items()
    known = EnvSpec.__dataclass_fields__  # a text of theirs is taken as it is
    texts = {
        key: value if key in known and isinstance(value, str) else as_text(value) for key, value in changed
    }
    return " ".join(f"{key}={shlex.quote(text)}" for key, text in texts.items())


def _lerobot_words(settings: Mapping[str, Any]) -> str:
    """Returns them as words of LeRobot's commands, which take lists and maps as JSON."""
    changed = _changed(settings).items()
    texts = {key: value if isinstance(value, str) else json.dumps(value) for key, value in changed}
    return " ".join(f"--env.{key}={shlex.quote(text)}" for key, text in texts.items())


def _changed(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the task, and what differs from the usual environment."""
    usual = to_json_values(EnvSpec())
    differ = {key: settings[key] for key in usual if settings.get(key) not in (None, usual[key])}
    return {"task": settings["task"]} | differ


def _metrics(result: Result) -> "list[EvalResult]":
    """Returns the success of every cell of the test split in the hub's form."""
    from huggingface_hub import EvalResult

    return [
        EvalResult(
            task_type="robotics",
            dataset_type=f"roboverse/{result.env.task}",
            dataset_name=result.env.task,
            dataset_config=cell.cell.condition,
            dataset_split=cell.cell.split,
            metric_type="success_rate",
            metric_value=round(cell.success_rate, 4),
        )
        for cell in result.cells()
        if cell.cell.split == "test"
    ]


def _table(results: Sequence[Result]) -> list[str]:
    """Returns a table of every cell of the test split."""
    protocol = f"protocol {results[0].protocol.version}"
    lines = [
        f"Success in % of test episodes with its 95 % interval, last checkpoint, {protocol}.",
        "",
        "| task | tested at | episodes | success |",
        "|---|---|---:|---:|",
    ]
    for result in results:
        for cell in result.cells():
            if cell.cell.split == "test":
                rate, low, high = (
                    f"{100 * value:.0f}" for value in (cell.success_rate, cell.ci_low, cell.ci_high)
                )
                lines.append(
                    f"| {result.env.task} | {cell.cell} | {cell.episodes} | {rate} ({low} to {high}) |"
                )
    shas = sorted({result.git.sha[:12] for result in results if result.git})
    if shas:
        lines += ["", f"Commit of RoboVerse Learn: {', '.join(shas)}."]
    return lines
