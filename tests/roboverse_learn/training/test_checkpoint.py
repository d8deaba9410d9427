"""Checkpoints: loading restores all that was saved or nothing, whenever the process is killed."""

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
    load_moments,
    moments,
    named,
    part,
    remove_leftovers,
    save_checkpoint,
)
from tests.policies.examples import FEATURES, NARROW_CONFIGS, stats

SMALL = replace(NARROW_CONFIGS["act"], dim_model=8, dim_feedforward=8, n_heads=1, use_vae=False)
SETTINGS = {"seed": 0, "task": "PickCube"}


class Weights:
    """Stands in for a policy."""

    def save(self, directory):
        directory.mkdir()
        (directory / "config.json").write_text("{}")


def state(step=7):
    return TrainState(
        step=step,
        elapsed_s=1.5,
        settings=SETTINGS,
        numbers={"updates": 3},
        tensors=named({"a": torch.arange(3.0)}, "algorithm") | {"b": torch.ones(2, dtype=torch.bool)},
    )


@pytest.fixture(scope="module")
def states(tmp_path_factory):
    """Copies of a run's folder before and after every rename of its first and second checkpoint."""
    root, folder = tmp_path_factory.mktemp("run"), tmp_path_factory.mktemp("states")
    policy, count = policies.create("act", FEATURES, stats(), SMALL), 0

    def copy():  # hard links will do: no file of a checkpoint is ever written to again
        nonlocal count
        shutil.copytree(root, folder / f"{count:02d}", symlinks=True, copy_function=os.link)
        count += 1

    def copying(real):
        def renamed(source, target):
            copy()
            real(source, target)
            copy()

        return renamed

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "rename", copying(os.rename))
        patch.setattr(os, "replace", copying(os.replace))
        for step in (5, 10):
            save_checkpoint(root, policy, state(step))
    copy()
    return sorted(folder.iterdir())


def test_every_interrupted_save_resumes_from_a_complete_checkpoint(states):
    found = []
    for folder in states:
        directory = last_checkpoint(folder)
        found.append(0 if directory is None else load_checkpoint(directory, SETTINGS).step)
    # Renames: policy, checkpoint, link; a kill between checkpoint and link loses nothing but the name.
    assert found == sorted(found)
    assert found[0] == 0 and found[-1] == 10 and set(found) == {0, 5, 10}


@pytest.mark.slow
def test_every_interrupted_save_leaves_complete_policies(states):
    assert sum((folder / "checkpoints" / "last").is_symlink() for folder in states) > len(states) // 2
    for folder in states:
        for checkpoint in (folder / "checkpoints").glob("[0-9l]*"):
            assert policies.load(checkpoint / PRETRAINED).name == "act"


def test_only_the_newest_checkpoint_keeps_its_training_state(states):
    end = states[-1] / "checkpoints"
    assert sorted(path.name for path in end.iterdir()) == ["000005", "000010", "last"]
    assert [path.parent.name for path in end.glob(f"[0-9]*/{STATE}")] == ["000010"]
    # While the second is being written, the first can still be resumed.
    assert len([folder for folder in states if (folder / "checkpoints/000005" / STATE).is_dir()]) >= 6


def test_save_and_load_round_trip(tmp_path):
    folder = save_checkpoint(tmp_path, Weights(), state())
    assert folder == tmp_path / "checkpoints/000007/pretrained_model"
    loaded = load_checkpoint(folder.parent, SETTINGS)
    assert (loaded.step, loaded.elapsed_s, loaded.numbers) == (7, 1.5, {"updates": 3})
    assert part(loaded.tensors, "algorithm")["a"].tolist() == [0.0, 1.0, 2.0]
    assert loaded.tensors["b"].dtype is torch.bool


def test_the_newest_step_counts_without_the_link(tmp_path):
    for step in (999_999, 1_000_000, 12_000_000):
        save_checkpoint(tmp_path, Weights(), state(step))
        (tmp_path / "checkpoints/last").unlink()
        assert last_checkpoint(tmp_path).name == str(step)


def test_a_checkpoint_that_has_no_link_yet_is_the_last(tmp_path):
    folder = tmp_path / "checkpoints"
    save_checkpoint(tmp_path, Weights(), state(10))
    shutil.copytree(folder / "000010", folder / "000020")  # killed before its link
    assert last_checkpoint(tmp_path).name == "000020"
    remove_leftovers(tmp_path)
    assert (folder / "last").resolve().name == "000020"


