"""A tiny Octo: fine-tuned to other actions, moved, evaluated by the command."""

import json
import shutil
from importlib.util import find_spec

import numpy as np
import pytest
import torch

import policies
from envs.core.errors import PolicyError
from policies.octo.config import OctoConfig
from policies.zoo.config import PeftConfig
from tests.policies.examples import FEATURES, IMAGE, SIZE, generators, stats
from tests.policies.octo import tiny
from tests.policies.training_steps import batch, steps

WORDS = ("pick up the red cube", "stack the cube")

pytestmark = [
    pytest.mark.long,
    *(
        pytest.mark.filterwarnings(f"ignore::{kind}")
        for kind in ("UserWarning", "FutureWarning", "DeprecationWarning", "RuntimeWarning")
    ),
    pytest.mark.skipif(
        find_spec("transformers") is None or find_spec("peft") is None,
        reason="Octo needs the extra vla: uv pip install -e '.[vla]'",
    ),
]


@pytest.fixture(scope="module")
def converted(tmp_path_factory):
    return tiny.folder(tmp_path_factory.mktemp("octo") / "converted")


def create(converted, **config):
    return policies.create("octo", FEATURES, stats(), OctoConfig(path=str(converted), **config))


def observation(policy, n=2, words=WORDS):
    rng = np.random.default_rng(1)
    time = (policy.n_obs_steps,) if policy.n_obs_steps > 1 else ()
    images = rng.integers(0, 256, (n, *time, SIZE, SIZE, 3), np.uint8)
    return {IMAGE: images, "task": np.array([[word] * time[0] if time else word for word in words[:n]])}


def changed(policy, before):
    return {key for key, value in policy.model.state_dict().items() if not torch.equal(value, before[key])}


def snapshot(policy):
    return {key: value.clone() for key, value in policy.model.state_dict().items()}


@pytest.mark.parametrize("window", [1, 2])
def test_it_learns_a_batch_and_a_folder_that_moves_acts_alike(converted, tmp_path, window):
    policy = create(converted, window=window)
    before = snapshot(policy)
    losses = steps(policy, WORDS, lr=3e-3, count=60)
    assert losses[-1] < losses[0] / 2
    changes = changed(policy, before)
    assert not any(key.startswith("text_encoder.") for key in changes)
    assert {key.split(".")[0] for key in changes} >= {"stems", "transformer", "head", "readout_positions"}
    seen = observation(policy)
    expected = policy.act(seen, generators(2))
    assert expected.shape == (2, 4, 9)
    policy.save(tmp_path / "saved")
    shutil.move(tmp_path / "saved", tmp_path / "moved")
    loaded = policies.load(tmp_path / "moved")
    np.testing.assert_array_equal(loaded.act(seen, generators(2)), expected)
    assert (loaded.window, loaded.cameras) == (window, {"primary": IMAGE})


def test_the_head_alone_is_trained(converted):
    policy = create(converted, trained="head")
    before = snapshot(policy)
    steps(policy, WORDS, count=2)
    assert {key.split(".")[0] for key in changed(policy, before)} == {"head"}


def test_adapters_and_the_head_are_trained_and_saved_alone(converted, tmp_path):
    policy = create(converted, peft=PeftConfig(method_type="LORA", r=2))
    before = snapshot(policy)
    losses = steps(policy, WORDS, lr=1e-2, count=20)
    assert losses[-1] < losses[0]
    changes = changed(policy, before)
    assert any("lora_" in key and ".transformer.blocks." in key for key in changes)
    assert all("lora_" in key or ".head.modules_to_save." in key for key in changes)
    assert not any("text_encoder" in key for key in changes)
    seen = observation(policy)
    expected = policy.act(seen, generators(2))
    policy.save(tmp_path / "saved")
    shutil.move(tmp_path / "saved", tmp_path / "moved")
    assert not (tmp_path / "moved" / "model.safetensors").exists()
    loaded = policies.load(tmp_path / "moved")
    np.testing.assert_array_equal(loaded.act(seen, generators(2)), expected)
    loaded.save(tmp_path / "again")
    np.testing.assert_array_equal(policies.load(tmp_path / "again").act(seen, generators(2)), expected)


