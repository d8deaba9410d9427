"""Settings of simulators: every simulator has some, and they are checked before it starts."""

import dataclasses

import pytest

from envs.core.errors import ConfigError, UnknownNameError
from envs.simulators import HANDLERS
from envs.simulators.settings import SETTINGS, check_settings


def test_every_simulator_has_settings_which_are_read_without_it():
    assert set(SETTINGS) == set(HANDLERS)
    for name in SETTINGS:
        assert dataclasses.is_dataclass(SETTINGS.get(name)), name


def test_settings_of_a_simulator_that_is_not_installed_are_checked_too():
    check_settings("genesis", {"iterations": 20})
    with pytest.raises(UnknownNameError, match=r"setting of simulator=genesis 'iteration'.*'iterations'"):
        check_settings("genesis", {"iteration": 20})
    with pytest.raises(ConfigError, match="max_pairs of genesis must be at least 1, given 0"):
        check_settings("genesis", {"max_pairs": 0})
