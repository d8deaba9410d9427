"""Sentences as hashed parts of words."""

import numpy as np
import pytest

from policies.mtact.hashed_ngrams import MAX_PIECES, hashed, pieces, split_words


def test_words_and_marks_are_split_in_lower_case():
    assert split_words("Pick up the RED cube, then stop.") == [
        *("pick", "up", "the", "red", "cube", ",", "then", "stop", ".")
    ]


def test_a_word_is_itself_and_its_ngrams():
    assert pieces("cube") == ["<cube>", "<cu", "cub", "ube", "be>", "<cub", "cube", "ube>"]
    assert pieces("a") == ["<a>"]


def test_numbers_are_the_same_in_every_process():
    rows = hashed(["a"], max_words=2, num_buckets=64)
    assert rows.shape == (1, 2, MAX_PIECES) and rows.dtype == np.int64
    assert rows[0, 0, 0] == 14  # 1 + CRC-32 of "<a>", 1874297515, modulo 63
    assert not rows[0, 0, 1:].any() and not rows[0, 1].any()


@pytest.mark.parametrize(
    "text", ["", "   ", "ünïcødé 北京 🤖", "x" * 500, " ".join(["word"] * 100), "\n\t?!"]
)
def test_no_text_is_an_error(text):
    rows = hashed([text, "pick"], max_words=8, num_buckets=64)
    assert rows.shape == (2, 8, MAX_PIECES)
    assert rows.min() >= 0 and rows.max() < 64


def test_a_new_word_shares_parts_with_a_known_one():
    first, other, new = (set(hashed([word], 1, 1 << 20)[0, 0]) - {0} for word in ("cube", "mug", "cubes"))
    assert len(first & new) >= 4
    assert not first & other


def test_order_of_words_is_kept():
    one, two = hashed(["red on green", "green on red"], 8, 1024)
    assert not np.array_equal(one, two)
    np.testing.assert_array_equal(one[[2, 1, 0]], two[:3])
