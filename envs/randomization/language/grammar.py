"""The grammar of wordings: frames of sentences and synonyms, each with its held-out part.

A grammar is a frozen file beside this one, ``v1.json``, with a SHA-256 over its content that is checked on
every load. Other frames or words are another file, ``v2.json``.

A template of a sentence is what the grammar makes of it: its text, cut at the phrases that may be replaced.
A phrase that occurs twice is replaced by the same words in both places, so that a sentence never calls one
kind of object by two names.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

from envs.randomization.splits import read_content

VERSION = "v1"
FOLDER = Path(__file__).parent

HOLE = "{x}"
"""Where a frame takes the sentence."""


@dataclass(frozen=True, slots=True)
class Synonyms:
    """Phrases that mean the same.

    Attributes:
        kind: ``"verbs"``, ``"nouns"`` or ``"others"``.
        match: Phrases of an instruction that are replaced.
        known: What replaces them in wordings of both splits.
        new: What replaces them in held-out wordings alone.
    """

    kind: str
    match: tuple[str, ...]
    known: tuple[str, ...]
    new: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Slot:
    """A phrase of a sentence, and what may replace it.

    Attributes:
        phrase: The phrase.
        known: Replacements for both splits, the phrase itself first.
        new: Held-out replacements.
    """

    phrase: str
    known: tuple[str, ...]
    new: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Template:
    """A sentence with slots.

    Attributes:
        pieces: Fixed texts and, as indices into ``slots``, the phrases between them.
        slots: The phrases that may be replaced, each once.
    """

    pieces: tuple[str | int, ...]
    slots: tuple[Slot, ...]

    def options(self, *, new: bool) -> list[tuple[str, ...]]:
        """Returns what each slot may hold; the held-out words last, where they are wanted."""
        return [(*slot.known, *slot.new) if new else slot.known for slot in self.slots]

    def count(self, *, new: bool) -> int:
        """Returns the number of sentences that it makes."""
        return math.prod(len(option) for option in self.options(new=new))

    def sentence(self, index: int, *, new: bool) -> tuple[str, bool]:
        """Returns the sentence of an index below :meth:`count`, and whether it has a held-out word."""
        words, held_out = [], False
        for slot, option in zip(self.slots, self.options(new=new), strict=True):
            index, place = divmod(index, len(option))
            words.append(option[place])
            held_out |= place >= len(slot.known)
        return "".join(words[part] if isinstance(part, int) else part for part in self.pieces), held_out


@dataclass(frozen=True)
class Grammar:
    """Frames and synonyms of one version.

    Attributes:
        version: Name of the file.
        digest: SHA-256 of its content.
        num_train: Most wordings of a bank's train split.
        num_test: Most wordings of each of its two held-out parts.
        train_frames: Frames of both splits, with :data:`HOLE` where the sentence goes.
        test_frames: Held-out frames; they are made of words of the others.
        fixed: Phrases that stay as they are, because a word in them means something else.
        synonyms: All groups, in the order of the file.
    """

    version: str
    digest: str
    num_train: int
    num_test: int
    train_frames: tuple[str, ...]
    test_frames: tuple[str, ...]
    fixed: tuple[str, ...]
    synonyms: tuple[Synonyms, ...]

    @cached_property
    def _by_phrase(self) -> Mapping[str, Synonyms]:
        return {phrase: group for group in self.synonyms for phrase in group.match}

    @cached_property
    def _pattern(self) -> re.Pattern[str]:
        longest_first = sorted((*self._by_phrase, *self.fixed), key=lambda phrase: (-len(phrase), phrase))
        return re.compile(rf"(?<![\w'-])({'|'.join(map(re.escape, longest_first))})(?![\w-])")

    def template(self, sentence: str, others: Sequence[str] = ()) -> Template:
        """Returns the template of a sentence.

        A replacement that the sentence has already is left out, for it may name something else there; so is
        a held-out word of ``others``, further wordings of the same task, for it would be known.
        """
        pieces: list[str | int] = []
        slots: list[Slot] = []
        places: dict[str, int] = {}
        end = 0
        for match in self._pattern.finditer(sentence):
            phrase, group = match[1], self._by_phrase.get(match[1])
            if group is None:
                continue
            if phrase not in places:
                places[phrase] = len(slots)
                known = [each for each in group.known if not _occurs(each, [sentence])]
                new = [each for each in group.new if not _occurs(each, [sentence, *others])]
                slots.append(Slot(phrase, (phrase, *known), tuple(new)))
            pieces += [sentence[end : match.start()], places[phrase]]
            end = match.end()
        return Template((*pieces, sentence[end:]), tuple(slots))

    def meaning(self, sentence: str) -> dict[str, set[int]]:
        """Returns the groups of synonyms that a sentence has a phrase of, as indices by kind."""
        found: dict[str, set[int]] = {"verbs": set(), "nouns": set(), "others": set()}
        for match in self._pattern.finditer(sentence):
            group = self._by_phrase.get(match[1])
            if group is not None:
                found[group.kind].add(self.synonyms.index(group))
        return found


def _occurs(phrase: str, sentences: Sequence[str]) -> bool:
    pattern = re.compile(rf"(?<![\w'-]){re.escape(phrase)}(?![\w-])")
    return any(pattern.search(sentence) for sentence in sentences)


@cache
def load_grammar(version: str = VERSION) -> Grammar:
    """Loads a frozen grammar.

    Raises:
        ConfigError: The file is absent or damaged.
    """
    content = read_content(FOLDER / f"{version}.json")
    synonyms = [
        Synonyms(kind, *(tuple(group[part]) for part in ("match", "known", "new")))
        for kind, groups in content["words"].items()
        for group in groups
    ]
    return Grammar(
        version=content["version"],
        digest=content["sha256"],
        num_train=content["train"],
        num_test=content["test"],
        train_frames=tuple(content["frames"]["train"]),
        test_frames=tuple(content["frames"]["test"]),
        fixed=tuple(content["fixed"]),
        synonyms=tuple(synonyms),
    )
