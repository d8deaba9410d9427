"""The folder of a run: its name, its manifest, its lock, its log and its seeds.

``runs/<task>/<policy>/<name>/`` holds ``config.yaml`` (the resolved configuration), ``manifest.json``
(command, commit, versions, status and time of each stage), ``run.log``, and what training writes. The
name follows from the configuration, so that the same command finds the same run and continues it. A dataset
of another program takes the place of the task.
"""

import contextlib
import json
import logging
import shlex
import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from filelock import BaseFileLock

from envs.core.atomic import write_file
from envs.core.errors import ConfigError, LockedError, MissingAssetError, RoboVerseError, UnknownNameError
from envs.core.fingerprint import digest
from envs.core.registry import OF_YOUR_OWN, named_plugins
from policies.checkpoint import HASHES, of_steps
from roboverse_learn.commands.run_identity import changes, changes_of_result, is_of_others, run_name
from roboverse_learn.commands.scene_labels import fit_for_a_file
from roboverse_learn.config.command_line_keys import plugin_names
from roboverse_learn.config.schema import TrainRunConfig
from roboverse_learn.config.serialize import from_values, to_values
from roboverse_learn.folder_lock import lock_directory

log = logging.getLogger(__name__)

CONFIG_FILE = "config.yaml"
MANIFEST_FILE = "manifest.json"

_LONGEST_NAME = 80
"""Of a run's name in its results, in characters; the parts that an evaluation adds have the rest of 120."""

_STREAMS = ("training", "collection")


def seed_of(config: TrainRunConfig, stream: str) -> int:
    """Returns the 32-bit seed of one independent stream of randomness of a run.

    Args:
        config: The run's configuration.
        stream: ``training`` or ``collection``.
    """
    sequence = np.random.SeedSequence(config.seed, spawn_key=(_STREAMS.index(stream),))
    return int(sequence.generate_state(1)[0])


def read_config(folder: Path) -> TrainRunConfig:
    """Reads the configuration that a run was started with.

    Raises:
        ConfigError: The folder is not that of a run, or its configuration cannot be read.
        UnknownNameError: It names what is not registered, such as a policy of a plugin.
    """
    import yaml

    path = folder / CONFIG_FILE
    try:
        values = yaml.safe_load(path.read_text())
    except FileNotFoundError as error:
        raise ConfigError(f"'{folder}' is not the folder of a run: it has no {CONFIG_FILE}.") from error
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ConfigError(f"'{path}' cannot be read: {' '.join(str(error).split())}.") from error
    if not isinstance(values, dict) or "policy_name" not in values:
        raise ConfigError(
            f"'{path}' is not the configuration of a run: it does not name a policy. Restore it from a copy, "
            "or begin another run."
        )
    try:
        return from_values("train", values)
    except MissingAssetError:
        raise
    except UnknownNameError as error:
        raise of_its_plugins(error, folder) from error
    except ConfigError as error:
        raise ConfigError(
            f"'{path}' does not fit this version, or is damaged: {error} Restore it from a copy, or begin "
            "another run."
        ) from error


def of_its_plugins(error: UnknownNameError, folder: Path) -> UnknownNameError:
    """Returns an error about a run with the ``plugins=[...]`` of its training that this process lacks.

    Args:
        error: What is unknown.
        folder: The run's folder.
    """
    lacking = [name for name in _plugins_of(folder) if name not in named_plugins()]
    if not lacking or not str(error).endswith(OF_YOUR_OWN):  # as an option that is gone by now does
        return UnknownNameError(str(error))
    said = str(error).removesuffix(OF_YOUR_OWN).rstrip()
    return UnknownNameError(f"{said} '{folder}' was trained with plugins=[{','.join(lacking)}]: add that.")


def _plugins_of(folder: Path) -> list[str]:
    """Returns the plugins that the commands of a run named; none where its manifest cannot be read."""
    try:
        starts = json.loads((folder / MANIFEST_FILE).read_text())["starts"]
        return plugin_names(word for start in starts for word in shlex.split(start["command"]))
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return []


def run_of(checkpoint: Path) -> Path | None:
    """Returns the folder of the run that a checkpoint lies in, or None."""
    return next((path for path in checkpoint.absolute().parents if (path / CONFIG_FILE).is_file()), None)


