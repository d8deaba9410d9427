"""Configuration of ``roboverse doctor``."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True, slots=True)
class DoctorConfig:
    """``roboverse doctor``: the machine, the installation, and what works here.

    Attributes:
        json: Print JSON instead of text.
    """

    json: bool = False
