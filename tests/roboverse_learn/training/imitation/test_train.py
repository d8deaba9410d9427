"""The training loop: it learns, it is repeatable, and it resumes after it was killed."""

import itertools
import json
import os
import shutil
import signal
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

import policies
from envs.core.errors import CheckpointError, WriteError
from roboverse_learn.training import checkpoint
from roboverse_learn.training.config import AugmentConfig, TrainConfig
from roboverse_learn.training.divergence import TrainingDivergedError
from roboverse_learn.training.imitation import train as imitation
from roboverse_learn.training.imitation.estimate import estimate_training_s
from roboverse_learn.training.imitation.train import train
from roboverse_learn.training.metrics import read_metrics
from roboverse_learn.training.reporter import Reporter
from tests.policies.examples import IMAGE, LEARNED, NARROW_CONFIGS, generators
from tests.roboverse_learn.training.frames import SquareFrames
from tests.roboverse_learn.training.signals import SignalAt
from tests.sweeps import sweep

pytestmark = pytest.mark.slow

DATA = SquareFrames()
CONFIG = TrainConfig(
    steps=10, batch_size=8, lr=1e-3, warmup_steps=2, precision="fp32", num_threads=1, save_every=5,
    log_every=1,
    augment=AugmentConfig(shift_px=2, brightness=0.2),
)  # fmt: skip


def make(name, **changes):
    return policies.create(name, DATA.features, DATA.stats, replace(NARROW_CONFIGS[name], **changes))


def losses(run_dir):
    return {row["step"]: row["loss"] for row in read_metrics(run_dir)}


class KilledAt(Reporter):
    """Stands for SIGKILL: nothing that training does afterwards may matter."""

    def __init__(self, step):
        self.step = step

    def on_step(self, progress):
        if progress.step == self.step:
            raise KeyboardInterrupt


class Heard(Reporter):
    def __init__(self):
        self.events = []

    def on_start(self, progress, policy):
        self.events.append(("start", progress.step))

    def on_step(self, progress):
        self.events.append(("step", progress))

    def on_checkpoint(self, step, directory):
        assert (directory / "model.safetensors").is_file()
        self.events.append(("checkpoint", step))

    def on_end(self, result):
        self.events.append(("end", result.steps))


@pytest.fixture(scope="module")
def _five_steps(tmp_path_factory):
    folder = tmp_path_factory.mktemp("five_steps")
    train(make("act"), DATA, replace(CONFIG, steps=5), folder)
    return folder


@pytest.fixture
def five_steps(_five_steps, tmp_path):
    """A run of five steps that a test may go on with or damage."""

    def copy(source, target):  # the large files, which nothing writes to in place, get a second name
        (os.link if source.endswith(".safetensors") else shutil.copy2)(source, target)

    return shutil.copytree(_five_steps, tmp_path / "run", symlinks=True, copy_function=copy)


@pytest.mark.parametrize(("name", "ema"), [("act", False), ("diffusion", True)])
def test_a_killed_run_goes_on_to_the_same_losses_and_weights(name, ema, tmp_path):
    config = replace(CONFIG, ema=ema, steps=6, save_every=3)
    settings = {"act": {"dropout": 0.1}, "diffusion": {}}[name]  # dropout draws from the global generator
    train(make(name, **settings), DATA, config, tmp_path / "straight")
    with pytest.raises(KeyboardInterrupt):
        train(make(name, **settings), DATA, config, tmp_path / "killed", reporter=KilledAt(5))
    assert checkpoint.last_checkpoint(tmp_path / "killed").name == "000003"
    heard = Heard()
    result = train(make(name, **settings), DATA, config, tmp_path / "killed", reporter=heard)
    assert heard.events[0] == ("start", 3)
    assert losses(tmp_path / "killed") == losses(tmp_path / "straight")
    assert list(losses(tmp_path / "killed")) == list(range(1, 7))
    straight = (tmp_path / "straight" / "checkpoints" / "last" / "pretrained_model").resolve()
    for name in ("model.safetensors", "config.json"):
        assert (result.checkpoint / name).read_bytes() == (straight / name).read_bytes()


@pytest.mark.parametrize("log_every", [1, 4])
def test_a_signal_ends_a_run_with_a_checkpoint_that_goes_on_to_the_same_weights(log_every, tmp_path):
    config = replace(CONFIG, ema=True, steps=6, save_every=3, log_every=log_every)
    train(make("act", dropout=0.1), DATA, config, tmp_path / "straight")
    reporter = SignalAt(5)
    with pytest.raises(KeyboardInterrupt, match="SIGTERM"):
        train(make("act", dropout=0.1), DATA, config, tmp_path / "interrupted", reporter=reporter)
    assert reporter.checkpoints == [3, 5]
    assert read_metrics(tmp_path / "interrupted")[-1]["step"] == 5
    heard = Heard()
    result = train(make("act", dropout=0.1), DATA, config, tmp_path / "interrupted", reporter=heard)
    assert heard.events[0] == ("start", 5)
    straight = tmp_path / "straight" / "checkpoints" / "last" / "pretrained_model" / "model.safetensors"
    assert (result.checkpoint / "model.safetensors").read_bytes() == straight.read_bytes()
    if log_every == 1:
        assert losses(tmp_path / "interrupted") == losses(tmp_path / "straight")


