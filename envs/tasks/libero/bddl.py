"""Reads LIBERO's task files: BDDL, of which they use a small part.

A file defines a problem: its language, regions, fixtures, objects, and the atoms of its start and its goal.
LIBERO: Liu et al., arXiv 2306.03310, code MIT; the grammar is that of its 130 files.
"""

import ast
import math
import operator
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from envs.core.errors import ConfigError, unknown_name

PREDICATES = {"in": 2, "on": 2, "open": 1, "close": 1, "turnon": 1, "turnoff": 1}
"""Predicates in lower case, and how many arguments each has."""

_PARTS = (":domain", ":language", ":regions", ":fixtures", ":objects", ":obj_of_interest", ":init", ":goal")
_OPERATORS = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.USub: operator.neg,
}


@dataclass(frozen=True, slots=True)
class Atom:
    """A predicate and its arguments, such as ``on bowl_1 plate_1``.

    Attributes:
        predicate: One of :data:`PREDICATES`.
        args: Names of objects, fixtures or regions.
    """

    predicate: str
    args: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Region:
    """A place: a rectangle of a table, or a site of an object's file.

    Attributes:
        name: Full name, ``<target>_<name>``.
        target: What it belongs to.
        site: Name of the site of the target's file, for a region without a rectangle.
        ranges: ``(x0, y0, x1, y1)`` from the middle of the workspace, m; None for a site.
        yaw: Least and largest turn about z of what is put there, rad; None where the file has none.
    """

    name: str
    target: str
    site: str
    ranges: tuple[float, float, float, float] | None = None
    yaw: tuple[float, float] | None = None

    @property
    def middle(self) -> tuple[float, float]:
        """Middle of the rectangle, m."""
        assert self.ranges is not None, "a region of a table has ranges"
        x0, y0, x1, y1 = self.ranges
        return (x0 + x1) / 2, (y0 + y1) / 2


@dataclass(frozen=True, slots=True)
class Problem:
    """What a task file says.

    Attributes:
        name: Name of the problem, such as ``LIBERO_Kitchen_Tabletop_Manipulation``.
        language: The instruction.
        regions: Full name to region.
        fixtures: What does not move, name to category, in the file's order.
        objects: What moves, name to category, in the file's order.
        interest: Names that the instruction is about.
        init: What holds at the start.
        goal: What has to hold together.
        source: The file, for errors.
        lines: Objects, fixtures, regions, ``problem`` and ``goal`` to the line that has them, for errors.
    """

    name: str
    language: str
    regions: dict[str, Region]
    fixtures: dict[str, str]
    objects: dict[str, str]
    interest: tuple[str, ...]
    init: tuple[Atom, ...]
    goal: tuple[Atom, ...]
    source: str = field(default="", compare=False)
    lines: Mapping[str, int] = field(default_factory=dict, compare=False)

    def error(self, name: str, problem: str) -> ConfigError:
        """Returns an error with file and line of what has a name.

        Args:
            name: A key of ``lines``.
            problem: What is wrong, without a full stop.
        """
        return ConfigError(f"{self.source}:{self.lines.get(name, 1)}: {problem}.")


@dataclass(slots=True)
class _List:
    """A parenthesized list; ``items`` are words and lists."""

    line: int
    items: list["_Word | _List"]


@dataclass(slots=True)
class _Word:
    line: int
    text: str


