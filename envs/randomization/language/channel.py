"""The channel ``language``: a wording of the instruction for each episode, of its split's wordings."""

from dataclasses import dataclass
from typing import override

import numpy as np

from envs.randomization.channels import Channel, Scene
from envs.scenario import Appearance


@dataclass(frozen=True, slots=True)
class LanguageDraw:
    """One sample of the language channel.

    Attributes:
        wording: The instruction.
        kind: One of :data:`~envs.randomization.language.bank.KINDS`.
        bank: Digest of the bank that it is from.
    """

    wording: str
    kind: str
    bank: str


class LanguageChannel(Channel):
    """Rewords the instruction: known wordings in the train split, held-out ones in the test split."""

    @override
    def split(self, scene: Scene) -> tuple[str, ...]:
        return scene.wordings.of(scene.split.name)

    @override
    def sample(self, rng: np.random.Generator, allowed: tuple[str, ...], scene: Scene) -> LanguageDraw:
        bank = scene.wordings
        wording = allowed[int(rng.integers(len(allowed)))]
        return LanguageDraw(wording, bank.kind(wording), bank.digest)

    @override
    def apply(self, appearance: Appearance, draw: LanguageDraw, scene: Scene) -> Appearance:
        return appearance

    @override
    def instruct(self, instruction: str, draw: LanguageDraw, scene: Scene) -> str:
        return draw.wording