def test_a_signal_at_a_checkpoint_writes_no_other(tmp_path):
    reporter = SignalAt(3, signal.SIGINT)
    with pytest.raises(KeyboardInterrupt, match="SIGINT"):
        train(make("act"), DATA, replace(CONFIG, save_every=3), tmp_path, reporter=reporter)
    assert reporter.checkpoints == [3]


LEARNABLE = {
    "act": (120, {"kl_weight": 0.1}),
    "diffusion": (60, {"prediction_type": "sample"}),  # its loss has no floor of unforeseeable noise
    "mtact": (120, {}),
}


@pytest.mark.parametrize("name", sweep(LEARNED, {"act"}))
def test_overfits_one_batch_and_acts_as_it_learned(name, tmp_path):
    data = SquareFrames(num_episodes=1)
    steps, settings = LEARNABLE[name]
    config = replace(
        CONFIG, steps=steps, save_every=steps, augment=AugmentConfig(), schedule="constant", ema=False
    )
    result = train(make(name, **settings), data, config, tmp_path)
    curve = list(losses(tmp_path).values())
    assert np.mean(curve[-10:]) < 0.5 * np.mean(curve[:5])

    policy = policies.load(result.checkpoint)
    seen = data.sample(np.arange(5), policy.delta_indices, keys=[IMAGE, "observation.state"])
    seen[IMAGE] = seen[IMAGE].movedim(-3, -1)
    observation = {key: seen[key].numpy() for key in (IMAGE, "observation.state")} | {"task": [""] * 5}
    actions = policy.act(observation, generators(5))
    error = np.abs(actions[:, 0] - data.frames["action"][:5].numpy()).mean()
    assert error < 0.7 * data.frames["action"].std(0).mean().item()


def test_checkpoint_folder_holds_json_and_safetensors_only(tmp_path):
    train(make("diffusion"), DATA, replace(CONFIG, steps=6), tmp_path)
    files = [path for path in (tmp_path / "checkpoints").rglob("*") if path.is_file()]
    assert {path.suffix for path in files} == {".json", ".safetensors"}
    assert (tmp_path / "checkpoints" / "last").readlink().name == "000006"
    # Earlier checkpoints keep their policy, not what resuming takes.
    assert {path.parent.name for path in tmp_path.glob("checkpoints/0*/training_state")} == {"000006"}
    assert {path.parent.name for path in tmp_path.glob("checkpoints/0*/pretrained_model")} == {
        "000005",
        "000006",
    }
    assert not list(tmp_path.rglob("*.partial"))


def test_what_a_run_leaves_and_reports(tmp_path):
    heard = Heard()
    before = torch.get_rng_state()
    result = train(make("act"), DATA, replace(CONFIG, steps=6), tmp_path, reporter=heard)
    assert torch.get_rng_state().equal(before)
    assert [event for event, _ in heard.events].count("step") == 6
    assert [value for event, value in heard.events if event == "checkpoint"] == [5, 6]
    assert heard.events[-1] == ("end", 6)
    last = heard.events[-3][1]
    assert last.fraction == 1.0 and last.eta_s == 0.0 and last.loss == result.loss
    assert result.stopped_by == "steps" and result.samples_per_s > 0 and result.precision == "fp32"
    assert result.plot.read_bytes().startswith(b"\x89PNG")
    assert list((tmp_path / "tensorboard").glob("events*"))
    row = read_metrics(tmp_path)[-1]
    assert {
        "step",
        "loss",
        "l1_loss",
        "kld_loss",
        "lr",
        "grad_norm",
        "samples_per_s",
        "elapsed_s",
    } == row.keys()


@pytest.mark.parametrize(("dropped", "said"), [(None, "The last 3 frames"), (0, "")])
def test_frames_that_begin_no_sample_are_named(dropped, said, tmp_path, caplog):
    policy = make("diffusion", drop_n_last_frames=dropped)
    train(policy, DATA, replace(CONFIG, steps=1), tmp_path)
    assert [record.message.partition(" of every")[0] for record in caplog.records] == [said] * bool(said)
    assert ("30 % of all" in caplog.text) is bool(said)


def test_a_complete_run_is_not_trained_again(five_steps):
    config = replace(CONFIG, steps=5)
    again = train(make("act"), DATA, config, five_steps)
    first = five_steps / "checkpoints" / "last" / "pretrained_model"
    assert again.steps == 5 and again.samples_per_s is None and again.checkpoint == first


def test_the_returned_policy_is_the_saved_one(tmp_path):
    policy = make("diffusion")
    result = train(policy, DATA, replace(CONFIG, steps=3), tmp_path)
    saved = policies.load(result.checkpoint).state_dict()
    assert all(value.equal(saved[key]) for key, value in policy.state_dict().items())


