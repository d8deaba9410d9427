"""Sentences as numbers without a vocabulary: parts of words, hashed.

A word is itself and its character n-grams, as in fastText (arXiv:1607.04606), so that a new word has the
numbers of its known parts, and no text is an error.
"""

import re
import unicodedata
import zlib
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

MAX_PIECES = 16
"""Parts of a word that are read: itself, and its n-grams in the order in which they stand."""

_NGRAMS = (3, 4)
_WORD = re.compile(r"\w+|[^\w\s]")


def split_words(text: str) -> list[str]:
    """Returns the words and punctuation marks of a text, in lower case."""
    return _WORD.findall(unicodedata.normalize("NFKC", text).casefold())


def pieces(word: str) -> list[str]:
    """Returns a word with marks at both ends, and its n-grams, at most :data:`MAX_PIECES` in all."""
    marked = f"<{word}>"
    ngrams = [marked[i : i + n] for n in _NGRAMS for i in range(len(marked) - n + 1) if n < len(marked)]
    return [marked, *ngrams][:MAX_PIECES]


def hashed(texts: Sequence[str], max_words: int, num_buckets: int) -> np.ndarray:
    """Returns the parts of the words of texts as rows of a table; 0 is no part.

    Args:
        texts: n sentences.
        max_words: Words that are read; those after them are not.
        num_buckets: Rows of the table.

    Returns:
        int64 (n, max_words, :data:`MAX_PIECES`).
    """
    rows = [_hashed_one(text, max_words, num_buckets) for text in texts]
    return np.array(rows, dtype=np.int64).reshape(len(rows), max_words, MAX_PIECES)


def without_empty_places(parts: np.ndarray) -> np.ndarray:
    """Returns parts of words (n, words, parts) without the places at the end that no sentence fills."""
    _, words, pieces = parts.nonzero()
    return parts[:, : 1 + words.max(initial=0), : 1 + pieces.max(initial=0)]


@lru_cache(maxsize=4096)
def _hashed_one(text: str, max_words: int, num_buckets: int) -> tuple[tuple[int, ...], ...]:
    words = [
        [1 + zlib.crc32(piece.encode()) % (num_buckets - 1) for piece in pieces(word)]
        for word in split_words(text)[:max_words]
    ]
    words += [[]] * (max_words - len(words))
    return tuple(tuple(word + [0] * (MAX_PIECES - len(word))) for word in words)
