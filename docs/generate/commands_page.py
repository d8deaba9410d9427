"""The reference of commands: every key with its default and its line of help.

``python -m docs.generate.commands_page`` writes ``docs/reference/commands.md`` from the dataclasses, whose
fields are the keys and whose docstrings are their help.
"""

import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import policies
from envs.core.arguments import run_program
from roboverse_learn.checks.contract import Contract
from roboverse_learn.checks.policies import POLICY_CONTRACTS
from roboverse_learn.checks.robots import ROBOT_CONTRACTS
from roboverse_learn.checks.tasks import TASK_CONTRACTS
from roboverse_learn.config import help as help_texts
from roboverse_learn.config.scenario_overrides import SECTION
from roboverse_learn.config.schema import COMMANDS
from roboverse_learn.dataset import GetConfig, InfoConfig, MergeConfig
from roboverse_learn.speed import PROGRAMS

PAGE = """\
# Commands

Made by `python -m docs.generate.commands_page`. `roboverse <command> --help` prints the same.

Settings are words `key=value`. A key may be shortened to its last part where only one key ends so: \
`steps=100` is `train.steps=100`. Values come from the dataclasses, then from `configs/`, then from the \
command line. An unknown key is an error that suggests the nearest. `plugins=[my_module]` imports modules \
first, which register tasks, robots and policies.

| command | what it does |
|---|---|
{overview}

{commands}

## Keys of a scene

Keys of every command that takes `scenario.*`; their defaults are the task's.

{scene}

## Keys of policies

Keys of `roboverse train policy=<name>`, with the defaults of `preset=full`. Checkpoints record them.

{policies}
"""

CONTRACTS = {"task": TASK_CONTRACTS, "policy": POLICY_CONTRACTS, "robot": ROBOT_CONTRACTS}

FOREIGN = ("policy.", f"{SECTION}.")
"""Keys that have tables of their own below the commands."""


@dataclass(frozen=True, kw_only=True, slots=True)
class PageSettings:
    """Writes the reference of commands.

    Attributes:
        out: The page.
    """

    out: Path = Path("docs/reference/commands.md")


def page() -> str:
    """Returns the page."""
    commands = "\n\n".join(_section(name) for name in help_texts.SUMMARIES)
    rows = dict.fromkeys(row for name in COMMANDS for row in help_texts.key_rows(name))
    agents = (
        f"### policy={name}\n\n{policies.summary(name)}.\n\n{_key_table(_policy_rows(name))}"
        for name in policies.names()
    )
    return PAGE.format(
        overview="\n".join(
            f"| [`{name}`](#roboverse-{name}) | {about} |" for name, about in help_texts.SUMMARIES.items()
        ),
        commands=commands,
        scene=_key_table(row for row in rows if row[0].startswith(f"{SECTION}.")),
        policies="\n\n".join(agents),
    )


def _policy_rows(policy: str) -> list[tuple[str, str]]:
    rows = help_texts.key_rows("train", policy=policy)
    return [row for row in rows if row[0].startswith("policy.")]


def _section(name: str) -> str:
    """Returns the section of one command."""
    about = help_texts.SUMMARIES[name]
    parts = [f"## roboverse {name}", f"{about[0].upper()}{about[1:]}."]
    if name in help_texts.EXAMPLES:
        parts.append("```\n" + "\n".join(help_texts.EXAMPLES[name]) + "\n```")
    if name == "check":
        parts += [f"Contracts of a {kind}:\n\n{_contract_table(every)}" for kind, every in CONTRACTS.items()]
    if name in COMMANDS:
        rows = help_texts.key_rows(name)
        parts.append(_key_table(row for row in rows if not row[0].startswith(FOREIGN)))
        if any(row[0].startswith(f"{SECTION}.") for row in rows):
            parts.append("Keys of the scene: see [below](#keys-of-a-scene).")
    elif name == "list":
        kinds = ", ".join(f"`{kind}`" for kind in help_texts.KINDS)
        parts.append(f"Kinds: {kinds}; none lists all. `{help_texts.RUNS}` alone lists runs.")
    elif name == "speed":
        entries = ((name, PROGRAMS.entry(name).summary) for name in PROGRAMS)
        parts.append(_table(("program", "what it measures"), ((f"`{name}`", text) for name, text in entries)))
    elif name == "dataset":
        parts.append(_table(("key", "default", "what it is"), _dataset_rows()))
    return "\n\n".join(parts)


def _contract_table(contracts: Iterable[Contract[Any]]) -> str:
    return _table(("contract", "what holds"), ((f"`{each.name}`", each.about) for each in contracts))


def _dataset_rows() -> Iterable[tuple[str, str, str]]:
    for action, cls in (("merge", MergeConfig), ("info", InfoConfig), ("get", GetConfig)):
        about = dict(help_texts.documented(cls))
        for item in fields(cls):
            yield f"`{action} {item.name.removesuffix('_')}=`", "", about[item.name]


def _key_table(rows: Iterable[tuple[str, str]]) -> str:
    split = ((left.partition("="), about) for left, about in rows)
    return _table(
        ("key", "default", "what it is"),
        ((f"`{key}`", f"`{default}`" if default else "", about) for (key, _, default), about in split),
    )


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows]
    return "\n".join(lines)


def main(words: Sequence[str] | None = None) -> int:
    """Writes the reference of commands; returns the exit code."""
    return run_program("python -m docs.generate.commands_page", PageSettings, _write, words)


def _write(settings: PageSettings) -> None:
    settings.out.write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
