"""Facts that ``.ci/same_behaviour`` compares: names and values in the files that a command left.

Numbers stay as they are; everything long becomes a digest. Left out is what a command says of itself.
"""

import hashlib
import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pyarrow.parquet as parquet

Facts = Iterator[tuple[str, Any]]

TIMES = re.compile(r"_per_s$|_time_s$|^elapsed_s$")
"""Speeds in a log."""


def digest(content: Any) -> str:
    """Returns 16 digits for bytes, or for JSON values."""
    content = content if isinstance(content, bytes) else json.dumps(content, sort_keys=True).encode()
    return hashlib.sha256(content).hexdigest()[:16]


def tensors(path: Path) -> str:
    """Returns the digest of all tensors of a safetensors file, without its metadata."""
    content = path.read_bytes()
    begin = 8 + int.from_bytes(content[:8], "little")
    header = json.loads(content[8:begin])
    header.pop("__metadata__", None)
    whole = hashlib.sha256()
    for name, about in sorted(header.items()):
        first, last = (begin + offset for offset in about["data_offsets"])
        whole.update(f"{name}:{about['dtype']}:{about['shape']}:".encode() + content[first:last])
    return whole.hexdigest()[:16]


def of_dataset(path: Path) -> Facts:
    """Yields what a dataset holds, but for the settings that it names."""
    root = path.parents[1]
    table = parquet.read_table(root / "data")
    for name in table.column_names:
        yield f"column {name}", digest([str(table[name].type), table[name].to_pylist()])
    for row in parquet.read_table(root / "meta/episodes").to_pylist():
        about = json.loads(row["roboverse/metadata"])
        known = [about.get(key) for key in ("episode", "split", "initial_state_hash", "success")]
        yield f"episode {row['episode_index']}", [row["length"], row["tasks"], *known]
    for file in (root / "raw").glob("*"):
        yield f"raw {file.stem}", tensors(file)
    for file in (root / "videos").rglob("*.mp4"):
        yield str(file.relative_to(root)), digest(file.read_bytes())
    info = json.loads(path.read_text())
    yield "info", digest({key: info[key] for key in ("fps", "features", "robot_type", "splits")})
    yield "stats", digest(json.loads((root / "meta/stats.json").read_text()))
    if (root / "meta/import.json").exists():
        imported = json.loads((root / "meta/import.json").read_text())
        yield "import", [imported["num_read"], imported["num_passing"], imported["episodes"]]


def of_run(path: Path) -> Facts:
    """Yields the losses and the weights of a run, and what its optimizers hold."""
    for row in map(json.loads, path.read_text().splitlines()):
        yield f"step {row['step']}", {key: row[key] for key in row if not TIMES.search(key)}
    for file in path.parent.glob("checkpoints/[0-9]*/**/*.safetensors"):
        yield str(file.relative_to(path.parent)), tensors(file)


def of_result(path: Path) -> Facts:
    """Yields the episodes of an evaluation."""
    result = json.loads(path.read_text())
    for cell in result["records"]:
        columns = (cell[key] for key in ("initial_state_hash", "success", "length", "episode_return"))
        for episode, *facts in zip(cell["episode"], *columns, strict=True):
            yield f"level {cell['level']} alone {cell['only']} {cell['split']} {episode}", facts
    yield "cells", digest(result["cells"])


def of_leaderboard(path: Path) -> Facts:
    """Yields the table of each section."""
    for section in json.loads(path.read_text())["sections"]:
        rows = [[row[key] for key in ("label", "cells", "mean_test", "iqm_test")] for row in section["rows"]]
        yield f"table {section['id']}", digest(rows)


def of_replay(path: Path) -> Facts:
    """Yields the outcomes of replays."""
    for way, outcomes in json.loads(path.read_text())["replays"].items():
        yield from ((f"{way} {key}", digest(value)) for key, value in outcomes.items())


def of_experiments(path: Path) -> Facts:
    """Yields what a simulator conserves."""
    yield "experiments", digest(json.loads(path.read_text())["experiments"])