def read_problem(path: Path) -> Problem:
    """Reads a task file.

    Raises:
        ConfigError: There is no such file, or it is none that LIBERO could have; it names file and line.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"The task file {path} cannot be read: {error}.") from error
    return parse_problem(text, str(path))


def parse_problem(text: str, source: str) -> Problem:
    """Reads the text of a task file; ``source`` names it in errors."""
    return _Reader(source).problem(text)


class _Reader:
    def __init__(self, source: str) -> None:
        self._source = source

    def problem(self, text: str) -> Problem:
        define = self._tree(text)
        parts: dict[str, _List] = {}
        for item in define.items[1:]:
            words = self._list(item)
            parts[self._word(words, 0).lower()] = words
        for name in ("problem", *_PARTS):
            if name not in parts:
                raise self._error(define.line, f"it lacks the part '({name} …)'")
        objects = self._typed(parts[":objects"])
        fixtures = self._typed(parts[":fixtures"])
        regions = {region.name: region for region in map(self._region, parts[":regions"].items[1:])}
        known = (*objects, *fixtures, *regions)
        goal = self._list(self._only(parts[":goal"]))
        if self._word(goal, 0).lower() != "and":
            raise self._error(goal.line, f"its goal is '({self._word(goal, 0)} …)', where only And is known")
        return Problem(
            name=self._word(parts["problem"], 1),
            language=" ".join(self._text(item) for item in parts[":language"].items[1:]),
            regions=regions,
            fixtures=fixtures,
            objects=objects,
            interest=tuple(self._text(item) for item in parts[":obj_of_interest"].items[1:]),
            init=tuple(self._atom(item, known) for item in parts[":init"].items[1:]),
            goal=tuple(self._atom(item, known) for item in goal.items[1:]),
            source=self._source,
            lines=self._lines(parts, (*objects, *fixtures), list(regions)),
        )

    def _lines(self, parts: dict[str, _List], typed: tuple[str, ...], regions: list[str]) -> dict[str, int]:
        """Returns the line of each name, of the problem and of the goal."""
        words = [*parts[":objects"].items, *parts[":fixtures"].items]
        found = {item.text: item.line for item in words if isinstance(item, _Word) and item.text in typed}
        found |= {name: item.line for name, item in zip(regions, parts[":regions"].items[1:], strict=False)}
        return found | {"problem": parts["problem"].line, "goal": parts[":goal"].line}

    def _tree(self, text: str) -> _List:
        stack: list[_List] = []
        last = 1
        for line, token in _tokens(text):
            last = line
            if token == "(":
                stack.append(_List(line, []))
            elif token == ")":
                if not stack:
                    raise self._error(line, "a parenthesis closes that was never opened")
                done = stack.pop()
                if not stack:
                    if self._word(done, 0).lower() != "define":
                        raise self._error(done.line, "it does not begin with '(define'")
                    return done
                stack[-1].items.append(done)
            elif not stack:
                raise self._error(line, f"'{token}' stands outside '(define …)'")
            else:
                stack[-1].items.append(_Word(line, token))
        if not stack:
            raise self._error(last, "it is empty")
        raise self._error(last, f"it ends inside the '(' of line {stack[-1].line}: the file is cut off")

    def _region(self, item: "_Word | _List") -> Region:
        part = self._list(item)
        name, facts = self._word(part, 0), {}
        for fact in part.items[1:]:
            values = self._list(fact)
            facts[self._word(values, 0).lower()] = values
        if ":target" not in facts:
            raise self._error(part.line, f"the region '{name}' has no ':target'")
        target = self._word(facts[":target"], 1)
        ranges, yaw = (
            self._numbers(facts[key], size) if key in facts else None
            for key, size in ((":ranges", 4), (":yaw_rotation", 2))
        )
        if ranges is not None and (ranges[0] > ranges[2] or ranges[1] > ranges[3]):
            raise self._error(part.line, f"the region '{name}' ends before it begins: {ranges}")
        return Region(f"{target}_{name}", target, name, ranges, yaw)  # type: ignore[arg-type]

    def _numbers(self, part: _List, count: int) -> tuple[float, ...]:
        """Reads the first of a list of lists of numbers, each a number or an expression with ``pi``."""
        inner = self._list(self._only(part))
        row = self._list(inner.items[0]) if inner.items and isinstance(inner.items[0], _List) else inner
        values = tuple(self._number(item) for item in row.items)
        if len(values) != count:
            raise self._error(part.line, f"{count} numbers belong here, given {len(values)}")
        return values

    def _number(self, item: "_Word | _List") -> float:
        text = self._text(item)
        try:
            return _evaluated(ast.parse(text, mode="eval").body)
        except (SyntaxError, ValueError, ZeroDivisionError):
            raise self._error(item.line, f"'{text}' is no number") from None

    def _typed(self, part: _List) -> dict[str, str]:
        found: dict[str, str] = {}
        names: list[str] = []
        words = iter(part.items[1:])
        for item in words:
            if self._text(item) != "-":
                names.append(self._text(item))
                continue
            category = next(words, None)
            if category is None or not names:
                raise self._error(item.line, "'-' needs names before it and a type after it")
            found |= dict.fromkeys(names, self._text(category))
            names = []
        if names:
            raise self._error(part.line, f"'{names[0]}' has no type: write '{names[0]} - <type>'")
        return found

    def _atom(self, item: "_Word | _List", known: tuple[str, ...]) -> Atom:
        part = self._list(item)
        words = [self._text(word) for word in part.items]
        predicate = words[0].lower() if words else ""
        if predicate not in PREDICATES:
            error = unknown_name("predicate", words[0] if words else "", PREDICATES)
            raise self._error(part.line, str(error).rstrip("."))
        if len(words) - 1 != PREDICATES[predicate]:
            raise self._error(
                part.line, f"{words[0]} has {PREDICATES[predicate]} argument(s), given {len(words) - 1}"
            )
        for name in words[1:]:
            if name not in known:
                error = unknown_name("object or region", name, known)
                raise self._error(part.line, str(error).rstrip("."))
        return Atom(predicate, tuple(words[1:]))

    def _only(self, part: _List) -> "_Word | _List":
        if len(part.items) != 2:
            raise self._error(part.line, f"'({self._word(part, 0)} …)' holds one list")
        return part.items[1]

    def _list(self, item: "_Word | _List") -> _List:
        if isinstance(item, _Word):
            raise self._error(item.line, f"'{item.text}' stands where a list belongs")
        return item

    def _word(self, part: _List, index: int) -> str:
        if len(part.items) <= index:
            raise self._error(part.line, "a word is missing in this list")
        return self._text(part.items[index])

    def _text(self, item: "_Word | _List") -> str:
        if isinstance(item, _List):
            raise self._error(item.line, "a list stands where a word belongs")
        return item.text

    def _error(self, line: int, problem: str) -> ConfigError:
        return ConfigError(f"{self._source}:{line}: {problem}.")


def _tokens(text: str) -> Iterator[tuple[int, str]]:
    for line, row in enumerate(text.splitlines(), 1):
        code = row.partition(";")[0].replace("(", " ( ").replace(")", " ) ")
        for token in code.split():
            yield line, token


def _evaluated(node: ast.expr) -> float:
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        return float(node.value)
    if isinstance(node, ast.Name) and node.id == "pi":
        return math.pi
    if isinstance(node, ast.UnaryOp) and type(node.op) in _OPERATORS:
        return _OPERATORS[type(node.op)](_evaluated(node.operand))
    if isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
        return _OPERATORS[type(node.op)](_evaluated(node.left), _evaluated(node.right))
    raise ValueError
