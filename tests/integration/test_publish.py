"""``roboverse publish`` and ``roboverse dataset get``, by a hub that is a folder."""

import inspect
import re
import shlex
import shutil
from collections.abc import Callable
from fnmatch import fnmatch
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import draccus
import httpx
import pytest
from huggingface_hub import DatasetCard, HfApi, ModelCard
from huggingface_hub.errors import (
    HfHubHTTPError,
    LocalEntryNotFoundError,
    RepositoryNotFoundError,
    RevisionNotFoundError,
)
from lerobot.envs.configs import EnvConfig

from envs.lerobot.spec_options import spec_of
from envs.spec import EnvSpec
from roboverse_learn import cli
from roboverse_learn.config.compose import compose
from roboverse_learn.hub.cards import checkpoint_card
from tests.integration.main_run import TINY, MainRun

NAME = "somebody/something"


def refusal(kind: type[HfHubHTTPError], status: int, text: str) -> HfHubHTTPError:
    return kind(text, response=httpx.Response(status, request=httpx.Request("GET", "https://hub/x")))


CALLS = (
    *("create_repo", "upload_folder", "upload_file", "delete_tag", "create_tag", "list_repo_refs"),
    *("model_info", "repo_info", "list_repo_files", "snapshot_download"),
)


def as_typed(real: Callable[..., Any], ours: Callable[..., Any]) -> Callable[..., Any]:
    """Returns a call of ours that refuses what the real one has no argument for."""

    def call(*args: Any, **kwargs: Any) -> Any:
        inspect.signature(real).bind(None, *args, **kwargs)
        return ours(*args, **kwargs)

    return call


