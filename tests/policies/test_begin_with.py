"""A policy that begins with the weights and the normalization of a checkpoint."""

from dataclasses import replace

import numpy as np
import pytest

import policies
from envs.core.errors import PolicyError
from policies.imitation import ImitationPolicy
from tests.policies.examples import FEATURES, LEARNED, NARROW_CONFIGS, generators, observation, stats

pytestmark = pytest.mark.slow


def make(name, *, seed=0, features=FEATURES, scale=1.0, **changes):
    """Makes a policy, with its own first weights and, by ``scale``, statistics."""
    known = stats()
    known["action"] = {key: scale * value for key, value in known["action"].items()}
    return policies.create(name, features, known, replace(NARROW_CONFIGS[name], **changes), seed=seed)


@pytest.mark.parametrize("name", LEARNED)
def test_it_acts_as_the_checkpoint_does_and_may_be_trained(name, tmp_path):
    learned, other = make(name, scale=2.0), make(name, seed=1)
    learned.save(tmp_path / "learned")
    seen = observation(learned, 2)
    before = other.act(seen, generators(2))
    other.begin_with(tmp_path / "learned")
    acted = other.act(seen, generators(2))
    np.testing.assert_array_equal(acted, learned.act(seen, generators(2)))
    assert not np.allclose(acted, before)
    other.begin_training()
    other.end_training()
    other.save(tmp_path / "again")
    np.testing.assert_allclose(
        policies.load(tmp_path / "again").act(seen, generators(2)), acted, rtol=1e-4, atol=1e-4
    )


def test_a_checkpoint_that_does_not_fit_is_refused(tmp_path):
    make("act").save(tmp_path)
    with pytest.raises(PolicyError, match=r"is of policy 'act', not of 'diffusion'"):
        make("diffusion").begin_with(tmp_path)
    with pytest.raises(PolicyError, match=r"(?s)model\.safetensors|shape"):
        make("act", dim_model=64).begin_with(tmp_path)
    six = {**FEATURES, "action": {**FEATURES["action"], "shape": (6,)}}
    known = stats() | {"action": {key: value[:6] for key, value in stats()["action"].items()}}
    other = policies.create("act", six, known, NARROW_CONFIGS["act"])
    with pytest.raises(PolicyError, match=r"action \(9,\), and the demonstrations have .*action \(6,\)"):
        other.begin_with(tmp_path)


def test_a_policy_without_a_way_to_begin_says_so(tmp_path):
    class Own(ImitationPolicy):
        name = "own"

    with pytest.raises(PolicyError, match=r"policy=own takes no train\.resume_from"):
        Own().begin_with(tmp_path)
