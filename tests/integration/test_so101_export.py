"""A checkpoint of the SO-101's twin on LeRobot's own driver of the arm: fake motors, its command as it is."""

import contextlib
import io
import json
import shlex
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from lerobot.cameras import Camera

from policies.checkpoint import CONFIG, PREPROCESSOR, read_json
from roboverse_learn import cli
from roboverse_learn.data import DatasetInfo
from tests.envs.robots.fake_so101_bus import RANGES, FakeBus
from tests.integration.main_run import TINY

pytestmark = pytest.mark.long

WORDS = [word for word in TINY if not word.startswith(("task=", "cameras=", "levels=", "num_demos="))]
DEGREES_OF_A_TICK = 360 / 4095


class FakeCamera(Camera):
    """A camera whose image is a gradient of its own size."""

    def __init__(self, config):
        super().__init__(config)
        self._open = False
        rows, columns = np.mgrid[0 : config.height, 0 : config.width]
        self.image = np.stack([rows % 256, columns % 256, (rows + columns) % 256], -1).astype(np.uint8)

    @property
    def is_connected(self):
        return self._open

    @staticmethod
    def find_cameras():
        return []

    def connect(self, warmup=True):
        self._open = True

    def read(self):
        return self.image

    def async_read(self, timeout_ms=200.0):
        return self.image

    def read_latest(self, max_age_ms=500):
        return self.image

    def disconnect(self):
        self._open = False


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """A tiny run of the pick task, what it was exported to, and the command that the export printed."""
    folder = tmp_path_factory.mktemp("so101")
    with contextlib.chdir(folder), contextlib.redirect_stdout(io.StringIO()) as printed:
        words = ["task=so101/pick_cube", "cameras=[all]", "num_demos=2", "levels=[0]", *WORDS]
        assert cli.main(["train", *words]) == 0
        (run,) = (folder / "runs/so101/pick_cube/act").iterdir()
        printed.seek(0)
        printed.truncate()
        assert cli.main(["export", f"checkpoint={run}", "out=exported"]) == 0
    command = next(line for line in printed.getvalue().splitlines() if line.startswith("lerobot-rollout "))
    checkpoint = run / "checkpoints/last/pretrained_model"
    return SimpleNamespace(folder=folder, run=run, checkpoint=checkpoint, command=shlex.split(command))


def test_its_dataset_is_lerobots_of_the_real_arm(exported):
    (dataset,) = (exported.folder / "datasets/so101/pick_cube").iterdir()
    info = DatasetInfo.open(dataset)
    names = [f"{name}.pos" for name in RANGES]
    assert (info.robot_type, info.fps) == ("so101_follower", 30)
    assert info.features["action"]["names"] == info.features["observation.state"]["names"] == names
    columns = info.read_columns(["observation.state", "action"])
    assert all(np.abs(columns[key][:, :5]).max() > 40 for key in columns), "degrees"
    assert all(columns[key][:, 5].min() >= 0 and columns[key][:, 5].max() <= 100 for key in columns)


def test_lerobots_rollout_acts_with_the_arm(exported, monkeypatch, tmp_path):
    """Names, order, units, ranges and the limit of a step are those of LeRobot's own code."""
    from lerobot.robots.so_follower import so_follower
    from lerobot.scripts.lerobot_rollout import main

    buses = []

    class Bus(FakeBus):
        def __init__(self, *arguments, **named):
            super().__init__(*arguments, **named)
            buses.append(self)

    monkeypatch.setattr(so_follower, "FeetechMotorsBus", Bus)
    monkeypatch.setattr("lerobot.cameras.opencv.OpenCVCamera", FakeCamera)
    words = [word for word in exported.command[1:] if not word.startswith("--duration")]
    words += ["--duration=2", "--device=cpu", f"--robot.calibration_dir={tmp_path}"]
    monkeypatch.setattr(sys, "argv", ["lerobot-rollout", *words])
    with contextlib.chdir(exported.folder):
        main()
    (bus,) = buses
    assert len(bus.sent) > 5 and not bus.is_connected
    path = [dict.fromkeys(RANGES, 2048), *bus.sent]
    ticks = np.array([[step[name] for name in RANGES] for step in path])
    low, high = np.array(list(RANGES.values())).T
    assert np.abs(np.diff(ticks[:, :5], axis=0)).max() <= 10.0 / DEGREES_OF_A_TICK + 2
    assert (ticks[:, 5] >= low[5]).all() and (ticks[:, 5] <= high[5]).all()
    first = _own_action(exported.checkpoint)
    present = np.zeros(6)
    present[5] = 100 * (2048 - low[5]) / (high[5] - low[5])
    goal = np.clip(first, present - 10.0, present + 10.0)
    sent = (ticks[1, :5] - 2048) * DEGREES_OF_A_TICK
    assert sent == pytest.approx(goal[:5], abs=2 * DEGREES_OF_A_TICK)


def _own_action(checkpoint: Path) -> np.ndarray:
    """Returns the first action (6,) of the policy in this project's code, in what the fake arm shows."""
    from torchvision.transforms.functional import resize

    import policies

    camera = FakeCamera(SimpleNamespace(fps=30, width=640, height=480))
    shape = read_json(checkpoint / CONFIG)["input_features"]["observation.images.front"]["shape"]
    image = torch.from_numpy(camera.image).permute(2, 0, 1) / 255
    small = resize(image[None], list(shape[1:])).clamp(0, 1)[0]
    small = (255 * small).round().to(torch.uint8).permute(1, 2, 0).numpy()
    low, high = RANGES["gripper"]
    state = np.array([0, 0, 0, 0, 0, 100 * (2048 - low) / (high - low)], np.float32)
    state[4] = (2048 - 4095 / 2) * DEGREES_OF_A_TICK
    policy = policies.load(checkpoint)
    seen = {"observation.state": state[None], "task": np.array(["pick up the red cube"])}
    seen |= {f"observation.images.{name}": small[None] for name in ("front", "wrist")}
    return np.asarray(policy.act(seen))[0, 0]


def test_the_folder_resizes_first_and_says_what_the_scene_must_match(exported):
    steps = read_json(exported.folder / "exported" / PREPROCESSOR)["steps"]
    names = [step["registry_name"] for step in steps]
    assert names.index("image_crop_resize_processor") == 1 + names.index("rename_observations_processor")
    facts = json.loads((exported.folder / "exported/robot.json").read_text())
    assert (facts["robot_type"], facts["fps"]) == ("so101_follower", 30)
    assert [joint["name"] for joint in facts["joints"]] == [f"{name}.pos" for name in RANGES]
    assert facts["joints"][0]["least"] == -110.0 and facts["joints"][5]["largest"] == 100.0
    assert {name: (each["width"], each["height"]) for name, each in facts["cameras"].items()} == {
        "front": (640, 480),
        "wrist": (640, 480),
    }


def test_a_folder_that_exists_is_left_alone(exported, capsys):
    with contextlib.chdir(exported.folder):
        assert cli.main(["export", f"checkpoint={exported.run}", "out=exported"]) == 2
    assert "The folder 'exported' exists" in capsys.readouterr().err
