"""One network learns two tasks that only the instruction tells apart."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch

import policies
from policies.learned_tasks import UNRELATED, ZERO, Instructions
from policies.mtact.config import MtActConfig
from roboverse_learn.data.dataset.mixture import Mixture
from roboverse_learn.training.config import TrainConfig
from roboverse_learn.training.imitation.train import train
from roboverse_learn.training.metrics import read_metrics
from tests.roboverse_learn.data.two_tasks import NUM_ACTIONS, TEXTS, expected_action, square_of, write

pytestmark = pytest.mark.slow

NUM_EPISODES = 12
CONFIG = MtActConfig(
    chunk_size=4, n_action_steps=2, dim_model=32, n_heads=2, dim_feedforward=64, n_encoder_layers=1,
    n_decoder_layers=1, conv_channels=(8, 16), n_keypoints=8, tokens_per_camera=2, num_buckets=256,
)  # fmt: skip
TRAIN = TrainConfig(
    steps=150, batch_size=16, lr=3e-3, warmup_steps=10, precision="fp32", num_threads=1, save_every=150,
    log_every=10,
)  # fmt: skip


@pytest.fixture(scope="module", params=["regression", "flow"])
def head(request):
    return request.param


@pytest.fixture(scope="module")
def mixture(tmp_path_factory):
    root = tmp_path_factory.mktemp("tasks")
    return Mixture.open({task: write(root / task, task, NUM_EPISODES) for task in TEXTS}, "cpu")


def make(mixture, config=CONFIG):
    policy = policies.create("mtact", mixture.info.features, mixture.info.stats, config)
    policy.learn_instructions(mixture.instructions)
    return policy


@pytest.fixture(scope="module")
def result(mixture, head, tmp_path_factory):
    return train(make(mixture, replace(CONFIG, head=head)), mixture, TRAIN, tmp_path_factory.mktemp(head))


def acted(policy, task: str, text: str) -> tuple[np.ndarray, np.ndarray]:
    """Returns the first actions in the scenes of all episodes, and those that were demonstrated."""
    policy.task, indices = task, range(NUM_EPISODES)
    states = [np.random.default_rng(100 + index).normal(size=(5, 4))[0] for index in indices]
    observation = {
        "observation.images.front": np.stack([square_of(index)[0] for index in indices]),
        "observation.state": np.stack(states).astype(np.float32),
        "task": [text] * NUM_EPISODES,
    }
    generators = [torch.Generator().manual_seed(index) for index in indices]
    expected = np.stack([expected_action(task, index) for index in indices])
    return policy.act(observation, generators)[:, 0], expected


def error_of(policy, task: str, text: str) -> float:
    actions, expected = acted(policy, task, text)
    assert actions.shape == expected.shape == (NUM_EPISODES, NUM_ACTIONS[task])
    return float(np.abs(actions - expected).mean())


def test_the_instruction_alone_decides_what_is_done(result):
    """Without language, errors in the two tasks add up to the distance of their actions at the least."""
    policy = policies.load(result.checkpoint)
    shared = [np.stack([expected_action(task, index)[:2] for index in range(NUM_EPISODES)]) for task in TEXTS]
    least_without = np.abs(shared[0] - shared[1]).mean() / 2
    assert least_without > 0.6
    for task, texts in TEXTS.items():
        for text in texts:
            assert error_of(policy, task, text) < 0.25 * least_without


def test_the_loss_is_far_below_the_least_without_language(mixture, result, head):
    """Of an entry that both tasks have, |r - x| / 3 + |l - x| / 2 is at least |r - l| / 3 for any x."""
    if head == "flow":
        pytest.skip("the loss of a flow has no such limit in closed form")
    std = mixture.info.stats["action"]["std"][:2]
    actions = [[expected_action(task, index)[:2] for index in range(NUM_EPISODES)] for task in TEXTS]
    least = (np.abs(np.subtract(*actions)) / std / 3).sum(1).mean() / 2
    assert result.loss < 0.25 * least


def test_the_wrong_instruction_does_the_other_task(result):
    policy = policies.load(result.checkpoint)
    (right,), (left, *_) = TEXTS["Left"], TEXTS["Right"]
    wrong, expected = acted(policy, "Left", left)
    np.testing.assert_allclose(wrong[:, 0], -expected[:, 0], atol=0.4)
    assert error_of(policy, "Left", right) < 0.2


def test_a_moved_checkpoint_acts_the_same(result, tmp_path):
    policy = policies.load(result.checkpoint)
    shutil.copytree(result.checkpoint, tmp_path / "elsewhere")
    loaded = policies.load(tmp_path / "elsewhere")
    for task in TEXTS:
        np.testing.assert_array_equal(acted(loaded, task, "push")[0], acted(policy, task, "push")[0])


def test_each_task_has_its_curve(result, head):
    term = "l1_loss" if head == "regression" else "flow_loss"
    for row in read_metrics(result.checkpoint.parents[2])[-3:]:
        means = [row[f"{term}/{task}"] for task in TEXTS]
        assert row["loss"] == pytest.approx(np.mean(means), rel=1e-4)


def make_wrong(mixture, share: float):
    """Returns a policy that is asked to sweep for a share of the samples, and then gives actions of 0."""
    policy = make(mixture, replace(CONFIG, wrong_instructions=share))
    own, num = mixture.instructions, len(mixture.instructions.texts)
    tasks = tuple(replace(task, still=(ZERO,) * task.action_size) for task in own.tasks)
    texts = (*own.texts, "sweep the stairs", "please walk")
    wrong = ((num, num + 1),) * len(tasks)
    policy.learn_instructions(
        Instructions(texts=texts, tasks=tasks, task_of=(*own.task_of, UNRELATED, UNRELATED), wrong=wrong)
    )
    return policy


def test_wrong_instructions_are_not_followed_and_right_ones_are(mixture, tmp_path):
    result = train(make_wrong(mixture, 0.25), mixture, TRAIN, tmp_path)
    policy = policies.load(result.checkpoint)
    for task, (text, *_) in TEXTS.items():
        still, _ = acted(policy, task, "sweep the stairs")
        assert np.abs(still[:, 0]).mean() < 0.15, "the actions of 1 and -1 are not done"
        assert error_of(policy, task, text) < 0.25


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_a_resumed_run_has_the_same_losses(mixture, tmp_path, share):
    config = replace(TRAIN, save_every=3, log_every=1, schedule="constant")

    def run(folder, steps):
        policy = make_wrong(mixture, share) if share else make(mixture)
        train(policy, mixture, replace(config, steps=steps), folder)
        return [row["loss"] for row in read_metrics(folder)]

    straight = run(tmp_path / "straight", 6)
    run(tmp_path / "resumed", 3)
    assert run(tmp_path / "resumed", 6) == straight
