"""Results of functions of one object, kept by which object it is.

``functools.cache`` hashes its arguments. A robot's configuration is a tree of frozen dataclasses, whose hash
takes longer than what is computed from it at every step.
"""

from collections.abc import Callable
from functools import wraps

MOST_KEPT = 256


def cached_by_identity[Given, Result](function: Callable[[Given], Result]) -> Callable[[Given], Result]:
    """Returns a function that computes once for each object; it must not change what it is given."""
    kept: dict[int, tuple[Given, Result]] = {}  # with the object, so that no other one gets its id

    @wraps(function)
    def cached(given: Given) -> Result:
        found = kept.get(id(given))
        if found is None:
            if len(kept) >= MOST_KEPT:
                kept.clear()
            found = kept[id(given)] = (given, function(given))
        return found[1]

    return cached
