"""Small backbones: a policy is made, trained and evaluated on each, without the hub."""

import numpy as np
import pytest
import torch

import policies
from envs.core.errors import ConfigError, UnknownNameError
from policies.zoo.config import LeRobotConfig
from roboverse_learn.config.compose import compose
from roboverse_learn.training.imitation.estimate import plain_stats
from roboverse_learn.training.imitation.small_backbone import BackboneSettings, keys_of, main
from tests.policies.examples import FEATURES, generators
from tests.policies.training_steps import steps
from tests.policies.zoo import test_vla as vla
from tests.policies.zoo.needs import of_types

TASKS = ("PickCube", "StackCube")
WORDS = ("lift the red cube", "lift the red ball")  # the last word alone says what to do


@pytest.mark.parametrize(
    ("changes", "error", "said"),
    [
        ({"type": "pi0"}, UnknownNameError, r"'pi0'.*Valid: multi_task_dit, smolvla"),
        ({"image_px": 100}, ConfigError, r"image_px must be a multiple of 32, given 100"),
        ({"tasks": ()}, ConfigError, r"Name the tasks .* suite=<name> or tasks=\[<name>\]"),
        ({"type": "multi_task_dit"}, ConfigError, r"'clip' in its name, given out=\S*backbone\."),
    ],
)
def test_a_wrong_setting_is_one_sentence(changes, error, said, tmp_path):
    settings = {"tasks": TASKS, "out": tmp_path / "backbone"} | changes
    with pytest.raises(error, match=said):
        keys_of(BackboneSettings(**settings))
    assert not (tmp_path / "backbone").exists()


def test_a_folder_that_is_there_is_left_alone(tmp_path, capsys):
    assert main([f"out={tmp_path}", "suite=paper"]) == 2
    assert "exists. Name a new folder" in capsys.readouterr().err


@pytest.mark.parametrize("name", of_types("smolvla", "multi_task_dit"))
class TestBackbone:
    pytestmark = vla.LIBRARY_TEST

    def test_a_policy_on_it_reads_learns_and_moves(self, name, tmp_path):
        folder = tmp_path / "small_clip"
        keys = keys_of(BackboneSettings(type=name, out=folder, tasks=TASKS, image_px=32))
        config = compose("train", ["policy=lerobot", f"type={name}", *keys]).policy
        assert isinstance(config, LeRobotConfig)
        policy = policies.create("lerobot", FEATURES, plain_stats(FEATURES), config)
        assert 1e6 < policy.n_params < 3e7
        assert policy.drop_last_frames == 0
        losses = steps(policy, WORDS, count=5)
        assert np.isfinite(losses).all() and losses[-1] < losses[0]
        policy.save(tmp_path / "saved")
        folder.rename(tmp_path / "gone")
        loaded = policies.load(tmp_path / "saved")
        one, two = (loaded.act(vla.observation(loaded, 1, (text,)), generators(1)) for text in WORDS)
        assert np.isfinite(one).all() and not np.array_equal(one, two)


@pytest.mark.parametrize("name", of_types("multi_task_dit"))
class TestClipBackbone:
    pytestmark = vla.LIBRARY_TEST

    def test_sentences_that_differ_in_one_word_have_vectors_of_their_own(self, name, tmp_path):
        from transformers import AutoTokenizer, CLIPTextModel

        keys_of(BackboneSettings(type=name, out=tmp_path / "clip", tasks=TASKS, image_px=32))
        texts = [f"{verb} the {noun}" for verb in ("lift", "stack") for noun in ("cube", "red cube", "ball")]
        tokens = AutoTokenizer.from_pretrained(tmp_path / "clip")(
            texts, padding="max_length", max_length=77, return_tensors="pt"
        )
        vectors = CLIPTextModel.from_pretrained(tmp_path / "clip")(**tokens).pooler_output
        apart = torch.cdist(vectors, vectors) + torch.eye(len(texts))
        assert apart.min() > 0.1
