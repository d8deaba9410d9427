"""Newton need not be installed: every name in it is Any."""

from typing import Any

def __getattr__(name: str) -> Any: ...
