"""usd-core fills its modules when they are imported: every name in it is Any."""

from typing import Any

def __getattr__(name: str) -> Any: ...