def result_name(folder: Path) -> str:
    """Returns the name of a run in its results: its folder's, or one made of it that is fit for a file.

    A name that was changed ends in a hash of the folder's, so that no two names share a results file.
    """
    name = folder.absolute().name
    fit = fit_for_a_file(name).lstrip("._+=-")[:_LONGEST_NAME]
    return name if fit == name else f"{fit or 'run'}-{digest(name)}"


def read_facts(folder: Path, stage: str) -> dict[str, Any]:
    """Returns what the manifest of a run says of one stage; nothing where it cannot be read."""
    try:
        facts = json.loads((folder / MANIFEST_FILE).read_text())["stages"].get(stage, {})
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}
    return facts if isinstance(facts, dict) else {}


class RunFolder:
    """One run on disk, opened for writing by one process.

    Args:
        folder: The run's folder.
        config: Its resolved configuration.
        command: The words of the command line.
    """

    def __init__(self, folder: Path, config: TrainRunConfig, command: list[str]) -> None:
        self.folder = folder
        self.config = config
        self._lock = _lock(folder)
        try:
            self._manifest = self._open_manifest(command)
            if not (folder / CONFIG_FILE).exists() or to_values(config) != to_values(read_config(folder)):
                _write_config(folder / CONFIG_FILE, config)
            self._handler = logging.FileHandler(folder / "run.log")
        except BaseException:
            self._lock.release()
            raise
        self._handler.setFormatter(logging.Formatter("%(asctime)s %(name)s %(levelname)s %(message)s"))
        logging.getLogger().addHandler(self._handler)
        self._save("running")

    @classmethod
    def open(cls, config: TrainRunConfig, command: list[str]) -> "RunFolder":
        """Opens the run of a configuration: the one that exists already, or a new one.

        Raises:
            ConfigError: as :func:`find_run`, or another process has it open.
        """
        return cls(*find_run(config), command)

    @property
    def name(self) -> str:
        """The last part of the folder, which also names the result file."""
        return self.folder.name

    @contextlib.contextmanager
    def stage(self, name: str) -> Iterator[dict[str, Any]]:
        """Records the status and the time of one stage in the manifest.

        Yields:
            A dictionary for facts about the stage; it is saved when the stage ends.
        """
        facts: dict[str, Any] = self._manifest["stages"].get(name, {}) | {"status": "running"}
        facts.pop("error", None)
        self._manifest["stages"][name] = facts
        self._save("running")
        started = time.monotonic()
        try:
            yield facts
        except BaseException as error:
            facts |= {"status": "stopped", "error": f"{type(error).__name__}: {error}"}
            self._finish(facts, started, "stopped")
            raise
        facts["status"] = "done"
        self._finish(facts, started, "running")

    @property
    def stages(self) -> Mapping[str, Any]:
        """Status, time and facts of every stage so far."""
        return self._manifest["stages"]

    def close(self, status: str = "done") -> None:
        """Writes the final status and lets another process open the run."""
        self._save(status)
        logging.getLogger().removeHandler(self._handler)
        self._handler.close()
        self._lock.release()

    def __enter__(self) -> "RunFolder":
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self.close("done" if kind is None else "stopped")

    def _open_manifest(self, command: list[str]) -> dict[str, Any]:
        from benchmark.provenance import git_state, now, package_versions

        git = git_state()
        started = {
            "command": shlex.join(command),
            "time": now(),
            "git": {"sha": git.sha, "dirty": git.dirty} if git else None,
            "versions": package_versions(),
        }
        path = self.folder / MANIFEST_FILE
        try:
            manifest = json.loads(path.read_text())
            manifest["starts"].append(started)
        except FileNotFoundError:
            manifest = {"starts": [started], "stages": {}}
        except (ValueError, KeyError, TypeError, AttributeError):
            log.warning("%s could not be read and is written again.", path)
            manifest = {"starts": [started], "stages": {}}
        return manifest

    def _finish(self, facts: dict[str, Any], started: float, status: str) -> None:
        facts["seconds"] = round(time.monotonic() - started, 3)
        with contextlib.suppress(RoboVerseError):  # a full disk must not hide the error of the stage
            self._save(status)

    def _save(self, status: str) -> None:
        self._manifest |= {"status": status, "config": to_values(self.config)}
        content = json.dumps(self._manifest, indent=1, default=str)
        write_file(self.folder / MANIFEST_FILE, content.encode())


