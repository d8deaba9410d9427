"""The pages of the documentation site: all of them are in its navigation, and their links stay inside it."""

import re
from pathlib import Path

import yaml

DOCS = Path(__file__).parents[2] / "docs"
CONFIG = yaml.safe_load((DOCS / "mkdocs.yml").read_text(encoding="utf-8"))
PAGES = sorted(path for path in DOCS.rglob("*.md") if not {"site", ".cache"} & {*path.parts})


def leaves(nav):
    """Yields the files of a navigation, in order."""
    for item in nav:
        if isinstance(item, str):
            yield item
        else:
            (value,) = item.values()
            yield from leaves(value if isinstance(value, list) else [value])


def test_navigation_holds_every_page_once():
    named = list(leaves(CONFIG["nav"]))
    assert sorted(named) == [path.relative_to(DOCS).as_posix() for path in PAGES]


def test_links_lead_to_files_of_the_site():
    # The site holds docs/ alone, and the strict build checks links between pages only.
    broken = []
    for page in PAGES:
        text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
        for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", text):
            if not target.startswith(("http://", "https://")):
                found = (page.parent / target).resolve()
                if not (found.is_relative_to(DOCS) and found.is_file()):
                    broken.append(f"{page.relative_to(DOCS)}: {target}")
    assert not broken, f"links that leave docs/ or lead nowhere; name other files as `code`: {broken}"


def test_pages_request_nothing_from_other_hosts():
    assert CONFIG["theme"]["font"] is False
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        assert not re.search(r"!\[[^]]*\]\(https?://|<(img|script|iframe)[^>]*https?://", text), page
        assert "```mermaid" not in text, f"{page}: Mermaid's program would come from another host"
