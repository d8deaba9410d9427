"""What the hash of an episode depends on, and what it does not."""

import dataclasses
from dataclasses import dataclass, field

import numpy as np
import pytest

from envs.episode_hash import episode_digest, named_values
from envs.scenario import Appearance, CameraCfg, GeomCfg, LightCfg, SurfaceMaterial
from envs.state import EntityState, State

CAMERA = CameraCfg(name="front", pos=(1.0, 0.0, 1.0), look_at=(0.0, 0.0, 0.0))
LOOK = Appearance(
    materials={"table": SurfaceMaterial(texture="oak")}, cameras={"front": CAMERA}, lights=(LightCfg(),)
)


def state(x=0.1):
    pos = np.array([[x, 0.0, 0.02]])
    return State({}, {"cube": EntityState.at_rest(pos, np.array([[1.0, 0.0, 0.0, 0.0]]))})


def test_equal_episodes_have_equal_hashes_and_16_digits():
    assert episode_digest(state(), LOOK) == episode_digest(state(), dataclasses.replace(LOOK))
    assert len(episode_digest(state(), LOOK)) == 16


CHAIR = {"wall0/0": (GeomCfg(shape="box", size=(0.1, 0.1, 0.1)),)}


@pytest.mark.parametrize(
    "changes",
    [
        {"table_yaw_rad": 0.1},
        {"lights": ()},
        {"materials": {"table": SurfaceMaterial(texture="pine")}},
        {"materials": {"wall": SurfaceMaterial(texture="oak")}},
        {"cameras": {"front": dataclasses.replace(CAMERA, pos=(1.0, 0.0, 1.1))}},
        {"furniture": CHAIR},
    ],
    ids=lambda changes: next(iter(changes)),
)
def test_every_part_of_the_looks_counts(changes):
    assert episode_digest(state(), dataclasses.replace(LOOK, **changes)) != episode_digest(state(), LOOK)


def test_the_state_counts_to_the_last_bit():
    assert episode_digest(state(np.nextafter(0.1, 1.0)), LOOK) != episode_digest(state(), LOOK)


def test_the_size_of_an_image_is_no_part_of_an_episode():
    larger = dataclasses.replace(CAMERA, width=64, height=32)
    look = dataclasses.replace(LOOK, cameras={"front": larger})
    assert episode_digest(state(), look) == episode_digest(state(), LOOK)


@dataclass(frozen=True)
class Before:
    power: float
    colours: tuple[float, ...] = ()


@dataclass(frozen=True)
class After:
    power: float
    flicker: float = 0.0
    colours: tuple[float, ...] = ()
    notes: dict[str, float] = field(default_factory=dict)


def test_a_field_that_is_added_with_a_default_changes_nothing():
    assert named_values(After(2.0)) == named_values(Before(2.0)) == {"power": 2.0}
    assert named_values(After(2.0, flicker=0.5)) == {"power": 2.0, "flicker": 0.5}
    assert named_values({"a": (After(np.float64(1.0)),)}) == {"a": [{"power": 1.0}]}
