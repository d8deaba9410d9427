"""A contract, and what came of it."""

import inspect
import sysconfig
import traceback
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from envs.core.errors import MissingExtraError, RoboVerseError, unknown_name

Result = Literal["ok", "failed", "skipped"]


class BrokenContractError(Exception):
    """A contract does not hold; the message tells the author what to mend."""


class NotApplicableError(Exception):
    """A contract says nothing about this thing; the message says why."""


@dataclass(frozen=True, slots=True)
class Contract[S]:
    """One promise.

    Attributes:
        name: Its name, by which it is chosen or left out.
        about: What holds where it is kept, in one line.
        check: Looks at what is checked and returns what was seen. It raises :class:`BrokenContractError`
            where the promise is broken, and :class:`NotApplicableError` where it does not apply.
        needs: Names of contracts without which this one cannot be looked at.
    """

    name: str
    about: str
    check: Callable[[S], str]
    needs: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Finding:
    """What came of one contract.

    Attributes:
        name: The contract's name.
        result: Whether it holds.
        detail: What was seen, what to mend, or why it was skipped.
    """

    name: str
    result: Result
    detail: str


def contract[S](*needs: str) -> Callable[[Callable[[S], str]], Contract[S]]:
    """Makes a contract of a function: its name is the function's, its line the first one of the docstring.

    Args:
        *needs: See :attr:`Contract.needs`.
    """

    def decorate(check: Callable[[S], str]) -> Contract[S]:
        about = (inspect.getdoc(check) or "").partition("\n")[0]
        return Contract(check.__name__, about, check, needs)

    return decorate


def require(condition: object, mend: str) -> None:
    """Raises :class:`BrokenContractError` with the sentence ``mend`` unless the condition holds."""
    if not condition:
        raise BrokenContractError(mend)


def counted(count: int, noun: str) -> str:
    """Returns a number with its noun: ``1 option``, ``2 options``."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def chosen[S](
    contracts: Iterable[Contract[S]], names: Collection[str] = (), without: Collection[str] = ()
) -> list[Contract[S]]:
    """Returns the named contracts and those that they need, or all; less those that are left out.

    Raises:
        UnknownNameError: There is no contract of that name.
    """
    by_name = {each.name: each for each in contracts}
    for name in (*names, *without):
        if name not in by_name:
            raise unknown_name("contract", name, by_name)
    wanted = set(names or by_name)
    while more := {need for name in wanted for need in by_name[name].needs} - wanted:
        wanted |= more
    return [each for name, each in by_name.items() if name in wanted and name not in without]


def run[S](
    contracts: Iterable[Contract[S]], checked: S, begin: Callable[[str], None] = lambda name: None
) -> Iterator[Finding]:
    """Yields the finding of each contract.

    Args:
        contracts: The contracts, each after those that it needs.
        checked: What they look at.
        begin: Called with the name of each contract before it is looked at.

    Raises:
        MissingExtraError: A package is not installed, such as the simulator's.
    """
    failed: set[str] = set()
    for each in contracts:
        begin(each.name)
        missing = [need for need in each.needs if need in failed]
        if missing:
            yield Finding(each.name, "skipped", f"needs '{missing[0]}'")
            failed.add(each.name)
            continue
        finding = _look(each, checked)
        if finding.result == "failed":
            failed.add(each.name)
        yield finding


def _look(each: Contract[Any], checked: Any) -> Finding:
    try:
        return Finding(each.name, "ok", each.check(checked))
    except NotApplicableError as reason:
        return Finding(each.name, "skipped", str(reason))
    except (BrokenContractError, RoboVerseError) as error:
        if isinstance(error, MissingExtraError):
            raise
        return Finding(each.name, "failed", str(error))
    except Exception as error:  # whatever the author's code raises is the finding
        said = " ".join(str(error).split())
        return Finding(each.name, "failed", f"{type(error).__name__}: {said}{_where(error)}")


def _where(error: Exception) -> str:
    """Returns the innermost line of the author's own code that raised an error, or nothing."""
    frames = traceback.extract_tb(error.__traceback__)
    ours = [str(Path(__file__).parents[1]), *map(sysconfig.get_path, ("stdlib", "purelib", "platlib"))]
    theirs = [frame for frame in frames if not frame.filename.startswith(tuple(ours))]
    theirs = [frame for frame in theirs if not frame.filename.startswith("<")]
    return f" ({Path(theirs[-1].filename).name}:{theirs[-1].lineno}, in {theirs[-1].name})" if theirs else ""
