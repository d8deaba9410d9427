"""The scale of values, which the policy prior's entropy is weighed against."""

import torch
from torch import Tensor, nn

PERCENTILES = (5.0, 95.0)


class RunningScale(nn.Module):
    """Moving average of the range from the 5th to the 95th percentile, at least 1 (arXiv:2310.16828, 3.2).

    Args:
        tau: Share of the newest range.
    """

    value: Tensor

    def __init__(self, tau: float) -> None:
        super().__init__()
        self.tau = tau
        self.register_buffer("value", torch.ones(()))

    @torch.no_grad()
    def update(self, values: Tensor) -> None:
        """Updates the scale with values of any shape."""
        low, high = (percentile(values.flatten(), share) for share in PERCENTILES)
        self.value.lerp_((high - low).clamp(min=1.0), self.tau)

    def forward(self, values: Tensor) -> Tensor:
        """Returns values in units of the scale."""
        return values / self.value


def percentile(values: Tensor, percent: float) -> Tensor:
    """Returns a percentile of values (n,) by linear interpolation, without waiting for a GPU."""
    position = percent / 100.0 * (len(values) - 1)
    lower = int(position)
    upper = min(lower + 1, len(values) - 1)
    ordered = values.sort().values
    return torch.lerp(ordered[lower], ordered[upper], position - lower)
