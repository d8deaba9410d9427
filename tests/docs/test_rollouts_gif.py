"""The GIF of rollouts."""

import numpy as np
import pytest
from PIL import Image

from docs.generate import rollouts_gif as page
from envs.core.errors import ConfigError


def test_first_success_of_each_task_is_chosen(tmp_path):
    for name in ("gpu-level3-b/level3-test-9-success", "gpu-level3-a/level3-test-9-failure"):
        path = tmp_path / "v2/PickCube/act" / f"{name}.mp4"
        path.parent.mkdir(parents=True)
        path.touch()
    settings = page.GifSettings(results_dir=tmp_path, policy="act", tasks=("PickCube",))
    assert [path.parent.name for path in page.videos(settings)] == ["gpu-level3-b"]
    with pytest.raises(ConfigError, match="no video of a success of act in StackCube at level 3"):
        page.videos(page.GifSettings(results_dir=tmp_path, policy="act", tasks=("StackCube",)))


def test_a_reduced_gif_has_half_the_frames_at_the_same_speed(tmp_path):
    frames = [Image.fromarray(np.full((8, 16, 3), 20 * k, np.uint8)) for k in range(8)]
    path = tmp_path / "a.gif"
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=100)
    page.reduce(path)
    with Image.open(path) as gif:
        assert gif.n_frames == 4 and gif.size == (16, 8) and gif.info["duration"] == 200