def test_the_checkpoints_own_head_stays_where_its_actions_fit(converted):
    features = {**FEATURES, "action": {**FEATURES["action"], "shape": (3,), "names": None}}
    numbers = {"action": {key: np.zeros(3) + (key == "std") for key in ("mean", "std", "min", "max")}}
    same = policies.create("octo", features, stats() | numbers, OctoConfig(path=str(converted), chunk_size=2))
    weights = tiny.network().head.state_dict()
    assert all(torch.equal(value, weights[key]) for key, value in same.model.head.state_dict().items())


def test_padding_is_in_no_loss(converted):
    policy = create(converted, window=2)
    policy.instructions = WORDS
    raw = batch(policy)
    raw[f"{IMAGE}_is_pad"][:, 0] = True
    losses = []
    for number in (0.0, 2.0):  # of the first observation's first action alone, which is padding
        raw["action"][:, 0] = number
        torch.manual_seed(3)
        losses.append(policy.loss(policy.preprocess(raw))[0].item())
    assert losses[0] == losses[1] > 0.0
    raw["action_is_pad"][:] = True
    assert policy.loss(policy.preprocess(raw))[0].item() == 0.0


@torch.no_grad()
def test_it_reads_the_instruction_and_sees_the_image(converted):
    policy = create(converted)
    seen = observation(policy)
    same = {**seen, IMAGE: np.repeat(seen[IMAGE][:1], 2, 0)}
    first, second = policy._readout(policy.preprocess(policy._to_tensors(same)))
    assert not torch.allclose(first, second, atol=1e-4), "two instructions"
    alike = {**seen, "task": np.array([WORDS[0]] * 2)}
    first, second = policy._readout(policy.preprocess(policy._to_tensors(alike)))
    assert not torch.allclose(first, second, atol=1e-4), "two images"


def test_samples_do_not_depend_on_their_batch(converted):
    policy = create(converted)
    seen = observation(policy)
    both = policy.act(seen, generators(2))
    alone = policy.act({key: value[1:] for key, value in seen.items()}, generators(2)[1:])
    np.testing.assert_array_equal(both[1:], alone)


def test_the_command_evaluates_it(converted, tmp_path, monkeypatch):
    from tests.policies.zoo.test_vla import evaluate

    policy = create(converted)
    policy.save(tmp_path / "saved")
    result = evaluate(f"checkpoint={tmp_path / 'saved'}", f"results_dir={tmp_path}")
    assert result.policy == "octo" and len(result.records) == 1


@pytest.mark.parametrize(
    ("config", "said"),
    [
        ({"path": ""}, "policy=octo fine-tunes a published checkpoint"),
        ({"window": 4}, "policy.window=4 is more than the 3 observations"),
        ({"trained": "head", "peft": PeftConfig(method_type="LORA")}, "trained=head trains no adapters"),
        ({"primary": "side"}, "policy.primary=side is no camera of the dataset, which has"),
    ],
)
def test_what_does_not_fit_is_one_sentence(converted, config, said):
    with pytest.raises(PolicyError, match=said):
        policies.create("octo", FEATURES, stats(), OctoConfig(**{"path": str(converted), **config}))


def test_a_converted_folder_is_not_evaluated(converted):
    with pytest.raises(PolicyError, match="is an Octo as it was published, whose actions"):
        policies.load(converted)


def test_weights_that_are_absent_are_an_error(converted, tmp_path):
    shutil.copytree(converted, tmp_path / "copy")
    content = json.loads((tmp_path / "copy/config.json").read_text())
    content["model"]["transformer_kwargs"]["num_layers"] = 3
    (tmp_path / "copy/config.json").write_text(json.dumps(content))
    with pytest.raises(PolicyError, match="absent or of another shape, the first 'transformer"):
        create(tmp_path / "copy")
