"""SAPIEN need not be installed, and its own types miss what numpy gives: every name in it is Any."""

from typing import Any

def __getattr__(name: str) -> Any: ...
