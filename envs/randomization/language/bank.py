"""The wordings of one instruction, divided into those of training and two kinds of held-out ones."""

import hashlib
import itertools
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

from envs.core.errors import ConfigError, unknown_name
from envs.randomization.language.grammar import HOLE, Grammar, Template, load_grammar
from envs.randomization.procedural.noise import Stream

KINDS = ("known", "new_frame", "new_words")
"""Wordings of the train split; held-out frames around known words; held-out words in known frames."""

_LISTED = 4096
"""Up to so many sentences are shuffled; of more, some are drawn."""


@dataclass(frozen=True, slots=True)
class WordingBank:
    """Wordings that mean the same. A task may make its own; by default they come from :func:`bank_of`.

    Attributes:
        known: Wordings of the train split.
        new_frame: Held out: another frame around words that the train split has.
        new_words: Held out: a frame of the train split around words that it has not.

    Raises:
        ConfigError: There is no known or no held-out wording, or one is given twice.
    """

    known: tuple[str, ...]
    new_frame: tuple[str, ...] = ()
    new_words: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        every = (*self.known, *self.test)
        if not self.known or not self.test:
            raise ConfigError(
                f"A bank of wordings needs a known and a held-out one; given {len(self.known)} known and "
                f"{len(self.test)} held out."
            )
        twice = sorted({wording for wording in every if every.count(wording) > 1})
        if twice:
            raise ConfigError(
                f"A bank of wordings has '{twice[0]}' twice. A wording is either known or held out: leave "
                "one out."
            )

    @property
    def test(self) -> tuple[str, ...]:
        """Wordings of the test split: both kinds of held-out ones."""
        return (*self.new_frame, *self.new_words)

    def of(self, split: str) -> tuple[str, ...]:
        """Returns the wordings of a split.

        Raises:
            UnknownNameError: There is no such split.
        """
        if split not in ("train", "test"):
            raise unknown_name("split", split, ("train", "test"))
        return self.known if split == "train" else self.test

    def of_kind(self, kind: str) -> tuple[str, ...]:
        """Returns the wordings of one of :data:`KINDS`.

        Raises:
            UnknownNameError: There is no such kind.
        """
        if kind not in KINDS:
            raise unknown_name("kind of wording", kind, KINDS)
        wordings: tuple[str, ...] = getattr(self, kind)
        return wordings

    def kind(self, wording: str) -> str:
        """Returns of which kind a wording is.

        Raises:
            UnknownNameError: It is none of the bank's.
        """
        for kind in KINDS:
            if wording in self.of_kind(kind):
                return kind
        raise unknown_name("wording", wording, self.known)

    @property
    def digest(self) -> str:
        """First 16 hexadecimal digits of the SHA-256 of all wordings, by kind and in order."""
        text = json.dumps([self.of_kind(kind) for kind in KINDS], separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()[:16]


@lru_cache(maxsize=512)
def bank_of(instructions: tuple[str, ...]) -> WordingBank:
    """Returns the bank of instructions that mean the same: the same for the same instructions, everywhere.

    The instructions themselves are known wordings. 90 % of a bank are known, and the two held-out kinds share
    the rest; an instruction without a word that has held-out synonyms has new frames alone.

    Raises:
        ConfigError: There is no instruction.
    """
    grammar = load_grammar()
    plain = [_inside_a_frame(text) for text in instructions]
    templates = [grammar.template(text, plain) for text in plain]
    known = dict.fromkeys(instructions)
    _fill(known, _drawn(grammar, templates, "known"), grammar.num_train)
    each = grammar.num_test if len(known) == grammar.num_train else max(1, round(len(known) / 18))
    new_words = dict.fromkeys(known)
    _fill(new_words, _drawn(grammar, templates, "new_words"), len(known) + each)
    taken = dict.fromkeys(new_words)
    _fill(taken, _drawn(grammar, templates, "new_frame"), len(known) + 2 * each)
    num_known, num_worded = len(known), len(new_words)
    return WordingBank(tuple(known), tuple(taken)[num_worded:], tuple(new_words)[num_known:])


def _inside_a_frame(instruction: str) -> str:
    """Returns an instruction as it stands within a sentence: a small first letter, no full stop."""
    text = instruction.strip().rstrip(".!")
    is_name = text[1:2].isupper() or text[:2] == "I "
    return text if is_name else text[:1].lower() + text[1:]


def _fill(found: dict[str, None], wordings: Iterator[str], size: int) -> None:
    """Adds wordings until there are ``size``."""
    while len(found) < size:
        wording = next(wordings, None)
        if wording is None:
            return
        found[wording] = None


def _drawn(grammar: Grammar, templates: Sequence[Template], kind: str) -> Iterator[str]:
    """Yields the wordings of a kind in a fixed random order, of each template in turn."""
    turns = [_of_template(grammar, template, kind) for template in templates]
    for together in itertools.zip_longest(*turns):
        yield from (wording for wording in together if wording is not None)


def _of_template(grammar: Grammar, template: Template, kind: str) -> Iterator[str]:
    """Yields one template's wordings of a kind, each once, in a fixed random order."""
    frames = grammar.test_frames if kind == "new_frame" else grammar.train_frames
    new = kind == "new_words"
    count = template.count(new=new)
    stream = Stream("wordings", grammar.version, kind, template.sentence(0, new=False)[0])
    for index in _order(stream, count * len(frames), limit=20 * grammar.num_train):
        sentence, held_out = template.sentence(index // len(frames), new=new)
        if held_out == new:
            yield frames[index % len(frames)].replace(HOLE, sentence)


def _order(stream: Stream, total: int, limit: int) -> Iterator[int]:
    """Yields numbers below ``total`` in random order: all of few, the first ``limit`` of many."""
    if total <= _LISTED:
        yield from stream.order(total).tolist()
        return
    seen = dict.fromkeys(stream.integer(0, total - 1) for _ in range(limit))
    yield from seen