def test_a_folder_that_is_not_named_by_a_step_alone_is_no_checkpoint(tmp_path):
    save_checkpoint(tmp_path, Weights(), state(10))
    other = shutil.copytree(tmp_path / "checkpoints/000010", tmp_path / "checkpoints/000020.old")
    assert last_checkpoint(tmp_path).name == "000010"
    remove_leftovers(tmp_path)
    save_checkpoint(tmp_path, Weights(), state(30))
    assert (tmp_path / "checkpoints/last").resolve().name == "000030"
    assert (other / STATE).is_dir(), "what is no checkpoint is left alone"


@pytest.mark.parametrize("left", ["weights alone", "a twin that lacks a file"])
def test_a_folder_in_place_of_the_link_is_kept_where_no_checkpoint_has_all_of_it(tmp_path, left):
    for step in (10, 20):
        save_checkpoint(tmp_path / "run", Weights(), state(step))
    copy = shutil.copytree(tmp_path / "run", tmp_path / "copy")
    if left == "weights alone":
        shutil.rmtree(copy / "checkpoints/000020")
        shutil.rmtree(copy / "checkpoints/last" / STATE)
        (copy / "checkpoints/last" / PRETRAINED / "weights").write_text("of step 20")
    else:
        (copy / "checkpoints/000020" / STATE / "state.safetensors").unlink()
    remove_leftovers(copy)
    save_checkpoint(copy, Weights(), state(30))
    kept = copy / "checkpoints/last.copied"
    assert (kept / PRETRAINED / "weights").is_file() == (left == "weights alone")
    assert (kept / STATE / "state.safetensors").is_file() == (left != "weights alone")
    assert (copy / "checkpoints/last").resolve().name == "000030"


@pytest.mark.parametrize("copied", ["with its link followed", "with a file as its link", "last alone"])
def test_a_copy_without_links_is_resumed(tmp_path, copied):
    for step in (10, 20):
        save_checkpoint(tmp_path / "run", Weights(), state(step))
    copy, last = tmp_path / "copy", tmp_path / "copy/checkpoints/last"
    shutil.copytree(tmp_path / "run", copy)
    if copied == "last alone":
        shutil.rmtree(copy / "checkpoints/000020")
    elif copied == "with a file as its link":
        shutil.rmtree(last)
        last.write_text("000020")
    remove_leftovers(copy)
    assert load_checkpoint(last_checkpoint(copy), SETTINGS).step == 20
    assert last.readlink().name == "000020"
    save_checkpoint(copy, Weights(), state(30))
    folders = sorted(path.name for path in last.parent.iterdir())
    assert folders == ["000010", "000020", "000030", "last"] and last.readlink().name == "000030"


def test_saving_a_step_again_replaces_it(tmp_path):
    save_checkpoint(tmp_path, Weights(), state())
    save_checkpoint(tmp_path, Weights(), replace(state(), elapsed_s=3.0))
    assert load_checkpoint(last_checkpoint(tmp_path), SETTINGS).elapsed_s == 3.0
    assert sorted(path.name for path in (tmp_path / "checkpoints").iterdir()) == ["000007", "last"]


def test_link_to_a_deleted_checkpoint_is_not_followed(tmp_path):
    shutil.rmtree(save_checkpoint(tmp_path, Weights(), state()).parent)
    assert last_checkpoint(tmp_path) is None
    assert last_checkpoint(tmp_path / "no_run") is None


@pytest.mark.parametrize("text", [None, "{", "[]", '{"format": 9}', '{"format": 2}', '{"format": 1}'])
def test_damaged_training_state_is_an_error(tmp_path, text):
    directory = save_checkpoint(tmp_path, Weights(), state()).parent
    path = directory / STATE / ("state.json" if text else "state.safetensors")
    path.write_text(text) if text else path.unlink()
    with pytest.raises(CheckpointError, match=r"training_state' cannot be read .*begin a new run"):
        load_checkpoint(directory, SETTINGS)


def test_other_settings_are_named(tmp_path):
    directory = save_checkpoint(tmp_path, Weights(), state()).parent
    with pytest.raises(CheckpointError, match=r"Cannot resume from '.*7': seed was 0 and is 3; task was P"):
        load_checkpoint(directory, {"seed": 3, "task": "StackCube"})


def test_moments_come_back_exactly():
    def stepped(parameter, optimizer):
        parameter.grad = torch.full_like(parameter, 0.5)
        optimizer.step()

    last = torch.channels_last
    first, second = (torch.nn.Parameter(torch.ones(2, 3, 4, 4).to(memory_format=last)) for _ in range(2))
    one, other = (torch.optim.AdamW([parameter], lr=0.1, fused=True) for parameter in (first, second))
    stepped(first, one)
    second.data.copy_(first.data)
    load_moments(other, {key: value.contiguous() for key, value in moments(one, "o").items()}, "o")
    for parameter, optimizer in ((first, one), (second, other)):
        stepped(parameter, optimizer)
    assert first.equal(second)
