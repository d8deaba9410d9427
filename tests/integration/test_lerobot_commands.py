"""LeRobot both ways: its commands, as they are, on our envs and our policies; our command on its policy."""

import json
import os
import tomllib
from collections.abc import Mapping
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from benchmark.results import read_result
from envs.spec import EnvSpec
from policies.checkpoint import WEIGHTS
from roboverse_learn import cli
from roboverse_learn.data.dataset.raw import read_raw
from tests import imported_process
from tests.integration.main_run import MainRun

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
PLUGIN = ROOT / "envs/lerobot/plugin"
ENV = ("--env.type=roboverse", "--env.task=PickCube", "--env.image_size=32")
TINY_ACT = (
    *("--policy.type=act", "--policy.device=cpu", "--policy.push_to_hub=false"),
    *("--policy.pretrained_backbone_weights=null", "--policy.dim_model=32", "--policy.n_heads=2"),
    *("--policy.dim_feedforward=32", "--policy.chunk_size=50", "--policy.n_action_steps=50"),
)


@pytest.fixture(scope="module")
def installed_plugin(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Returns a folder that holds the plugin as an installer lays it out, without asking a registry."""
    folder = tmp_path_factory.mktemp("site")
    project = tomllib.loads((PLUGIN / "pyproject.toml").read_text())
    metadata = project["project"]
    about = folder / f"{metadata['name']}-{metadata['version']}.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {metadata['name']}\nVersion: {metadata['version']}\n"
    )
    for name in project["tool"]["hatch"]["build"]["targets"]["wheel"]["include"]:
        (folder / name).write_bytes((PLUGIN / name).read_bytes())
    return folder


class Commands:
    """What LeRobot's two commands left behind.

    Attributes:
        folder: Their working folder: ``trained`` and ``evaluated`` are their outputs.
        logs: What each printed.
    """

    def __init__(self, folder: Path, run: MainRun, plugin: Path) -> None:
        self.folder = folder
        train = (
            *ENV,
            *TINY_ACT,
            *("--dataset.repo_id=local/pick_cube", f"--dataset.root={run.dataset}"),
            *("--dataset.use_imagenet_stats=false", "--dataset.video_backend=pyav", "--output_dir=trained"),
            *("--steps=2", "--batch_size=2", "--num_workers=0", "--log_freq=1", "--save_freq=2"),
            *("--env_eval_freq=2", "--eval.n_episodes=1", "--eval.batch_size=1", "--wandb.enable=false"),
        )
        evaluate = (
            *ENV,
            *("--env.discover_packages_path=envs.lerobot", "--env.level=3", "--policy.device=cpu"),
            *(f"--policy.path={run.checkpoint}", "--eval.n_episodes=3", "--eval.batch_size=2"),
            "--output_dir=evaluated",
        )
        running = {
            "train": self._start("lerobot-train", train, [plugin, ROOT]),
            "eval": self._start("lerobot-eval", evaluate, [plugin, ROOT]),
        }
        codes = imported_process.wait_for_all(list(running.values()), timeout_s=300)
        self.codes = dict(zip(running, codes, strict=True))
        self.logs = {name: self._log(f"lerobot-{name}").read_text() for name in running}

    def _log(self, command: str) -> Path:
        return self.folder / f"{command}.log"

    def _start(self, command: str, words: tuple[str, ...], path: list[Path]) -> BaseProcess:
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, path)), "HF_HUB_OFFLINE": "1"}
        environment["HF_DATASETS_CACHE"] = str(self.folder / "cache")
        program, log = imported_process.installed(command), self._log(command)
        return imported_process.start(program, *words, folder=self.folder, out=log, env=environment)


@pytest.fixture(scope="module")
def commands(tmp_path_factory: pytest.TempPathFactory, main_run: MainRun, installed_plugin: Path) -> Commands:
    """Runs ``lerobot-train`` on our dataset and env, and ``lerobot-eval`` on our env and checkpoint."""
    return Commands(tmp_path_factory.mktemp("lerobot"), main_run, installed_plugin)


def test_lerobot_train_runs_on_our_dataset_and_evaluates_on_our_env(commands: Commands) -> None:
    assert commands.codes["train"] == 0, commands.logs["train"][-4000:]
    assert "Could not import third-party plugin" not in commands.logs["train"]
    config = json.loads(
        (commands.folder / "trained/checkpoints/last/pretrained_model/config.json").read_text()
    )
    assert config["type"] == "act"
    assert config["input_features"]["observation.images.front"]["shape"] == [3, 32, 32]
    assert config["output_features"]["action"]["shape"] == [9]
    assert list((commands.folder / "trained/eval").rglob("eval_episode_0.mp4"))


def test_lerobot_eval_runs_our_policy_on_our_env(commands: Commands, main_run: MainRun) -> None:
    assert commands.codes["eval"] == 0, commands.logs["eval"][-4000:]
    info = json.loads((commands.folder / "evaluated/eval_info.json").read_text())
    (task,) = info["per_task"]
    assert task["task_group"] == "roboverse"
    assert len(task["metrics"]["successes"]) == info["overall"]["n_episodes"] == 3
    assert all(np.isfinite(task["metrics"]["sum_rewards"]))
    # A policy that has learned for a moment neither solves the task nor leaves the robot where it was.
    assert len(set(task["metrics"]["sum_rewards"])) == 3


def test_our_command_evaluates_what_lerobot_trained(
    commands: Commands, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    checkpoint = commands.folder / "trained/checkpoints/last/pretrained_model"
    words = ["levels=[0]", "splits=[test]", "episodes=1", "videos=0", "device=cpu", "task=PickCube"]
    assert cli.main(["evaluate", f"checkpoint={checkpoint}", f"results_dir={tmp_path}", *words]) == 0
    (path,) = (tmp_path / "v2/PickCube/act").glob("*.json")
    result = read_result(path)
    assert (result.policy, result.env.image_size, len(result.records)) == ("act", 32, 1)
    assert result.train_level is None  # nothing says what it was trained on
    assert "level 0" in capsys.readouterr().out


def test_lerobot_opens_our_checkpoint_and_acts_as_we_do(main_run: MainRun) -> None:
    from lerobot.configs import PreTrainedConfig
    from lerobot.policies.factory import get_policy_class, make_pre_post_processors

    import policies

    config = PreTrainedConfig.from_pretrained(main_run.checkpoint)
    assert config.type == "keypoint_act"
    theirs = get_policy_class(config.type).from_pretrained(main_run.checkpoint)
    before, after = make_pre_post_processors(
        theirs.config,
        str(main_run.checkpoint),
        preprocessor_overrides={"device_processor": {"device": "cpu"}},
    )
    ours = policies.load(main_run.checkpoint)
    rng = np.random.default_rng(0)
    state = rng.normal(size=(1, 9)).astype(np.float32)
    image = rng.integers(0, 256, (1, 32, 32, 3), dtype=np.uint8)
    batch = {
        "observation.state": torch.from_numpy(state),
        "observation.images.front": torch.from_numpy(image).permute(0, 3, 1, 2).float() / 255,
    }
    theirs.eval().reset()
    with torch.inference_mode():
        first = after(theirs.select_action(before(batch))).numpy()
    chunk = ours.act({"observation.state": state, "observation.images.front": image})
    np.testing.assert_allclose(chunk[:, 0], first, atol=1e-5)
    assert (main_run.checkpoint / WEIGHTS).is_file()


def test_lerobot_reads_every_frame_of_our_dataset(
    main_run: MainRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import datasets
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    monkeypatch.setattr(datasets.config, "HF_DATASETS_CACHE", tmp_path)
    dataset = LeRobotDataset("local/pick_cube", root=main_run.dataset, video_backend="pyav")
    assert (dataset.num_episodes, dataset.fps) == (4, 20)
    last = dataset[len(dataset) - 1]
    assert last["observation.images.front"].shape == (3, 32, 32)
    assert float(last["observation.images.front"].std()) > 0.01
    arrays, _ = read_raw(main_run.dataset, 3)
    expected = arrays["robots/franka/joint_pos"][int(last["frame_index"])]
    np.testing.assert_allclose(last["observation.state"].numpy(), expected, atol=1e-5)


class Replay(torch.nn.Module):
    """A policy in LeRobot's eyes that repeats the actions of a demonstration."""

    def __init__(self, actions: np.ndarray) -> None:
        super().__init__()
        self.actions, self.next = torch.from_numpy(actions), 0

    def reset(self) -> None:
        self.next = 0

    def select_action(self, observation: Mapping[str, Any]) -> torch.Tensor:
        """Returns the same action for every environment; the last one stays."""
        action = self.actions[min(self.next, len(self.actions) - 1)]
        self.next += 1
        return action.expand(len(observation["observation.state"]), -1)


def test_lerobot_counts_the_successes_that_our_env_reports(
    main_run: MainRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The demonstrated actions solve their own episode and not another one."""
    import pyarrow.parquet as pq
    from lerobot.scripts.lerobot_eval import rollout

    table = pq.read_table(main_run.dataset / "data")
    rows = table.filter(np.array(table["episode_index"]) == 0)
    actions = np.stack(rows["action"].to_numpy()).astype(np.float32)
    _, facts = read_raw(main_run.dataset, 0)
    env = EnvSpec(image_size=32).make(2, autoreset_mode="SameStep")
    others = [int(index) for index in env.split_indices if index != facts["episode"]]
    chosen, reset = {"episodes": (facts["episode"], others[7])}, env.reset
    monkeypatch.setattr(env, "reset", lambda seed=None, options=None: reset(seed=seed, options=chosen))
    try:
        out = rollout(env, Replay(actions), *[lambda value: value] * 4, seeds=[0, 1])
    finally:
        env.close()
    done = out["done"].int().argmax(dim=1)
    reached = [bool(out["success"][i, : done[i] + 1].any()) for i in range(2)]
    assert reached == [True, False]
    assert done[1] == 99  # the task's horizon
    assert float(out["reward"][0, done[0]]) == 1.0
