"""The marks of the modules here that compile or record."""

import pytest

COMPILES = [
    pytest.mark.gpu,
    # Of the compiler, and of the recording of graphs at their first use.
    pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::UserWarning", "ignore::FutureWarning"),
]
