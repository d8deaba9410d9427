"""What came of all contracts of one thing, as a table."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from roboverse_learn.checks.contract import Contract, Finding

if TYPE_CHECKING:
    from rich.console import Group

_STYLES = {"ok": "green", "failed": "bold red", "skipped": "dim"}


@dataclass(frozen=True, kw_only=True, slots=True)
class Checked:
    """Findings about one thing; a terminal shows them as a table.

    Attributes:
        what: What was checked, in words.
        contracts: Contracts that were looked at.
        findings: One for each.
    """

    what: str
    contracts: Sequence[Contract[Any]]
    findings: Sequence[Finding]

    @property
    def ok(self) -> bool:
        """Whether no contract failed."""
        return not self.count("failed")

    @property
    def failures(self) -> dict[str, str]:
        """What to mend, by the name of each broken contract."""
        return {finding.name: finding.detail for finding in self.findings if finding.result == "failed"}

    def count(self, result: str) -> int:
        """Returns how many contracts have a result."""
        return sum(finding.result == result for finding in self.findings)

    def __rich__(self) -> "Group":
        from rich.console import Group
        from rich.table import Table
        from rich.text import Text

        table = Table("contract", "result", "what was seen", title=self.what, title_justify="left")
        for each, finding in zip(self.contracts, self.findings, strict=True):
            said = finding.detail if finding.result != "failed" else f"{each.about}\n{finding.detail}"
            table.add_row(finding.name, Text(finding.result, _STYLES[finding.result]), Text(said))
        counts = ", ".join(f"{self.count(name)} {name}" for name in _STYLES)
        end = "" if self.ok else " Mend what failed, and look at it alone with contracts=[<name>]."
        return Group(table, Text(f"{len(self.findings)} contracts: {counts}.{end}"))
