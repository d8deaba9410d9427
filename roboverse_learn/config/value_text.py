"""Values as the text of ``key=value`` words, in Hydra's grammar."""

import re

_PLAIN = re.compile(r"(?!(?:null|true|false|nan|inf)$)[A-Za-z_][\w./-]*", re.IGNORECASE | re.ASCII)
"""Texts that mean themselves on the command line without quotes."""


def as_text(value: object) -> str:
    """Returns a value as text that Hydra's grammar reads back; plain words stay without quotes."""
    if isinstance(value, list):
        return f"[{','.join(map(as_text, value))}]"
    if isinstance(value, dict):
        return f"{{{','.join(f'{name}:{as_text(inner)}' for name, inner in value.items())}}}"
    if value is None:
        return "null"
    if isinstance(value, str) and not _PLAIN.fullmatch(value):  # it could be two values, or a number
        from hydra.core.override_parser.types import Quote, QuotedString

        return QuotedString(value, Quote.single).with_quotes()
    return str(value).lower() if isinstance(value, bool) else str(value)
