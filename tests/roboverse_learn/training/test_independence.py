"""Imitation and learning in an env: what both need is beside them, not in one of them."""

import pytest

from tests.test_architecture import module_graph


@pytest.mark.slow
@pytest.mark.parametrize(("own", "other"), [("imitation", "rl"), ("rl", "imitation")])
def test_neither_imports_the_other(own: str, other: str) -> None:
    package = "roboverse_learn.training"
    modules = {name: seen for name, seen in module_graph().items() if name.startswith(f"{package}.{own}")}
    assert modules
    assert not {
        (name, to) for name, seen in modules.items() for to in seen if to.startswith(f"{package}.{other}")
    }
