"""OpenVLA: tokens of actions, and a tiny copy of the network, trained and evaluated."""

import numpy as np
import pytest
import torch

from envs.core.errors import PolicyError
from policies.openvla.tokens import ActionScale, ActionTokens, norm_stats, padded, prompt_tokens


class TestActionTokens:
    tokens = ActionTokens(32_000)

    def test_the_ends_and_the_middle_are_the_published_tokens(self):
        # np.digitize(a, np.linspace(-1, 1, 256)): -1 is in bin 1, 0 in bin 128, 1 in bin 256.
        actions = torch.tensor([-1.0, 0.0, 1.0, 7.0])
        assert self.tokens.encode(actions).tolist() == [31_999, 31_872, 31_744, 31_744]

    def test_agrees_with_numpy(self):
        actions = np.random.default_rng(0).uniform(-1, 1, 1000)
        bins = np.linspace(-1, 1, 256)
        expected = 32_000 - np.digitize(actions, bins)
        assert self.tokens.encode(torch.from_numpy(actions)).tolist() == expected.tolist()
        centers = (bins[:-1] + bins[1:]) / 2
        decoded = centers[np.clip(32_000 - expected - 1, 0, 254)]
        np.testing.assert_allclose(self.tokens.decode(torch.from_numpy(expected)), decoded, rtol=1e-6)

    def test_a_bin_is_half_a_hundredth_wide(self):
        actions = torch.linspace(-1, 1, 999)
        error = (self.tokens.decode(self.tokens.encode(actions)) - actions).abs().max()
        assert error <= 1 / 255 + 1e-6

    def test_a_word_is_the_nearest_bin(self):
        assert self.tokens.decode(torch.tensor([5])).item() == pytest.approx(1 - 1 / 255)


def test_the_scale_is_of_the_quantiles_and_leaves_what_is_masked():
    scale = ActionScale({"q01": [0.0, 0.0], "q99": [4.0, 1.0], "mask": [True, False]})
    actions = torch.tensor([[1.0, 0.3], [9.0, 1.0]])
    scaled = scale.scale(actions)
    torch.testing.assert_close(scaled, torch.tensor([[-0.5, 0.3], [1.0, 1.0]]))
    torch.testing.assert_close(scale.restore(scaled), torch.tensor([[1.0, 0.3], [4.0, 1.0]]))


def test_statistics_have_the_published_form():
    names = ("mean", "std", "min", "max", "q01", "q99")
    found = norm_stats({"action": {name: np.array([0.5, 1.5]) for name in names}}, 7)
    assert found == {
        "action": {name: [0.5, 1.5] for name in names} | {"mask": [True, True]}, "num_transitions": 7
    }  # fmt: skip
    with pytest.raises(PolicyError, match="no q01, q99 of its actions"):
        norm_stats({"action": {name: [0.0] for name in names[:4]}})


class FakeTokenizer:
    unk_token_id = 0

    def __init__(self, space):
        self.space, self.seen = space, []

    def convert_tokens_to_ids(self, token):
        assert token == "▁"
        return self.space

    def __call__(self, text, add_special_tokens):
        self.seen.append(text)
        ids = [1, len(text)]
        return type("Tokens", (), {"input_ids": ids})()


def test_a_prompt_is_lower_case_and_ends_in_the_empty_word():
    tokenizer = FakeTokenizer(29_871)
    assert prompt_tokens(tokenizer, ["Pick up the Cube"])[0][-1] == 29_871
    assert tokenizer.seen == ["In: What action should the robot take to pick up the cube?\nOut:"]
    assert len(prompt_tokens(FakeTokenizer(0), ["a"])[0]) == 2  # a tokenizer without it


def test_rows_are_filled_at_their_end():
    tokens, seen = padded([[1, 2, 3], [4]], 9)
    assert tokens.tolist() == [[1, 2, 3], [4, 9, 9]]
    assert seen.tolist() == [[1, 1, 1], [1, 0, 0]]
