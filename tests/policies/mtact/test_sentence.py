"""What the multi-task policy reads of a sentence."""

from dataclasses import replace

import numpy as np
import torch
from torch.nn import functional

from policies.mtact.sentence import WordsEncoder
from tests.policies.mtact.examples import CONFIG, TWO, frames, loss_of, make, seen


def test_a_sentence_is_the_same_among_more_empty_places():
    torch.manual_seed(0)
    short, long = WordsEncoder(50, 4, 8, 2, 2, 0.0), WordsEncoder(50, 9, 8, 2, 2, 0.0)
    known = short.state_dict()
    known["positions"] = torch.cat([known["positions"], torch.randn(5, 8)])
    long.load_state_dict(known)
    parts = torch.tensor([[[3, 7], [5, 0], [0, 0], [0, 0]], [[0, 0]] * 4])  # two words, and none
    more = functional.pad(parts, (0, 0, 0, 5))
    torch.testing.assert_close(long(more), short(parts))
    assert short(parts).isfinite().all()


def test_training_reads_no_more_words_than_its_longest_instruction_has():
    policy = make()
    language = policy.model.table.language
    # Four words; of <drawer> there are itself, six parts of three letters, and five of four.
    assert language.shape == (3, 4, 12)
    torch.testing.assert_close(
        policy.model.model.sentence(language),
        policy.model.model.sentence(policy._inputs_step.encode(TWO.texts)),
    )


def test_dropped_words_change_the_loss_and_no_action():
    dropping, plain = make(replace(CONFIG, word_dropout=0.9)), make()
    for policy in (dropping, plain):
        policy.begin_training()
    assert loss_of(dropping, frames()) != loss_of(plain, frames())
    text = "lift the red cube"
    np.testing.assert_array_equal(dropping.act(seen(dropping, text)), plain.act(seen(plain, text)))
