"""LeRobot's commands, as they are, drive a simulated robot; what they record trains here."""

import contextlib
import io
import json
import os
import pty
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from roboverse_learn import cli
from roboverse_learn.data import DatasetInfo
from tests.integration.main_run import TINY
from tests.integration.test_lerobot_commands import TINY_ACT

pytestmark = pytest.mark.long

ROBOT = ("--robot.type=roboverse", "--robot.task=PickCube", "--robot.image_size=32")
RECORDED = ("--dataset.repo_id=local/recorded", "--dataset.root=recorded")


class Shell:
    """Runs commands of LeRobot in one folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def run(self, command: str, *words: str) -> str:
        """Runs one to its end; returns what it printed."""
        done = subprocess.run(
            [
                Path(sys.executable).with_name(command),
                *words,
                "--robot.discover_packages_path=envs.lerobot",
                f"--robot.outcomes={command}.jsonl",
            ],
            cwd=self.folder,
            env=self.environment(),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=300,
        )
        assert done.returncode == 0, done.stdout[-4000:]
        return done.stdout

    def run_with_keys(self, command: str, keys: Sequence[tuple[str, float, str]], *words: str) -> str:
        """Runs a command in a terminal; each key is pressed some seconds after a text was printed."""
        master, terminal = pty.openpty()
        printed, waiting = list[str](), deque(keys)
        with subprocess.Popen(
            [Path(sys.executable).with_name(command), *words, "--robot.discover_packages_path=envs.lerobot"],
            cwd=self.folder,
            env=self.environment(),
            stdin=terminal,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        ) as process:
            watchdog = threading.Timer(300, process.kill)
            watchdog.start()
            assert process.stdout is not None
            for line in process.stdout:
                printed.append(line)
                if waiting and waiting[0][0] in line:
                    _, seconds, key = waiting.popleft()
                    threading.Timer(seconds, os.write, (master, key.encode())).start()
            watchdog.cancel()
        os.close(master)
        os.close(terminal)
        assert process.returncode == 0 and not waiting, "".join(printed)[-4000:]
        return "".join(printed)

    def environment(self) -> dict[str, str]:
        """Returns the environment of a command."""
        environment = os.environ | {"HF_HUB_OFFLINE": "1", "PYTHONPATH": str(Path(cli.__file__).parents[1])}
        return environment | {
            key: str(self.folder / "home") for key in ("HF_DATASETS_CACHE", "HF_LEROBOT_HOME")
        }

    def outcomes(self, command: str) -> list[dict[str, int | bool | None]]:
        """Returns what a command's robot wrote of its episodes."""
        lines = (self.folder / f"{command}.jsonl").read_text().splitlines()
        return [json.loads(line) for line in lines]


@pytest.fixture(scope="module")
def shell(tmp_path_factory: pytest.TempPathFactory) -> Shell:
    """A folder in which ``lerobot-record`` has recorded two episodes of the expert."""
    shell = Shell(tmp_path_factory.mktemp("robot"))
    shell.run(
        "lerobot-record",
        *(
            *ROBOT,
            *RECORDED,
            "--teleop.type=roboverse_expert",
            "--dataset.fps=20",
            "--dataset.num_episodes=2",
        ),
        # Time is that of the wall: a slow machine takes fewer steps in it.
        *("--dataset.episode_time_s=8", "--dataset.reset_time_s=0.3", "--dataset.single_task=Pick the cube"),
        *("--dataset.push_to_hub=false", "--dataset.streaming_encoding=true", "--play_sounds=false"),
        "--dataset.rgb_encoder.vcodec=h264",
    )
    return shell


def test_the_expert_is_recorded_from_the_start_of_each_episode(shell: Shell) -> None:
    info = DatasetInfo.open(shell.folder / "recorded")
    assert (info.num_episodes, info.fps, info.robot_type) == (2, 20, "roboverse")
    assert info.features["action"]["names"][:2] == ["joint1.pos", "joint2.pos"]
    outcomes = shell.outcomes("lerobot-record")
    assert [outcome["success"] for outcome in outcomes] == [True, True]
    columns = info.read_columns(["observation.state", "action"])
    for start, end in zip(info.episode_starts, info.episode_ends, strict=True):
        states, actions = (columns[key][start:end] for key in ("observation.state", "action"))
        assert np.abs(np.diff(states, axis=0)).max() < 0.2  # no scene was reset within an episode
        assert np.abs(actions[0] - states[0]).max() < 0.1


