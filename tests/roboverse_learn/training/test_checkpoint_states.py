"""Every state that saving a checkpoint leaves on the way: ``last`` never leads to half of one."""

import json
import os
import shutil
from dataclasses import replace

import pytest
import torch

import policies
from envs.core.errors import CheckpointError
from roboverse_learn.training.checkpoint import (
    PRETRAINED,
    STATE,
    TrainState,
    last_checkpoint,
    load_checkpoint,
    save_checkpoint,
)
from roboverse_learn.training.config import TrainConfig
from roboverse_learn.training.imitation.ema import Ema
from roboverse_learn.training.imitation.train import make_optimizer
from tests.policies.examples import FEATURES, NARROW_CONFIGS, stats

SMALL = replace(NARROW_CONFIGS["act"], dim_model=8, dim_feedforward=8, n_heads=1, use_vae=False)
SETTINGS = {"policy": "act", "seed": 0}


class Run:
    """A policy in training, without the training."""

    def __init__(self, seed=0, ema=True):
        self.policy = policies.create("act", FEATURES, stats(), SMALL, seed=seed)
        self.optimizer = make_optimizer(self.policy, TrainConfig())
        self.ema = Ema(self.policy.state_dict(), 0.75, 0.99) if ema else None

    def step(self):
        """Moves every weight, as a gradient would."""
        for parameter in self.policy.model.parameters():
            parameter.grad = torch.full_like(parameter, 0.1)
        self.optimizer.step()
        if self.ema is not None:
            self.ema.update(self.policy.state_dict())

    def save(self, folder, step):
        state = TrainState(
            step=step, elapsed_s=2.5 * step, sampler={"epoch": 1, "position": step}, settings=SETTINGS
        )
        return save_checkpoint(folder, self.policy, self.optimizer, self.ema, state)

    def load(self, directory, settings=SETTINGS):
        return load_checkpoint(directory, self.policy, self.optimizer, self.ema, settings)


@pytest.fixture(scope="module")
def states(tmp_path_factory):
    """Copies of a run's folder before and after every rename of its first and second checkpoint."""
    root, folder = tmp_path_factory.mktemp("run"), tmp_path_factory.mktemp("states")
    run, count = Run(), 0

    def copy(target):  # hard links will do: no file of a checkpoint is ever written to again
        shutil.copytree(root, target, symlinks=True, copy_function=os.link)

    def copying(real):
        def renamed(source, target):
            nonlocal count
            for action in (lambda: None, lambda: real(source, target)):
                action()
                copy(folder / f"{count:02d}")
                count += 1

        return renamed

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "rename", copying(os.rename))
        patch.setattr(os, "replace", copying(os.replace))
        for step in (5, 10):
            run.step()
            run.save(root, step)
    copy(folder / f"{count:02d}")
    return sorted(folder.iterdir())


def test_every_state_goes_on_from_a_whole_checkpoint(states):
    run, found = Run(seed=1), []
    for state in states:
        directory = last_checkpoint(state)
        found.append(None if directory is None else run.load(directory).step)
    # Renames: policy, checkpoint, link; a kill between checkpoint and link loses nothing but the name.
    assert found == sorted(found, key=lambda step: step or 0)
    assert found[0] is None and found[-1] == 10 and set(found) == {None, 5, 10}


def test_last_leads_to_a_whole_policy_in_every_state_that_has_it(states):
    seen = 0
    for state in states:
        last = state / "checkpoints" / "last"
        if last.is_symlink():
            assert policies.load(last / PRETRAINED).name == "act"
            seen += 1
    assert seen > len(states) // 2
    for state in states:
        for folder in (state / "checkpoints").glob("[0-9]*"):
            assert policies.load(folder).name == "act"


def test_only_the_newest_keeps_what_resuming_takes(states):
    end = states[-1] / "checkpoints"
    assert sorted(path.parent.name for path in end.glob(f"[0-9]*/{PRETRAINED}")) == ["000005", "000010"]
    assert [path.parent.name for path in end.glob(f"[0-9]*/{STATE}")] == ["000010"]
    assert sorted(path.name for path in end.iterdir()) == ["000005", "000010", "last"]
    # While the second is being written, the first can still be resumed.
    halfway = [s for s in states if (s / "checkpoints/000005" / STATE).is_dir()]
    assert len(halfway) >= 6


@pytest.mark.parametrize("ema", [True, False])
def test_everything_comes_back(tmp_path, ema):
    run, other = Run(ema=ema), Run(seed=7, ema=ema)
    for _ in range(3):
        run.step()
    pretrained = run.save(tmp_path, 3)
    state = other.load(pretrained.parent)
    assert (state.step, state.elapsed_s, state.sampler) == (3, 7.5, {"epoch": 1, "position": 3})
    assert all(v.equal(other.policy.state_dict()[k]) for k, v in run.policy.state_dict().items())
    saved = policies.load(pretrained).state_dict()
    expected = run.policy.state_dict() if run.ema is None else run.ema.average
    assert all(value.equal(saved[key]) for key, value in expected.items())
    if run.ema is not None:
        assert other.ema.num_updates == 3
        assert any(not v.equal(run.ema.average[k]) for k, v in run.policy.state_dict().items())
    for one in (run, other):  # the moments are the same too
        one.step()
    assert all(v.equal(other.policy.state_dict()[k]) for k, v in run.policy.state_dict().items())


def test_saving_a_step_again_replaces_it(tmp_path):
    run = Run()
    run.save(tmp_path, 5)
    run.step()
    pretrained = run.save(tmp_path, 5)
    saved = policies.load(pretrained).state_dict()
    assert all(value.equal(saved[key]) for key, value in run.ema.average.items())
    assert sorted(path.name for path in (tmp_path / "checkpoints").iterdir()) == ["000005", "last"]


def test_a_link_to_a_folder_that_was_deleted_is_not_followed(tmp_path):
    run = Run()
    run.save(tmp_path, 5)
    shutil.rmtree(tmp_path / "checkpoints/000005")
    assert last_checkpoint(tmp_path) is None
    assert last_checkpoint(tmp_path / "no_run") is None


def test_a_checkpoint_of_other_settings_says_which(tmp_path):
    directory = Run().save(tmp_path, 5).parent
    with pytest.raises(
        CheckpointError, match=r"Cannot resume from '.*000005': seed was 0 and is 3\. Go on with"
    ):
        Run().load(directory, SETTINGS | {"seed": 3})
    with pytest.raises(CheckpointError, match=r"ema was True and is False"):
        Run(ema=False).load(directory)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("weights.safetensors", "weights.safetensors' is absent, truncated or damaged"),
        ("optimizer.safetensors", "optimizer.safetensors' is absent, truncated or damaged"),
        ("state.json", "state.json' cannot be read"),
    ],
)
def test_absent_files_are_named(tmp_path, name, message):
    directory = Run().save(tmp_path, 5).parent
    (directory / STATE / name).unlink()
    with pytest.raises(CheckpointError, match=message):
        Run().load(directory)


def test_a_state_that_lacks_a_key_names_it(tmp_path):
    directory = Run().save(tmp_path, 5).parent
    path = directory / STATE / "state.json"
    content = json.loads(path.read_text())
    del content["sampler"]
    path.write_text(json.dumps(content))
    with pytest.raises(CheckpointError, match=r"state.json' lacks sampler\. Go on with"):
        Run().load(directory)
