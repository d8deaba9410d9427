"""``roboverse publish``: a checkpoint or a dataset on the Hugging Face hub, with a page about it."""

import contextlib
import logging
from collections.abc import Sequence
from pathlib import Path

from benchmark.records import Result
from envs.core.errors import ConfigError
from roboverse_learn.config.other_commands import PublishConfig
from roboverse_learn.hub.names import check_name, hub_errors

log = logging.getLogger(__name__)

CARD = "README.md"

_DATASET_FOLDERS = ["data/*", "meta/*", "videos/*", "raw/*"]
"""Where LeRobot reads all that is there, also what an earlier dataset of the name left."""


def publish(config: PublishConfig) -> str:
    """Uploads a checkpoint or a dataset; returns what to print: where it is, and how it is used.

    Raises:
        ConfigError: Not one of both is named, the name is none, or the hub refuses.
        PolicyError: There is no checkpoint.
        DatasetError: There is no dataset, or it is damaged.
    """
    if bool(config.checkpoint) == bool(config.dataset):
        raise ConfigError(
            "publish needs checkpoint= or dataset=, and one of them alone, as in: roboverse publish "
            "checkpoint=runs/<task>/act/<run> to=owner/name"
        )
    check_name("to", config.to)
    folder, card, kind = _checkpoint(config) if config.checkpoint else _dataset(config)
    if config.dry_run:
        return f"'{folder}' would go to '{config.to}', with this page:\n\n{card}"
    return _upload(config, folder, card, kind)


def _checkpoint(config: PublishConfig) -> tuple[Path, str, str]:
    """Returns the folder of a checkpoint, its page, and the hub's kind of repository."""
    import policies
    from envs.core.fingerprint import file_hash
    from policies.checkpoint import policy_label, resolve, weights_path
    from roboverse_learn.commands.run_folder import read_config, result_name, run_of
    from roboverse_learn.hub.cards import checkpoint_card

    folder = resolve(config.checkpoint)
    run = run_of(folder)
    if run is None:
        raise ConfigError(
            f"The checkpoint '{config.checkpoint}' is in no run of roboverse train, so what it was trained "
            f"for is unknown. This uploads it as it is: hf upload {config.to} {folder}"
        )
    trained = read_config(run)
    weights = file_hash(weights_path(folder))
    results = _results(Path(config.results_dir), result_name(run), weights)
    if not results:
        log.warning("'%s' has no result of this checkpoint; its page has no table.", config.results_dir)
    lerobot = policies.learns_from(trained.policy_name) == "dataset"
    label = policy_label(folder)
    return folder, checkpoint_card(config.to, label, trained, results, config.license, lerobot), "model"


def _results(results_dir: Path, run: str, weights: str) -> Sequence[Result]:
    """Returns the evaluations of a run's checkpoint, one for each of its tasks."""
    from benchmark.results import read_result

    found = [read_result(path) for path in sorted(results_dir.glob(f"v*/**/{run}.json"))]
    return [result for result in found if result.checkpoint.hash == weights]


def _dataset(config: PublishConfig) -> tuple[Path, str, str]:
    """Returns the folder of a dataset, its page, and the hub's kind of repository.

    Raises:
        DatasetError: There is none, or one of its videos is damaged.
    """
    from roboverse_learn.data import DatasetInfo
    from roboverse_learn.data.dataset.images import damaged_videos
    from roboverse_learn.hub.cards import dataset_card

    info = DatasetInfo.open(config.dataset)
    if damaged := damaged_videos(info):
        raise damaged[0]
    return info.root, dataset_card(config.to, info, config.license), "dataset"


def _upload(config: PublishConfig, folder: Path, card: str, kind: str) -> str:
    from huggingface_hub import HfApi
    from huggingface_hub.errors import RevisionNotFoundError

    from policies.zoo.source import CHECKPOINT_FILES
    from roboverse_learn.data.dataset.schema import CODEBASE_VERSION
    from roboverse_learn.data.dataset.staging import STAGING_DIRECTORY

    api, name = HfApi(), config.to
    files: list[str] = list(CHECKPOINT_FILES)
    with hub_errors(f"publish to '{name}'"):
        url = api.create_repo(name, repo_type=kind, private=config.private, exist_ok=True)
        if config.private and not api.repo_info(name, repo_type=kind).private:
            raise ConfigError(
                f"'{name}' exists and is public, and private=true makes only a new one private. Name another "
                f"or change it in its settings: {url}/settings. Nothing was uploaded."
            )
        api.upload_folder(
            repo_id=name,
            repo_type=kind,
            folder_path=folder,
            allow_patterns=files if kind == "model" else None,
            delete_patterns=files if kind == "model" else _DATASET_FOLDERS,
            ignore_patterns=[CARD, ".cache/**", f"{STAGING_DIRECTORY}/**", "*.lock"],
            commit_message="RoboVerse Learn",
        )
        api.upload_file(
            path_or_fileobj=card.encode(),
            path_in_repo=CARD,
            repo_id=name,
            repo_type=kind,
            commit_message="Page",
        )
        if kind == "dataset":  # LeRobot looks for the tag of its format
            with contextlib.suppress(RevisionNotFoundError):
                api.delete_tag(name, tag=CODEBASE_VERSION, repo_type=kind)
            api.create_tag(name, tag=CODEBASE_VERSION, repo_type=kind)
    return f"{url}\n{_use(name, kind)}"


def _use(name: str, kind: str) -> str:
    if kind == "dataset":
        return f"Use it: roboverse dataset get from={name} out=datasets/{name}"
    return f"Use it: roboverse evaluate policy.path={name} task=<task>"
