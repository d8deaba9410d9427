"""Results that are kept by the identity of what they were computed from."""

import gc

from envs.core import identity_cache
from envs.core.identity_cache import cached_by_identity


class Thing:
    """Equal to every other one, and its hash is an error."""

    __hash__ = None  # pyright: ignore[reportAssignmentType]

    def __eq__(self, other):
        return True


def test_a_function_is_called_once_for_each_object_and_nothing_is_hashed():
    called = []

    @cached_by_identity
    def number_of(thing):
        """Counts."""
        called.append(thing)
        return len(called)

    first, second = Thing(), Thing()
    assert [number_of(one) for one in (first, second, first, second)] == [1, 2, 1, 2]
    assert number_of.__doc__ == "Counts."


def test_an_object_that_is_gone_leaves_its_place_to_no_other():
    kept = cached_by_identity(lambda thing: object())
    results = set()
    for _ in range(100):
        results.add(kept(Thing()))
        gc.collect(0)
    assert len(results) == 100


def test_few_results_are_kept(monkeypatch):
    monkeypatch.setattr(identity_cache, "MOST_KEPT", 2)
    called = []
    kept = cached_by_identity(called.append)
    things = [Thing(), Thing(), Thing()]
    for thing in [*things, things[2], things[0]]:
        kept(thing)
    assert len(called) == 4