def test_a_time_limit_stops_cleanly(monkeypatch, tmp_path):
    clock = itertools.count()  # a hundredth of a second at each look: a slow machine takes as many steps
    monkeypatch.setattr(imitation, "time", SimpleNamespace(perf_counter=lambda: 0.01 * next(clock)))
    config = replace(CONFIG, steps=100_000, time_limit_s=1.0)
    result = train(make("act"), DATA, config, tmp_path)
    assert result.stopped_by == "time_limit"
    assert 1.0 <= result.elapsed_s < 30.0
    assert read_metrics(tmp_path)[-1]["step"] == result.steps
    assert read_metrics(tmp_path)[-1]["lr"] < 0.5 * config.lr


def test_bf16_stays_close_to_fp32(tmp_path):
    config = replace(CONFIG, steps=4)
    train(make("act"), DATA, config, tmp_path / "fp32")
    result = train(make("act"), DATA, replace(config, precision="bf16"), tmp_path / "bf16")
    assert result.precision == "bf16"
    fp32, bf16 = (np.array(list(losses(tmp_path / name).values())) for name in ("fp32", "bf16"))
    assert not np.array_equal(fp32, bf16)
    np.testing.assert_allclose(bf16[:3], fp32[:3], rtol=0.1)


def test_a_loss_that_is_not_finite_stops_the_run_and_keeps_the_checkpoint(five_steps):
    bad = SquareFrames()
    bad.frames["action"][:] = float("nan")
    message = r"The loss is nan at step 6\. The last checkpoint in .* is sound\. Take a smaller train.lr"
    with pytest.raises(TrainingDivergedError, match=message):
        train(make("act"), bad, CONFIG, five_steps)
    assert policies.load(five_steps / "checkpoints" / "000005")


def test_a_checkpoint_between_two_logged_steps_is_not_written_after_the_loss_diverged(five_steps):
    bad = SquareFrames()
    bad.frames["action"][:] = float("nan")
    config = replace(CONFIG, steps=20, save_every=3, log_every=20)
    with pytest.raises(TrainingDivergedError, match=r"The loss is nan at step 6\. .* is sound"):
        train(make("act"), bad, config, five_steps)
    assert (five_steps / "checkpoints" / "last").resolve().name == "000005"


def test_weights_that_are_not_finite_are_not_saved(tmp_path, monkeypatch):
    policy = make("act")

    def overflow(parameters, _):
        parameters[0].grad.fill_(float("inf"))
        return torch.tensor(float("inf"))

    monkeypatch.setattr(imitation.nn.utils, "clip_grad_norm_", overflow)
    message = r"The weight '.*' is not finite at step 1\. No checkpoint"
    with pytest.raises(TrainingDivergedError, match=message):
        train(policy, DATA, replace(CONFIG, save_every=1), tmp_path)
    assert not (tmp_path / "checkpoints").exists()


def test_resuming_with_other_settings_is_an_error(five_steps):
    with pytest.raises(
        CheckpointError, match=r"batch_size was 8 and is 4; seed was 0 and is 1.*resume=false"
    ):
        train(make("act"), DATA, replace(CONFIG, batch_size=4), five_steps, seed=1)
    with pytest.raises(CheckpointError, match="ema was False and is True"):
        train(make("act"), DATA, replace(CONFIG, ema=True), five_steps)


def test_resume_false_begins_anew(five_steps):
    result = train(make("act"), DATA, replace(CONFIG, steps=3, save_every=3), five_steps, resume=False)
    assert result.steps == 3
    assert list(losses(five_steps)) == [1, 2, 3]


@pytest.mark.parametrize("name", ["state.safetensors", "state.json"])
def test_a_damaged_training_state_is_an_error(name, five_steps):
    path = five_steps / "checkpoints" / "last" / "training_state" / name
    content = path.read_bytes()[:20]
    path.unlink()
    path.write_bytes(content)
    with pytest.raises(CheckpointError, match="training_state' cannot be read"):
        train(make("act"), DATA, CONFIG, five_steps)


def test_a_full_disk_keeps_the_checkpoint_before(five_steps, monkeypatch):

    def full(*_args, **_kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(checkpoint, "save_file", full)
    with pytest.raises(WriteError, match=r"the disk is full. What was complete before is unchanged"):
        train(make("act"), DATA, CONFIG, five_steps)
    assert checkpoint.last_checkpoint(five_steps).name == "000005"
    assert not list(five_steps.rglob("*.partial"))


def test_a_run_killed_before_the_link_moved_goes_on_from_the_newest(five_steps):
    (five_steps / "checkpoints" / "last").unlink()
    assert checkpoint.last_checkpoint(five_steps).name == "000005"


def test_state_file_names_its_format(five_steps):
    path = five_steps / "checkpoints" / "last" / "training_state" / "state.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"format": 9}))
    with pytest.raises(CheckpointError, match="another format than 2"):
        train(make("act"), DATA, CONFIG, five_steps)


def test_estimate_is_of_the_right_size():
    seconds = estimate_training_s(make("act"), replace(CONFIG, steps=1000))
    assert 1.0 < seconds < 3000.0
    assert estimate_training_s(make("diffusion"), replace(CONFIG, steps=10**6, time_limit_s=60.0)) == 60.0