def of_steps(path: Path) -> Facts:
    """Yields what ``.ci/same_behaviour tasks`` wrote."""
    yield from json.loads(path.read_text()).items()


def of_file(path: Path) -> Facts:
    """Yields the whole file."""
    yield path.name, digest(path.read_bytes())


READERS: dict[str, Callable[[Path], Facts]] = {
    "datasets/**/meta/info.json": of_dataset,
    "runs/**/metrics.jsonl": of_run,
    "results/*/**/*.json": of_result,
    "results/*/**/*.mp4": of_file,
    "*/leaderboard.json": of_leaderboard,
    "published/leaderboard.*": of_file,
    "published/studies.*": of_file,
    "replays/*.json": of_replay,
    "conservation/mujoco.json": of_experiments,
    "converted/**/*.*": of_file,
    "tasks.json": of_steps,
}
"""Reader of each kind of file in a check's folder."""


def data_of(here: Path, printed: dict[str, str]) -> Facts:
    """Yields all that a check's commands left, the keys that they have and the plans that they print."""
    for pattern, reader in READERS.items():
        for path in here.glob(pattern):
            yield from reader(path)
    for command, text in printed.items():
        if "--help" in command:
            yield command, re.findall(r"^  (\S+=\S*)", text, re.MULTILINE)
        elif "dry_run" in command:
            yield command, re.findall(r"^roboverse .*", text, re.MULTILINE)


def called_of(here: Path, printed: dict[str, str]) -> Facts:
    """Yields the names and hashes that commands made of their settings."""
    yield "printed", re.findall(r"hash ([0-9a-f]{16})", " ".join(printed.values()))
    for pattern in ("datasets/**/meta/info.json", "runs/**/metrics.jsonl"):
        yield pattern.partition("/")[0], sorted(str(path.relative_to(here)) for path in here.glob(pattern))
    for path in here.glob("results/*/**/*.json"):
        result = json.loads(path.read_text())
        yield "result", [result["dataset_hash"], result["checkpoint"]["hash"], result["protocol_hash"]]


def take_steps(out: str, pattern: str) -> None:
    """Writes what five steps in every task of a pattern show in images and to an agent, or why not."""
    import gymnasium

    import envs

    found = {}
    for name in sorted(name for name in gymnasium.registry if re.match(f"RoboVerse/{pattern}", name)):
        if "observation" in gymnasium.spec(name).kwargs:
            continue  # the same task without images
        task = gymnasium.spec(name).kwargs["task"]
        views = {
            "seen": lambda name=name: gymnasium.make(name, level=3, image_size=32),
            "learned": lambda task=task: envs.make_vec(
                task, 2, split="test", level=3, observation="full", actions="rl", num_threads=1
            ),
        }
        for view, make in views.items():
            try:
                found |= {f"{name} {view} {key}": value for key, value in five_steps(make()).items()}
            except Exception as error:  # a package or file that is absent, a refused setting, a fault
                found[f"{name} {view}"] = f"{type(error).__name__}: {str(error).partition('.')[0]}"
    Path(out).write_text(json.dumps(found))


def five_steps(env: Any) -> dict[str, str]:
    """Returns digests of an env's bounds, observations, rewards and ends, and of the last images."""
    import numpy as np

    rng, space = np.random.default_rng(0), env.action_space
    low, high = np.clip(space.low, -10.0, 10.0), np.clip(space.high, -10.0, 10.0)
    observations, ends = [env.reset(seed=0)[0]], []
    for _ in range(5):
        observation, *end, _ = env.step((low + (high - low) * rng.random(low.shape)).astype(space.dtype))
        observations.append(observation)
        ends.append(np.array(end, np.float64))
    images = dict(observations[-1].get("pixels", {}).items())
    env.close()
    arrays = {key: np.stack([row[key] for row in observations]) for key in observations[0] if key != "pixels"}
    arrays |= {"ends": np.stack(ends), "low": space.low, "high": space.high, **images}
    return {key: digest(f"{array.dtype}".encode() + array.tobytes()) for key, array in arrays.items()}
