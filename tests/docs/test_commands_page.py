"""The reference of commands says what the dataclasses say."""

from docs.generate import commands_page as page
from roboverse_learn.config.help import SUMMARIES


def test_the_page_in_the_docs_is_what_the_dataclasses_give():
    written = page.PageSettings().out.read_text(encoding="utf-8")
    assert written == page.page(), "run: python -m docs.generate.commands_page"


def test_every_command_has_a_section_with_its_keys():
    text = page.page()
    for name in SUMMARIES:
        assert f"\n## roboverse {name}\n" in text
    assert "| `collect.num_demos` | `1000` | Successful episodes in the dataset. |" in text
    assert "### policy=diffusion" in text and ":class:" not in text


def test_the_page_is_written_where_it_is_asked_for(tmp_path):
    assert page.main([f"out={tmp_path / 'commands.md'}"]) == 0
    assert (tmp_path / "commands.md").read_text(encoding="utf-8") == page.page()
