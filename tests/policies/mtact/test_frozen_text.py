"""A frozen text encoder travels inside a checkpoint."""

import re
import shutil
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch

import policies
from envs.core.errors import MissingExtraError, PolicyError
from envs.core.extras import install_command
from policies.mtact.frozen_text import FrozenTextEncoder
from policies.mtact.modeling_multitask_act import SENTENCE
from policies.mtact.sentence import VectorEncoder
from roboverse_learn.config.compose import compose
from roboverse_learn.training.learners import learner_of
from tests.policies.mtact.test_mtact import CONFIG, frames, loss_of, make, seen, with_film
from tests.policies.test_lerobot import lerobot_chunk

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::DeprecationWarning:importlib")]

WORDS = [
    *("[PAD]", "[UNK]", "[CLS]", "[SEP]", "[MASK]"),
    *("lift", "the", "red", "green", "cube", "open", "drawer"),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A tiny BERT of random weights, as transformers saves one."""
    transformers = pytest.importorskip("transformers", reason="needs the extra language")
    path = tmp_path_factory.mktemp("bert")
    tokenizer = transformers.BertTokenizerFast(vocab={word: index for index, word in enumerate(WORDS)})
    tokenizer.save_pretrained(path)
    torch.manual_seed(0)
    config = transformers.BertConfig(
        vocab_size=len(WORDS), hidden_size=16, num_hidden_layers=1, num_attention_heads=2,
        intermediate_size=16, max_position_embeddings=16,
    )  # fmt: skip
    transformers.BertModel(config).save_pretrained(path)
    return path


def test_a_vector_is_the_mean_of_the_last_states_of_length_one(folder):
    import transformers

    encoder = FrozenTextEncoder.from_folder(folder)
    found = encoder.vectors(["lift the red cube", "open the drawer"])
    model = transformers.AutoModel.from_pretrained(folder).eval()
    tokenizer = transformers.AutoTokenizer.from_pretrained(folder)
    with torch.no_grad():
        states = model(**tokenizer("lift the red cube", return_tensors="pt")).last_hidden_state[0]
    mean = states.mean(0)
    torch.testing.assert_close(found[0], mean / mean.norm())
    assert found.shape == (2, encoder.size) == (2, 16)
    assert encoder.vectors(["open the drawer"])[0].equal(found[1])


@pytest.mark.parametrize("text", ["", "zyx 北京", "lift " * 100])
def test_any_text_has_a_finite_vector(folder, text):
    assert FrozenTextEncoder.from_folder(folder).vectors([text]).isfinite().all()


def test_a_moved_checkpoint_needs_the_folder_no_more(folder, tmp_path):
    own = tmp_path / "encoder"
    shutil.copytree(folder, own)
    policy = with_film(make(replace(CONFIG, text_encoder=str(own))))
    texts = ("lift the red cube", "open the green drawer")
    expected = [policy.act(seen(policy, text)) for text in texts]
    assert np.abs(expected[0] - expected[1]).max() > 1e-3
    policy.save(tmp_path / "here")
    shutil.move(tmp_path / "here", tmp_path / "there")
    shutil.rmtree(own)
    loaded = policies.load(tmp_path / "there")
    for text, actions in zip(texts, expected, strict=True):
        np.testing.assert_array_equal(loaded.act(seen(loaded, text)), actions)
    now = seen(loaded, texts[0], 1)
    now["task"] = np.array(now["task"])
    np.testing.assert_allclose(lerobot_chunk(tmp_path / "there", now), loaded.act(now), atol=1e-5)
    assert str(tmp_path) not in (tmp_path / "there" / "config.json").read_text()


def test_the_present_folder_can_be_the_encoders(folder, tmp_path, monkeypatch):
    monkeypatch.chdir(folder)
    make(replace(CONFIG, text_encoder=".")).save(tmp_path / "saved")
    assert policies.load(tmp_path / "saved").model.config.text_encoder == folder.name


def test_an_encoder_that_is_absent_is_refused_before_demonstrations_are_collected(folder, tmp_path):
    words = ["policy=mtact", "task=PickCube"]
    learner_of(compose("train", [*words, f"text_encoder={folder}"]), "cpu").check()
    with pytest.raises(PolicyError, match=r"is no folder of a model .*Give scratch.* A run that .* back"):
        learner_of(compose("train", [*words, f"text_encoder={tmp_path}"]), "cpu").check()


def test_the_encoder_is_frozen_and_no_part_of_the_trained_weights(folder):
    policy = make(replace(CONFIG, text_encoder=str(folder)))
    policy.begin_training()
    assert policy.model.table.language.shape == (3, 16)
    loss_of(policy, frames()).backward()
    names = {name for name, _ in policy.model.named_parameters()}
    assert any(name.startswith("model.sentence.layers") for name in names)
    assert not any("bert" in name or "embeddings" in name for name in names)


def test_noise_of_sentences_changes_the_loss_of_each_sample_and_no_action(folder):
    config = replace(CONFIG, text_encoder=str(folder))
    noisy, plain = (with_film(make(replace(config, sentence_noise=noise))) for noise in (1.0, 0.0))
    for policy in (noisy, plain):
        policy.begin_training()
    assert loss_of(noisy, frames()) != loss_of(plain, frames())
    index = torch.tensor([2, 2, 2, 2])  # fewer instructions than samples: without noise each is read once
    assert SENTENCE in plain._words_of(index)
    rows = noisy.model.model.sentence(noisy._words_of(index)["observation.language"])
    assert len({tuple(row.tolist()) for row in rows}) == 4
    text = "lift the red cube"
    np.testing.assert_array_equal(noisy.act(seen(noisy, text)), plain.act(seen(plain, text)))


def test_noise_of_sentences_has_the_length_that_is_set():
    encoder = VectorEncoder(400, 8, noise=0.5)
    encoder.layers = torch.nn.Sequential()
    added = encoder(torch.zeros(50, 400)).norm(dim=1)
    assert added.mean().item() == pytest.approx(0.5, rel=0.03)


def test_a_damaged_encoder_is_an_error(folder):
    state = FrozenTextEncoder.from_folder(folder).state_dict()
    del state["tokenizer"]
    with pytest.raises(PolicyError, match="text encoder of the checkpoint is damaged"):
        FrozenTextEncoder.from_state_dict(state)


def test_without_transformers_the_extra_is_named(folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "transformers", None)
    said = re.escape(install_command("language")) + r".*scratch needs nothing"
    with pytest.raises(MissingExtraError, match=said):
        make(replace(CONFIG, text_encoder=str(folder)))
