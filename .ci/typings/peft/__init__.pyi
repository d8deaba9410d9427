"""The extra vla need not be installed: every name of peft is Any."""

from typing import Any

def __getattr__(name: str) -> Any: ...
