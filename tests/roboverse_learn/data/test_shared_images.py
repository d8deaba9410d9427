import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
import pytest

from roboverse_learn.data.shared_images import shared, to_fill

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="only Linux shares images")


def test_images_of_several_cameras_reach_another_process_whole():
    images = {
        name: np.random.default_rng(n).integers(0, 256, (3, 4, 6, 3), np.uint8) for n, name in enumerate("ab")
    }
    with shared(images) as places, ProcessPoolExecutor(1, get_context("spawn")) as pool:
        for name, place in places.items():
            np.testing.assert_array_equal(pool.submit(place.open).result(), images[name])
        opened = places["a"].open()
    np.testing.assert_array_equal(opened, images["a"])  # who opened it keeps it
    with pytest.raises(ValueError, match="read-only"):
        opened[0] = 0
    with pytest.raises(FileNotFoundError):
        places["a"].open()


def test_images_are_filled_by_whoever_opens_them_to_write():
    with to_fill({"a": (3, 2, 2, 3)}) as places:
        places["a"].open(write=True)[1] = 7
        images = places["a"].open()
    assert images.shape == (3, 2, 2, 3)
    assert [image.max() for image in images] == [0, 7, 0]