class Hub:
    """The calls of ``huggingface_hub`` that are used, on a folder."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.tags: list[str] = []
        self.private: bool | None = None

    def folder(self, name: str, kind: str | None) -> Path:
        return self.root / (kind or "model") / name

    def create_repo(self, name: str, *, repo_type: str, private: bool, exist_ok: bool) -> str:
        assert exist_ok
        if not self.folder(name, repo_type).is_dir():
            self.private = private
        self.folder(name, repo_type).mkdir(parents=True, exist_ok=True)
        return f"https://hub/{name}"

    def upload_folder(
        self,
        *,
        repo_id: str,
        repo_type: str,
        folder_path: Path,
        allow_patterns: list[str] | None,
        delete_patterns: list[str],
        ignore_patterns: list[str],
        commit_message: str,
    ) -> None:
        assert commit_message
        published = self.folder(repo_id, repo_type)
        for inner in files(published):
            if any(fnmatch(inner, each) for each in delete_patterns):
                (published / inner).unlink()
        for path in Path(folder_path).rglob("*"):
            inner = path.relative_to(folder_path).as_posix()
            allowed = allow_patterns is None or any(fnmatch(inner, each) for each in allow_patterns)
            if path.is_file() and allowed and not any(fnmatch(inner, each) for each in ignore_patterns):
                target = self.folder(repo_id, repo_type) / inner
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(path, target)

    def upload_file(
        self, *, path_or_fileobj: bytes, path_in_repo: str, repo_id: str, repo_type: str, commit_message: str
    ) -> None:
        assert commit_message
        (self.folder(repo_id, repo_type) / path_in_repo).write_bytes(path_or_fileobj)

    def delete_tag(self, name: str, *, tag: str, repo_type: str) -> None:
        assert (name, repo_type) == (NAME, "dataset")
        if tag not in self.tags:
            raise refusal(RevisionNotFoundError, 404, "no such tag")
        self.tags.remove(tag)

    def create_tag(self, name: str, *, tag: str, repo_type: str) -> None:
        assert (name, repo_type) == (NAME, "dataset") and tag not in self.tags
        self.tags.append(tag)

    def list_repo_refs(self, name: str, *, repo_type: str) -> Any:
        if not self.folder(name, repo_type).is_dir():
            raise refusal(RepositoryNotFoundError, 404, "Repository Not Found")
        return SimpleNamespace(tags=[SimpleNamespace(name=tag) for tag in self.tags])

    def repo_info(self, name: str, *, repo_type: str) -> Any:
        return SimpleNamespace(private=self.private)

    def list_repo_files(self, name: str, *, repo_type: str, revision: str) -> list[str]:
        assert revision in ("main", *self.tags)
        return sorted(files(self.folder(name, repo_type)))

    def model_info(self, name: str, **_: Any) -> Any:
        files = self.folder(name, "model").rglob("*")
        return SimpleNamespace(
            siblings=[SimpleNamespace(rfilename=path.name, size=path.stat().st_size) for path in files]
        )

    def snapshot_download(
        self,
        name: str,
        *,
        repo_type: str | None = None,
        local_dir: Path | None = None,
        local_files_only: bool = False,
        **_: Any,
    ) -> str:
        folder = self.folder(name, repo_type)
        if local_files_only:
            raise FileNotFoundError
        if local_dir is None:
            return str(folder)
        shutil.copytree(folder, local_dir, dirs_exist_ok=True)
        (Path(local_dir) / ".cache/huggingface").mkdir(parents=True, exist_ok=True)
        return str(local_dir)


@pytest.fixture
def hub(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Hub:
    """A hub, from whose names nothing is a folder here."""
    hub = Hub(tmp_path / "hub")
    for name in CALLS:
        monkeypatch.setattr(hub, name, as_typed(getattr(HfApi, name), getattr(hub, name)))
    monkeypatch.setattr("huggingface_hub.HfApi", lambda: hub)
    monkeypatch.setattr("huggingface_hub.snapshot_download", hub.snapshot_download)
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    return hub


def files(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.slow
def test_a_published_checkpoint_has_its_results_on_its_page_and_is_evaluated_by_its_name(
    hub: Hub, main_run: MainRun
) -> None:
    words = [f"checkpoint={main_run.run}", f"results_dir={main_run.folder / 'results'}", f"to={NAME}"]
    assert cli.main(["publish", *words, "license=apache-2.0"]) == 0
    published = hub.folder(NAME, "model")
    assert files(published) == files(main_run.checkpoint) | {"README.md"}
    assert hub.private is False and not hub.tags
    page = ModelCard((published / "README.md").read_text())
    assert (page.data.license, page.data.pipeline_tag, page.data.library_name) == (
        "apache-2.0",
        "robotics",
        "lerobot",
    )
    rows = [line for line in page.text.splitlines() if line.startswith("| PickCube |")]
    assert page.data.eval_results is not None and len(page.data.eval_results) == len(rows) > 0
    for row, metric in zip(rows, page.data.eval_results, strict=True):
        assert f"| {metric.dataset_config}, {metric.dataset_split} split |" in row
        assert f"| {100 * metric.metric_value:.0f} (" in row
    (command,) = re.findall(r"^roboverse (evaluate .*)$", page.text, re.MULTILINE)
    few = ["levels=[0]", "splits=[test]", "episodes=1", "videos=0", "device=cpu"]
    assert cli.main([*shlex.split(command), *few]) == 0
    (result,) = Path("results").rglob("*/act/*.json")
    assert NAME.split("/")[1] in result.name


@pytest.mark.slow
def test_results_of_another_checkpoint_are_not_on_the_page(
    hub: Hub,
    main_run: MainRun,
    capsys: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
) -> None:
    first = sorted((main_run.run / "checkpoints").glob("[0-9]*"))[0]
    assert not first.samefile(main_run.run / "checkpoints/last")
    words = [f"checkpoint={first}", f"results_dir={main_run.folder / 'results'}", f"to={NAME}"]
    assert cli.main(["publish", *words, "dry_run=true"]) == 0
    page = capsys.readouterr().out
    assert "# something" in page and "## Success" not in page
    assert "its page has no table" in caplog.text
    assert not hub.root.exists()


@pytest.mark.slow
def test_a_published_dataset_is_fetched_and_trained_on_by_the_words_of_its_page(
    hub: Hub, main_run: MainRun, tmp_path: Path
) -> None:
    published, dataset = hub.folder(NAME, "dataset"), tmp_path / "dataset"
    shutil.copytree(main_run.dataset, dataset)
    (dataset / ".staging/pool_000009").mkdir(parents=True)
    (dataset / ".staging/pool_000009/not_committed").touch()
    earlier = published / "data/chunk-000/file-999.parquet"
    for _ in range(2):  # a second time it is replaced, and so is its tag
        assert cli.main(["publish", f"dataset={dataset}", f"to={NAME}", "private=true"]) == 0
        assert not earlier.exists()
        earlier.write_bytes(b"of an earlier dataset, as the hub would have it")
    earlier.unlink()
    assert files(published) == (files(main_run.dataset) | {"README.md"}) - {".lock"}
    assert hub.private is True and hub.tags == ["v3.0"]
    page = DatasetCard((published / "README.md").read_text())
    assert "LeRobot" in page.data.tags and "license" not in page.data.to_dict()
    get, train = re.findall(r"^roboverse (.*)$", page.text, re.MULTILINE)
    assert cli.main(get.split()) == 0
    assert cli.main(get.split()) == 0  # once more, as after an interruption
    own = ("policy=", "task=", "image_size=", "cameras=", "num_demos=", "collect.", "levels=", "episodes=")
    tiny = [word for word in TINY if not word.startswith(own)]
    assert cli.main([*shlex.split(train), *tiny, "levels=[0]", "episodes=1"]) == 0

    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    fetched = LeRobotDataset(NAME, root=Path("datasets") / NAME)
    assert fetched.num_episodes == LeRobotDataset("x/y", root=main_run.dataset).num_episodes


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["publish", f"to={NAME}"], "publish needs checkpoint= or dataset=, and one of them alone"),
        (["publish", "checkpoint=a", "dataset=b", f"to={NAME}"], "and one of them alone"),
        (["publish", "dataset=b", "to=something"], "as owner/name; given 'something'"),
        (["publish", "dataset=b"], "to= is a name on the Hugging Face hub, as owner/name; nothing is given"),
        (["publish", "dataset=b", f"to={NAME}"], "There is no dataset in 'b'"),
        (["publish", "checkpoint=b", f"to={NAME}"], "Checkpoint 'b' does not exist"),
        (["dataset", "get"], "from= is a name on the Hugging Face hub, as owner/name; nothing is given"),
        (["dataset", "get", "from=a/b/c"], "given 'a/b/c'"),
        (["dataset", "get", "from=a/b--c"], "hub refuses; given 'a/b--c'. Cannot have -- or .. in repo_id"),
        (
            ["publish", "dataset=b", "to=a/b."],
            "to= is a name that the Hugging Face hub refuses; given 'a/b.'",
        ),
        (["dataset", "get", f"from={NAME}", "out="], "out= is empty, and names a file or folder"),
        (["dataset", "get", "form=a/b"], "Did you mean 'from'?"),
        (
            ["dataset", "get", "from=nobody/nothing"],
            "Could not get the dataset 'nobody/nothing': Repository Not",
        ),
        (["dataset", "get", f"from={NAME}", "out=full"], "out=full holds files of another origin"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_a_mistake_is_one_sentence(
    words: list[str], said: str, hub: Hub, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("full").mkdir()
    Path("full/mine.txt").touch()
    assert cli.main(words) == 2
    printed = capsys.readouterr().err
    assert said in printed and len(printed.splitlines()) == 1
    assert not hub.root.exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "advice"),
    [
        (
            refusal(HfHubHTTPError, 401, "401 Unauthorized"),
            "Log in with a token that may do this: hf auth login.",
        ),
        (httpx.ConnectError("no route to host"), "It needs a network"),
        (LocalEntryNotFoundError("no copy here"), "It needs a network"),
    ],
    ids=["not logged in", "no network", "no copy"],
)
def test_what_the_hub_refuses_is_one_sentence(
    fault: Exception,
    advice: str,
    hub: Hub,
    main_run: MainRun,
    monkeypatch: pytest.MonkeyPatch,
    error: Callable[[list[str]], str],
) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise fault

    monkeypatch.setattr(hub, "create_repo", refuse)
    said = error(["publish", f"dataset={main_run.dataset}", f"to={NAME}"])
    assert f"Could not publish to '{NAME}': {str(fault).splitlines()[0]}" in said and advice in said


def test_a_download_that_is_no_dataset_is_named(hub: Hub, error: Callable[[list[str]], str]) -> None:
    folder = hub.folder(NAME, "dataset")
    folder.mkdir(parents=True)
    (folder / "data.csv").touch()
    said = error(["dataset", "get", f"from={NAME}"])
    assert f"'{NAME}' is no LeRobotDataset: it has no meta/info.json. Nothing was downloaded." in said
    assert not Path("datasets").exists()


def test_a_folder_of_another_dataset_is_refused(hub: Hub, error: Callable[[list[str]], str]) -> None:
    for name in ("a/one", "a/two"):
        (hub.folder(name, "dataset") / "meta").mkdir(parents=True)
        (hub.folder(name, "dataset") / "meta/info.json").write_text("{}")
    assert "out/meta/info.json" in error(["dataset", "get", "from=a/one", "out=out"])
    before = files(Path("out"))
    said = error(["dataset", "get", "from=a/two", "out=out"])
    assert "out=out holds the dataset 'a/one', not 'a/two'. Name a new folder." in said
    assert files(Path("out")) == before


@pytest.mark.slow
def test_what_is_to_be_private_is_not_uploaded_to_a_public_name(
    hub: Hub, main_run: MainRun, error: Callable[[list[str]], str]
) -> None:
    hub.create_repo(NAME, repo_type="dataset", private=False, exist_ok=True)
    said = error(["publish", f"dataset={main_run.dataset}", f"to={NAME}", "private=true"])
    assert f"'{NAME}' exists and is public, and private=true makes only a new one private" in said
    assert not files(hub.folder(NAME, "dataset"))


@pytest.mark.parametrize(
    "words",
    [
        *("task=PickCube robot=ur5e_2f85", "task=PickCube only=lighting simulator=mujoco_warp"),
        "task=PickCube task_kwargs.lift_height_m=0.2 task_kwargs.variant=lift materials=+x",
        "task=PickCube scenario.physics.decimation=50 simulator_settings.iterations=40 cameras=[wrist]",
    ],
)
def test_the_commands_of_a_page_give_the_environment_of_the_run(words: str) -> None:
    config = compose("train", ["policy=act", "preset=quick", *words.split()])
    page = checkpoint_card(NAME, "act", config, [], "", True)
    ours, lerobots = (
        shlex.split(line) for line in page.splitlines() if line.startswith(("robov", "lerobot-"))
    )
    asked = compose("evaluate", ours[2:])
    env, materials = config.env.replace(level=0, only=None), config.env.materials
    of_checkpoint = {"cameras": env.cameras, "image_size": env.image_size, "materials": materials}
    assert EnvSpec.from_json(asked.env | of_checkpoint) == env
    assert asked.evaluate.materials == materials
    options = [word.replace("--env.", "--") for word in lerobots if word.startswith("--env.")]
    made = draccus.parse(EnvConfig.get_choice_class("roboverse"), args=options[1:])
    assert spec_of(made) == env


@pytest.mark.slow
def test_a_dataset_with_a_damaged_video_is_not_published(
    hub: Hub, main_run: MainRun, tmp_path: Path, error: Callable[[list[str]], str]
) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(main_run.dataset, copy)
    video = sorted(copy.rglob("*.mp4"))[0]
    video.write_bytes(video.read_bytes()[:200])
    assert video.name in error(["publish", f"dataset={copy}", f"to={NAME}"])
    assert not hub.root.exists()
