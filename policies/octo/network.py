"""The network of Octo.

The instruction's tokens come first, then those of each observation: patches of the cameras, perhaps the
instruction again, and a readout.

Shapes: B = batch, T = observations in time, S = pixels a side, D = width, W = tokens of an instruction.
"""

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn

from envs.core.errors import MissingExtraError
from envs.core.extras import install_command
from policies.octo.diffusion import DiffusionHead
from policies.octo.sizes import PATCH_PX, OctoSizes
from policies.octo.stem import Stem
from policies.octo.transformer import Kind, Transformer, looks_at


class Octo(nn.Module):
    """Text encoder, image stems, transformer and diffusion head.

    Args:
        sizes: Sizes of the parts.

    Raises:
        MissingExtraError: transformers is not installed.
    """

    def __init__(self, sizes: OctoSizes) -> None:
        super().__init__()
        self.sizes = sizes
        self.text_encoder: Any = _text_encoder(sizes.text)
        self.text_projection = nn.Linear(int(sizes.text["d_model"]), sizes.width)
        self.text_positions = nn.Parameter(0.02 * torch.randn(1, sizes.text_tokens, sizes.width))
        self.stems, self.projections, self.positions = nn.ModuleDict(), nn.ModuleDict(), nn.ParameterDict()
        for name, size in sizes.cameras.items():
            shape = (1, sizes.max_horizon, (size // PATCH_PX) ** 2, sizes.width)
            self.stems[name] = Stem(sizes.stem, sizes.stem_out)
            self.projections[name] = nn.Linear(sizes.stem_out, sizes.width)
            self.positions[name] = nn.Parameter(0.02 * torch.randn(shape))
        self.readout_positions = nn.Parameter(
            0.02 * torch.randn(1, sizes.max_horizon, sizes.readouts, sizes.width)
        )
        self.transformer = Transformer(sizes.width, sizes.layers, sizes.heads, sizes.mlp)
        self.head = DiffusionHead(sizes)

    @torch.no_grad()
    def words(self, tokens: Tensor, attention: Tensor) -> Tensor:
        """Returns the text encoder's vectors (B, W, E) of tokens (B, W); it is never trained.

        Args:
            tokens: Tokens of instructions.
            attention: Which of them are no padding, (B, W).
        """
        return self.text_encoder(input_ids=tokens, attention_mask=attention).last_hidden_state

    def forward(self, images: Mapping[str, Tensor], words: Tensor, present: Tensor | None = None) -> Tensor:
        """Returns readouts (B, T, D).

        Args:
            images: Name of a camera to images (B, T, 3, S, S) from -1 to 1; one that is absent is left out.
            words: Vectors of the instructions (B, W, E).
            present: Which observations are no padding, (B, T); by default all.
        """
        count, steps = next(iter(images.values())).shape[:2]
        task = self.text_projection(words) + self.text_positions
        groups: list[tuple[Kind, Tensor]] = []
        for name, stem in self.stems.items():
            if name in images:
                patches = stem(images[name].flatten(0, 1)).unflatten(0, (count, steps))
                tokens = self.projections[name](patches) + self.positions[name][:, :steps]
                groups.append(("observation", tokens))
        num_seen = sum(tokens.shape[2] for _, tokens in groups)
        if self.sizes.repeats_text:
            groups.append(("observation", task.unsqueeze(1).expand(-1, steps, -1, -1)))
        groups.append(("readout", self.readout_positions[:, :steps].expand(count, -1, -1, -1)))
        together = torch.cat([tokens for _, tokens in groups], 2)
        counts: list[tuple[Kind, int]] = [(kind, tokens.shape[2]) for kind, tokens in groups]
        mask = looks_at(task.shape[1], counts, steps, right_groups=self.sizes.right_groups)
        mask = mask.to(together.device).expand(count, 1, -1, -1)
        if present is not None:  # of an observation that is padding, the patches are not looked at
            shown = present[:, :, None].expand(-1, -1, together.shape[2]).clone()
            shown[:, :, num_seen:] = True
            first = shown.new_ones(count, task.shape[1])
            mask = mask & torch.cat([first, shown.flatten(1)], 1)[:, None, None]
        out = self.transformer(torch.cat([task, together.flatten(1, 2)], 1), mask)
        out = out[:, task.shape[1] :].unflatten(1, (steps, -1))
        return out[:, :, -self.sizes.readouts :].mean(2)


def _text_encoder(config: Mapping[str, Any]) -> Any:
    try:
        from transformers import T5Config, T5EncoderModel
    except ImportError as error:
        raise MissingExtraError(f"Octo needs the package transformers: {install_command('vla')}.") from error
    return T5EncoderModel(T5Config(**config)).requires_grad_(False).eval()
