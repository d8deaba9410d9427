"""Images and numbers as rows of bytes."""

import struct

import pytest
import torch

from policies.byte_rows import pack, row_size, unpack


def test_a_row_is_the_pixels_and_then_the_bytes_of_the_numbers() -> None:
    image = torch.tensor([[[1, 2], [3, 255]]], dtype=torch.uint8)  # (C, H, W) = (1, 2, 2)
    row = pack(image, torch.tensor([0.1, -2.5]))
    assert bytes(row.tolist()) == bytes([1, 2, 3, 255]) + struct.pack("=ff", 0.1, -2.5)
    assert len(row) == row_size(image.shape, 2) == 12


@pytest.mark.parametrize("leading", [(), (1,), (4,), (3, 2)])
@pytest.mark.parametrize(("shape", "numbers"), [((3, 5, 7), 3), ((6, 2, 2), 1), ((3, 3, 3), 2)])
def test_what_was_packed_comes_back_exactly(
    leading: tuple[int, ...], shape: tuple[int, ...], numbers: int
) -> None:
    images = torch.randint(0, 256, (*leading, *shape), dtype=torch.uint8)
    values = torch.randn(*leading, numbers)
    rows = pack(images, values)
    assert rows.shape == (*leading, row_size(shape, numbers)) and rows.dtype == torch.uint8
    for given in (rows, torch.stack([rows, rows], dim=-1)[..., 0]):  # the second is a view with gaps
        again, same = unpack(given, shape)
        assert again.equal(images) and same.equal(values)
