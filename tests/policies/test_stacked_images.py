"""Images as channels, by hand."""

import numpy as np
import pytest

from envs.core.errors import PolicyError
from policies.stacked_images import stacked

FRONT, WRIST = "observation.images.front", "observation.images.wrist"


def images(num, frames, first, size=2):
    """Frame f and colour c show first + 10 f + c."""
    values = first + 10 * np.arange(frames)[:, None] + np.arange(3)
    return np.broadcast_to(values[None, :, None, None], (num, frames, size, size, 3)).astype(np.uint8)


def test_channels_are_frames_then_cameras_then_colours():
    seen = {WRIST: images(4, 2, 100), FRONT: images(4, 2, 0)}
    out = stacked(seen, {FRONT: 2, WRIST: 2}, 2, "tdmpc2")
    assert out.shape == (4, 12, 2, 2) and out.is_contiguous()
    assert out[3, :, 1, 0].tolist() == [0, 1, 2, 100, 101, 102, 10, 11, 12, 110, 111, 112]


def test_pixels_stay_where_they_are():
    image = np.arange(12, dtype=np.uint8).reshape(1, 2, 2, 3)
    out = stacked({FRONT: image}, {FRONT: 2}, 1, "tdmpc2")
    assert out[0, 1].tolist() == [[1, 4], [7, 10]]


def test_images_of_another_kind_are_errors():
    with pytest.raises(PolicyError, match=r"no 'observation.images.wrist'.*Given: observation.images.front"):
        stacked({FRONT: images(1, 3, 0)}, {WRIST: 2}, 3, "tdmpc2")
    with pytest.raises(
        PolicyError, match=r"has shape \(1, 2, 2, 2, 3\).*made for \(n, 3, 2, 2, 3\)\. Use the .*image_size"
    ):
        stacked({FRONT: images(1, 2, 0)}, {FRONT: 2}, 3, "tdmpc2")
    with pytest.raises(PolicyError, match=r"is float32, but policy 'tdmpc2' was made for uint8\."):
        stacked({FRONT: images(1, 3, 0).astype(np.float32)}, {FRONT: 2}, 3, "tdmpc2")