def step_of(checkpoint: Path) -> int | None:
    """Returns the training step of a checkpoint, from the name of its folder; None where no name says it."""
    checkpoint = checkpoint.resolve()
    folders, hashes = [checkpoint.parent], checkpoint / HASHES
    if checkpoint.parent.name == "last" and hashes.is_file():  # copied as a folder, beside the one it was
        twins = [each / checkpoint.name / HASHES for each in of_steps(checkpoint.parent.parent)]
        same = [twin for twin in twins if twin.is_file() and twin.read_bytes() == hashes.read_bytes()]
        folders = [twin.parents[1] for twin in same]
    return max((int(each.name) for each in folders if each.name.isdecimal()), default=None)


def find_run(config: TrainRunConfig) -> tuple[Path, TrainRunConfig]:
    """Returns the folder of the run of a configuration, and the configuration that the run goes on with.

    Raises:
        ConfigError: ``run=`` names a run of another configuration, a folder with other files, or one whose
            results would overwrite those of another run.
    """
    folder = Path(config.run) if config.run else default_folder(config)
    if (folder / CONFIG_FILE).exists():
        config = _continued(folder, config)
    elif other := _other_file(folder):
        raise ConfigError(
            f"The folder '{folder}' is no run and holds other files, such as '{other}'. Name an empty or "
            "a new folder, or leave out run=."
        )
    elif config.run:
        _check_results(folder, config)
    return folder, config


def default_folder(config: TrainRunConfig) -> Path:
    """Returns the folder that a configuration names; with ``resume=false`` the first free one."""
    task = Path(config.dataset).resolve().name if is_of_others(config) else config.env.task
    base = Path(config.runs_dir) / task / config.policy_name / run_name(config)
    folder, number = base, 2
    while not config.resume and folder.exists():
        folder, number = base.with_name(f"{base.name}-{number}"), number + 1
    return folder


def _other_file(folder: Path) -> str | None:
    """Returns a file or folder that a run which ended before its configuration was written does not leave."""
    names = sorted(path.name for path in folder.iterdir()) if folder.is_dir() else []
    return next((name for name in names if not name.startswith((".", CONFIG_FILE, MANIFEST_FILE))), None)


def _continued(folder: Path, config: TrainRunConfig) -> TrainRunConfig:
    """Returns the configuration of a run that goes on: with the steps that it has where it has done more.

    Raises:
        ConfigError: It would go on as another one, or ``run=`` with fewer steps than it has done.
    """
    before = read_config(folder)
    if what := changes(before, config):
        raise ConfigError(
            f"The run '{folder}' was started with another configuration: you gave {what}. "
            "Leave these keys out to continue it, or leave out run= to start a new run."
        )
    done = max((int(each.name) for each in of_steps(folder / "checkpoints")), default=0)
    given = config.train.steps
    if given >= min(done, before.train.steps):  # an agent's last steps may go beyond those that were wanted
        return config
    if config.run:
        raise ConfigError(
            f"The run '{folder}' has done {done:,} steps, and train.steps={given} is fewer. Give more than "
            f"{done} to continue it, leave train.steps out, or name another folder to start a new run."
        )
    return replace(config, train=replace(config.train, steps=before.train.steps))


def _check_results(folder: Path, config: TrainRunConfig) -> None:
    """Refuses a new run whose results would replace those of another, whose folder has the same name."""
    for path in Path(config.results_dir).glob(f"v*/{config.env.task}/*/{result_name(folder)}.json"):
        try:
            earlier = from_values("train", json.loads(path.read_text())["config"])
        except (OSError, ValueError, KeyError, TypeError, RoboVerseError):
            continue  # it is not that of a run
        if earlier.policy_name == config.policy_name and (what := changes_of_result(earlier, config)):
            raise ConfigError(
                f"'{path}' has the results of another run whose folder is named '{folder.name}': you gave "
                f"{what}. Name the folder otherwise, as run={folder}-seed{config.seed}, or move the file."
            )


def _write_config(path: Path, config: TrainRunConfig) -> None:
    write_file(path, config_text(config).encode())


def config_text(config: TrainRunConfig) -> str:
    """Returns the resolved configuration of a run, as its ``config.yaml`` holds it."""
    import yaml

    return yaml.safe_dump(to_values(config), sort_keys=False)


def _lock(folder: Path) -> BaseFileLock:
    """Takes the run's lock, which the system releases when the process ends however it ends."""
    folder.mkdir(parents=True, exist_ok=True)
    try:
        return lock_directory(folder)
    except LockedError as error:
        raise ConfigError(
            f"Another process is working on the run '{folder}'. Wait for it to end, or start a run beside "
            "it with resume=false."
        ) from error
