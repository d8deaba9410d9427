"""A point on a line that is seen in images alone: its own state is its speed."""

import torch
from torch import Tensor

from policies.byte_rows import pack, row_size
from tests.roboverse_learn.training.point_mass import PointMass

PIXELS = 36
SPREAD = PIXELS / 5.0


class FilmedPointMass(PointMass):
    """A bright column of a dark image is where the point is; what it must reach is in the middle."""

    camera_names, image_size, num_state = ("front",), PIXELS, 1
    observation_size = row_size((3, PIXELS, PIXELS), num_state)

    def _observe(self) -> Tensor:
        columns = torch.arange(PIXELS) - PIXELS / 2.0 - SPREAD * self.position[:, None]
        bright = (255.0 * torch.exp(-columns.square() / 8.0)).to(torch.uint8)
        images = bright[:, None, None].expand(-1, 3, PIXELS, -1)
        return pack(images, self.speed[:, None])
