"""Actions as tokens, and the prompt around them, as OpenVLA's authors have them.

The numbers of an action are scaled to [-1, 1] and put into bins; each bin is one of the last tokens of
Llama's
vocabulary (github.com/openvla/openvla, prismatic/vla/action_tokenizer.py).
"""

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from envs.core.errors import PolicyError

PROMPT = "In: What action should the robot take to {instruction}?\nOut:"

_SPACE = "▁"
"""The token after the prompt's colon that training has there (29871 of Llama's)."""


class ActionTokens:
    """Actions to tokens and back.

    Args:
        vocabulary: Tokens of the language model without padding; the last ones are the bins.
        bins: Edges of bins; 256 as published.
    """

    def __init__(self, vocabulary: int, bins: int = 256) -> None:
        self.vocabulary = vocabulary
        self.edges = torch.linspace(-1.0, 1.0, bins, dtype=torch.float64)
        self.centers = (self.edges[:-1] + self.edges[1:]) / 2.0

    def encode(self, actions: Tensor) -> Tensor:
        """Returns the tokens of actions that are scaled to [-1, 1], of the same shape."""
        bins = torch.bucketize(actions.double().clamp(-1, 1), self.edges.to(actions.device), right=True)
        return self.vocabulary - bins

    def decode(self, tokens: Tensor) -> Tensor:
        """Returns the scaled actions of tokens, float32; another token counts as the nearest bin."""
        bins = (self.vocabulary - tokens - 1).clamp(0, len(self.centers) - 1)
        return self.centers.to(tokens.device)[bins].float()


class ActionScale:
    """Actions of a dataset to [-1, 1] and back, by its 1 % and 99 % quantiles.

    Args:
        stats: ``norm_stats[<dataset>]["action"]``: ``q01``, ``q99`` and, if some numbers are
            left as they are, ``mask``.
    """

    def __init__(self, stats: Mapping[str, Any]) -> None:
        self.low, self.high = (torch.tensor(stats[key], dtype=torch.float32) for key in ("q01", "q99"))
        self.mask = torch.tensor(stats.get("mask", [True] * len(self.low)), dtype=torch.bool)

    def scale(self, actions: Tensor) -> Tensor:
        """Returns actions (..., A) scaled to [-1, 1]; beyond the quantiles they are clipped."""
        low, high, mask = (part.to(actions.device) for part in (self.low, self.high, self.mask))
        scaled = (2.0 * (actions - low) / (high - low + 1e-8) - 1.0).clamp(-1.0, 1.0)
        return torch.where(mask, scaled, actions)

    def restore(self, scaled: Tensor) -> Tensor:
        """Returns the actions of scaled ones."""
        low, high, mask = (part.to(scaled.device) for part in (self.low, self.high, self.mask))
        return torch.where(mask, 0.5 * (scaled + 1.0) * (high - low) + low, scaled)


def norm_stats(stats: Mapping[str, Mapping[str, Any]], num_frames: int = 0) -> dict[str, Any]:
    """Returns the statistics of a dataset in OpenVLA's form.

    Args:
        stats: Statistics of a LeRobotDataset.
        num_frames: Its frames.

    Raises:
        PolicyError: if the dataset has no quantiles of its actions.
    """
    names = ("mean", "std", "min", "max", "q01", "q99")
    of_action = stats.get("action", {})
    if missing := [name for name in names if name not in of_action]:
        raise PolicyError(
            f"The dataset has no {', '.join(missing)} of its actions, which OpenVLA scales them by: "
            "collect it again."
        )
    action = {name: [float(each) for each in torch.as_tensor(of_action[name]).reshape(-1)] for name in names}
    return {"action": action | {"mask": [True] * len(action["q01"])}, "num_transitions": num_frames}


def prompt_tokens(tokenizer: Any, instructions: Sequence[str]) -> list[list[int]]:
    """Returns the tokens of each instruction's prompt, up to where the action begins."""
    space = tokenizer.convert_tokens_to_ids(_SPACE)
    tail = [] if space is None or space == tokenizer.unk_token_id else [space]
    prompts = [PROMPT.format(instruction=each.lower().strip()) for each in instructions]
    found = [list(tokenizer(each, add_special_tokens=True).input_ids) for each in prompts]
    return [tokens if tail and tokens[-1:] == tail else tokens + tail for tokens in found]


def padded(rows: Sequence[Sequence[int]], filler: int) -> tuple[Tensor, Tensor]:
    """Returns rows as one tensor (B, L), filled up at the end, and what is no filling, int64."""
    longest = max(map(len, rows))
    tokens = torch.tensor([[*row, *[filler] * (longest - len(row))] for row in rows])
    seen = torch.tensor([[1] * len(row) + [0] * (longest - len(row)) for row in rows])
    return tokens, seen
