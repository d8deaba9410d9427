"""Sweeps over many names: a few run with every change, and all of them with ``-m long``."""

from collections.abc import Collection, Iterable

import pytest


def sweep(names: Iterable[str], always: Collection[str]) -> list:
    """Returns parameters for ``parametrize``: names that are not in ``always`` are marked ``long``.

    Raises:
        AssertionError: If a name of ``always`` is not among ``names``.
    """
    names = list(names)
    assert set(always) <= set(names), sorted(set(always) - set(names))
    return [pytest.param(name, marks=() if name in always else pytest.mark.long) for name in names]
