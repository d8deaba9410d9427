"""Wordings of instructions: a grammar of frames and synonyms, banks with frozen splits, and the channel."""

from envs.randomization.language.bank import KINDS, WordingBank, bank_of
from envs.randomization.language.grammar import Grammar, load_grammar

__all__ = ["KINDS", "Grammar", "WordingBank", "bank_of", "load_grammar"]
