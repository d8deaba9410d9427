"""Networks from the numbers of an instruction to its sentence vector.

Shape legend: B = samples, W = words, P = parts of a word, E = width of a frozen encoder, D = width.
"""

import torch
from torch import Tensor, nn

from policies.act.modeling_keypoint_act import Block


class WordsEncoder(nn.Module):
    """Hashed parts of words to a sentence vector, learned with the policy.

    Args:
        num_buckets: Rows of the table of parts.
        max_words: Words of a sentence.
        dim: Width of the vector.
        heads: Attention heads.
        layers: Transformer layers over the words.
        dropout: Share of the words that training hides.
    """

    def __init__(
        self, num_buckets: int, max_words: int, dim: int, heads: int, layers: int, dropout: float
    ) -> None:
        super().__init__()
        self.dropout = dropout
        self.table = nn.Embedding(num_buckets, dim)
        self.positions = nn.Parameter(0.1 * torch.randn(max_words, dim))
        self.blocks = nn.ModuleList(Block(dim, heads, 2 * dim) for _ in range(layers))
        self.norm = nn.LayerNorm(dim)

    def forward(self, parts: Tensor) -> Tensor:
        """Returns the vectors (B, D) of parts of words, int64 (B, W, P); 0 is no part.

        W and P may be smaller than what the encoder reads at most, where no sentence has more.
        """
        is_part = (parts > 0).unsqueeze(-1)
        # Not as an embedding: the kernel of its gradient sorts, which a recorded CUDA graph may not hold.
        vectors = self.table.weight.index_select(0, parts.flatten()).unflatten(0, parts.shape)
        words = (vectors * is_part).sum(2) / is_part.sum(2).clamp_min(1)
        is_word = is_part.any(2)  # (B, W, 1)
        if self.training and self.dropout:
            is_word = is_word & (torch.rand(is_word.shape, device=words.device) >= self.dropout)
        words = (words + self.positions[: parts.shape[1]]) * is_word
        is_key = is_word.squeeze(2)
        is_key = is_key | ~is_key.any(1, keepdim=True)  # attention to no place at all would be NaN
        for block in self.blocks:
            words = block(words, is_key)
        return self.norm((words * is_word).sum(1) / is_word.sum(1).clamp_min(1))


class VectorEncoder(nn.Module):
    """A frozen encoder's vector to a sentence vector.

    Args:
        size: Width E of the frozen encoder.
        dim: Width D of the sentence vector.
        noise: Mean length of the noise that training adds.
    """

    def __init__(self, size: int, dim: int, noise: float = 0.0) -> None:
        super().__init__()
        self.noise = noise
        self.layers = nn.Sequential(
            nn.Linear(size, dim), nn.ReLU(inplace=True), nn.Linear(dim, dim), nn.LayerNorm(dim)
        )

    def forward(self, vectors: Tensor) -> Tensor:
        """Returns the vectors (B, D) of vectors (B, E)."""
        if self.training and self.noise:
            vectors = vectors + self.noise / vectors.shape[1] ** 0.5 * torch.randn_like(vectors)
        return self.layers(vectors)
