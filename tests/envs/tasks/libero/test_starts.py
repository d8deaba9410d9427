"""Where LIBERO's episodes begin."""

import numpy as np
import pytest

from envs.core.errors import MissingAssetError, MissingExtraError
from envs.spec import EnvSpec
from envs.tasks.libero.starts import QPOS_NOISE_RAD, starts_of, widened

REGION = (0.0, 0.1, 0.02, 0.12)


@pytest.mark.parametrize(
    ("place", "over"),
    [
        ((0.01, 0.11), 0.0),  # inside
        ((0.0249, 0.11), 0.005),
        ((-0.0021, 0.11), 0.0),  # an object that rolled a little when it came down
        ((0.01, 0.0905), 0.01),
        ((0.01, 0.185), 0.0),  # knocked aside
    ],
)
def test_regions_are_larger_by_what_the_states_leave_them(place, over):
    x0, y0, x1, y1 = REGION
    region = widened(REGION, np.array([(0.01, 0.11), place]))
    assert region == pytest.approx((x0 - over, y0 - over, x1 + over, y1 + over))


@pytest.mark.slow
@pytest.mark.parametrize(
    "task",
    [
        "libero/spatial/pick_up_the_black_bowl_on_the_cookie_box_and_place_it_on_the_plate",
        "libero/object/pick_up_the_milk_and_place_it_in_the_basket",
        "libero/goal/push_the_plate_to_the_front_of_the_stove",
    ],
)
def test_drawn_starts_reach_as_far_as_the_states_of_the_benchmark(task):
    try:
        starts = starts_of(EnvSpec(task=task).make_task().entry)
    except (MissingAssetError, MissingExtraError) as error:
        pytest.skip(str(error))
    drawn = starts.drawn([np.random.default_rng(seed) for seed in range(400)])
    for root in starts._roots:
        own, ours = starts.fixed.objects[root.name].pos[:, :2], drawn.objects[root.name].pos[:, :2]
        assert (ours.amin(0) < own.amin(0) + 0.003).all() and (ours.amax(0) > own.amax(0) - 0.003).all()
        low, high = np.array(root.ranges).reshape(2, 2)
        assert (ours.numpy() >= low - 1e-9).all() and (ours.numpy() <= high + 1e-9).all()
    arm = next(iter(drawn.robots.values())).joint_pos[:, :7]
    assert arm.std(0).numpy() == pytest.approx(QPOS_NOISE_RAD, rel=0.2)