def test_replays_of_its_actions_solve_the_same_episode(shell: Shell) -> None:
    shell.run("lerobot-replay", *ROBOT, *RECORDED, "--dataset.episode=0", "--play_sounds=false")
    first = shell.outcomes("lerobot-record")[0]
    (replayed,) = shell.outcomes("lerobot-replay")
    assert (replayed["episode"], replayed["solved_at"]) == (first["episode"], first["solved_at"])
    shell.run(
        "lerobot-teleoperate",
        *(*ROBOT, "--teleop.type=roboverse_replay", "--teleop.path=recorded", "--teleop.episode=0"),
        *("--fps=20", "--teleop_time_s=8"),
    )
    (steered,) = shell.outcomes("lerobot-teleoperate")
    assert (steered["episode"], steered["solved_at"]) == (first["episode"], first["solved_at"])


@pytest.fixture(scope="module")
def trained(shell: Shell) -> tuple[Path, str]:
    """Returns the checkpoint of a run of ours on what was recorded, and what the run printed."""
    words = [*TINY, f"dataset={shell.folder / 'recorded'}", "levels=[0]"]
    words += [f"run={shell.folder / 'run'}", f"results_dir={shell.folder / 'results'}"]
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        assert cli.main(["train", *words]) == 0
    return shell.folder / "run/checkpoints/last/pretrained_model", printed.getvalue()


def test_what_was_recorded_trains_here_and_the_policy_acts_in_a_rollout(
    shell: Shell, trained: tuple[Path, str]
) -> None:
    checkpoint, printed = trained
    assert "level 0" in printed and "The policy is not evaluated" not in printed
    log = shell.run(
        "lerobot-rollout",
        *(*ROBOT, "--robot.split=test", "--strategy.type=base", f"--policy.path={checkpoint}"),
        *("--fps=20", "--duration=4", "--task=Pick the cube", "--device=cpu"),
    )
    assert "Duration limit reached" in log
    (outcome,) = shell.outcomes("lerobot-rollout")
    assert isinstance(outcome["steps"], int) and outcome["steps"] > 10


def test_the_expert_corrects_a_policy_in_lerobots_dagger(shell: Shell, trained: tuple[Path, str]) -> None:
    """Space pauses the policy, tab begins the correction and ends it."""
    shell.run_with_keys(
        "lerobot-rollout",
        [("recording started", 1.0, " "), ("autonomous -> paused", 1.0, "\t"), ("-> correcting", 5.0, "\t")],
        *(*ROBOT, "--strategy.type=dagger", "--strategy.num_episodes=1", "--strategy.smooth_handover=false"),
        *(f"--policy.path={trained[0]}", "--teleop.type=roboverse_expert", "--dataset.root=corrected"),
        *("--dataset.repo_id=local/rollout_fix", "--dataset.fps=20", "--fps=20", "--device=cpu"),
        *("--dataset.single_task=Pick the cube", "--dataset.push_to_hub=false", "--play_sounds=false"),
        *("--dataset.streaming_encoding=true", "--dataset.rgb_encoder.vcodec=h264"),
    )
    info = DatasetInfo.open(shell.folder / "corrected")
    assert info.num_episodes == 1 and info.num_frames > 5
    assert info.read_columns(["intervention"])["intervention"].all()


def test_what_was_recorded_trains_by_lerobots_own_program(shell: Shell) -> None:
    done = subprocess.run(
        [
            Path(sys.executable).with_name("lerobot-train"),
            *(*TINY_ACT, *RECORDED, "--dataset.use_imagenet_stats=false", "--dataset.video_backend=pyav"),
            *("--output_dir=by_lerobot", "--steps=1", "--batch_size=2", "--num_workers=0", "--save_freq=1"),
            "--wandb.enable=false",
        ],
        cwd=shell.folder,
        env=shell.environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stdout[-4000:]
    config = json.loads(
        (shell.folder / "by_lerobot/checkpoints/last/pretrained_model/config.json").read_text()
    )
    assert config["output_features"]["action"]["shape"] == [9]
