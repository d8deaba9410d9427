"""The last line of ``roboverse doctor``: whether the default path works, and what is optional and fails."""

from collections.abc import Iterator, Mapping
from typing import Any

from envs.spec import EnvSpec

type Report = Mapping[str, Mapping[str, Any]]

DECODER = "pyav"
"""What reads the videos of datasets by default."""

_FAILED = "failed"
"""Key of the reason why a part of the report, or one of its facts, is not there."""


def verdict(report: Report) -> str:
    """Returns in one line what matters in a report of :func:`roboverse_learn.doctor.diagnose`."""
    broken = [f"{what}: {reason}" for what, reason in _broken(report)]
    default = f"The default path does not work, because of {'; '.join(broken)}" if broken else ""
    default = default or "The default path works"
    optional = "; ".join(_unusable(report))
    return f"{default.rstrip('.')}{f'; optional and not usable here: {optional}' if optional else ''}."


def _broken(report: Report) -> Iterator[tuple[str, str]]:
    """Yields what the default path needs and does not have, with the reason."""
    renderer = EnvSpec().renderer
    needed = {
        "packages": report.get("packages", {}),
        "torch": report.get("gpu", {}),
        "videos": report.get("video", {}),
        f"videos by {DECODER}": report.get("video", {}).get(DECODER, {}),
        "renderers": report.get("renderers", {}),
        f"renderer={renderer}": report.get("renderers", {}).get(renderer, {}),
        "speed": report.get("speed", {}),
        **{name: facts for name, facts in report.get("speed", {}).items() if isinstance(facts, Mapping)},
    }
    if unknown := report.get("plugins", {}).get("cannot be imported"):
        yield "plugins", unknown
    for what, facts in needed.items():
        if isinstance(facts, Mapping) and isinstance(facts.get(_FAILED), str):
            yield what, facts[_FAILED]


def _unusable(report: Report) -> Iterator[str]:
    """Yields what is optional and fails, or is not installed."""
    extras = {name: state for name, state in report.get("extras", {}).items() if name != _FAILED}
    missing = [name for name, state in extras.items() if state != "installed"]
    failed = [
        name
        for name, facts in report.get("renderers", {}).items()
        if name not in (EnvSpec().renderer, *missing) and isinstance(facts, Mapping) and _FAILED in facts
    ]
    for kind, names in (("renderers", failed), ("extras", missing)):
        if names:
            yield f"{kind} {', '.join(names)}"
