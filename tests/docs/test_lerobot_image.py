"""The image of LeRobot's recorder is what its own command recorded."""

import numpy as np
import pytest
from PIL import Image

from docs.generate import lerobot_image


@pytest.mark.long
def test_the_image_shows_a_recorded_success(tmp_path, monkeypatch):
    out = tmp_path / "image.png"
    monkeypatch.setattr(lerobot_image, "OUT", out)
    lerobot_image.main()
    pixels = np.asarray(Image.open(out).convert("RGB"))
    kept = np.asarray(Image.open("docs/howto/lerobot_robot.png").convert("RGB"))
    assert pixels.shape == kept.shape
    assert np.abs(pixels.astype(int) - kept).mean() < 10.0, (
        "the same episode, whose images may differ by a step"
    )
