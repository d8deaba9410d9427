"""Types of LeRobot beside those of ``test_vla.py``: a step, a folder that moves, an episode."""

import shutil
from types import SimpleNamespace

import numpy as np
import pytest

import policies
from tests.policies.examples import generators
from tests.policies.zoo import test_vla as vla
from tests.policies.zoo import tiny_more
from tests.policies.zoo.needs import of_types

pytestmark = vla.LIBRARY_TEST


KEEPS_ITS_BACKBONE = ("evo1",)
"""Types whose checkpoint finds its backbone where it was: it carries none (docs/howto/fine_tune_a_vla.md)."""


@pytest.fixture(scope="module", params=of_types("vqbet", "evo1", "eo1"))
def trained(request, tmp_path_factory):
    """A policy after three steps, and its checkpoint, which moved."""
    name, folder = request.param, tmp_path_factory.mktemp(request.param)
    settings = getattr(tiny_more, name)(folder / "backbone")
    policy = vla.create(type=name, settings=settings)
    losses = vla.step(policy, count=3)
    policy.save(folder / "run" / "pretrained_model")
    if name not in KEEPS_ITS_BACKBONE and (folder / "backbone").exists():
        shutil.move(folder / "backbone", folder / "gone")
    shutil.move(folder / "run", folder / "moved")
    checkpoint = folder / "moved" / "pretrained_model"
    return SimpleNamespace(name=name, policy=policy, losses=losses, checkpoint=checkpoint)


def test_losses_are_finite_and_change(trained):
    assert np.isfinite(trained.losses).all() and len({*trained.losses}) > 1


def test_a_checkpoint_that_moved_acts_the_same(trained, tmp_path):
    seen = vla.observation(trained.policy)
    expected = trained.policy.act(seen, generators(2))
    assert expected.shape == (2, trained.policy.n_action_steps, 9) and np.isfinite(expected).all()
    loaded = policies.load(trained.checkpoint)
    np.testing.assert_array_equal(loaded.act(seen, generators(2)), expected)


def test_an_episode_is_evaluated_by_the_command(trained, tmp_path):
    result = vla.evaluate(f"policy.path={trained.checkpoint}", f"results_dir={tmp_path}")
    assert result.policy == trained.name and len(result.records) == 1
