"""The pages: what they show, that they load nothing, and that nothing in a result becomes markup."""

import re
from html.parser import HTMLParser

import pytest

from benchmark.leaderboard import build as leaderboard
from benchmark.leaderboard import html
from benchmark.leaderboard.headline import MIN_EPISODES
from benchmark.protocol import Protocol
from benchmark.records import Checkpoint
from benchmark.results import video_dir


class Page(HTMLParser):
    """Collects every element, and checks that they nest."""

    VOID = frozenset({"meta", "br", "line", "circle", "polyline", "input", "wbr"})

    def __init__(self):
        super().__init__()
        self.open, self.elements, self.text = [], [], []

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def parse(text):
    page = Page()
    page.feed(text)
    page.close()
    assert not page.open
    return page


def pages(tmp_path):
    """The four pages of a folder, without the plots that writing them draws."""
    board = leaderboard.build(tmp_path)
    return {
        "html": html.render_html(board),
        "markdown": html.render_markdown(board),
        "studies html": html.render_studies_html(board),
        "studies markdown": html.render_studies_markdown(board),
    }


@pytest.mark.slow
def test_a_phone_shows_the_page_at_its_width_and_scrolls_wide_tables_alone(publish, tmp_path):
    publish()
    publish(policy="diffusion")
    text = leaderboard.write(tmp_path)["html"].read_text()
    page = parse(text)
    assert ("meta", {"name": "viewport", "content": "width=device-width, initial-scale=1"}) in page.elements
    boxes = [attributes.get("class", "") for tag, attributes in page.elements if tag in ("div", "table")]
    wide = [index for index, name in enumerate(boxes) if name == "wide"]
    assert wide and all(boxes[index - 1] == "scroll" for index in wide)
    assert re.search(r"\.scroll \{ overflow-x: auto;", text)


@pytest.mark.slow
def test_page_is_self_contained(publish, tmp_path):
    publish()
    publish(policy="diffusion")
    written = leaderboard.write(tmp_path)
    for kind in ("html", "studies html"):
        page = parse(written[kind].read_text())
        for tag, attributes in page.elements:
            for name in ("src", "href", "poster"):
                target = attributes.get(name, "#")
                assert target.startswith("#") or (tmp_path / target).exists(), f"<{tag} {name}={target}>"
        assert not re.search(r"url\(|@import|https?://", written[kind].read_text())
    assert sum(tag == "circle" for tag, _ in parse(written["html"].read_text()).elements) == 8


def test_the_index_leads_to_every_part(publish, tmp_path):
    for task, simulator in (("PickCube", "mujoco"), ("PickCube", "newton"), ("StackCube", "mujoco")):
        publish(task=task, simulator=simulator, run=simulator)
    page = parse(pages(tmp_path)["html"])
    names = {attributes["id"] for _, attributes in page.elements if "id" in attributes}
    links = {attributes["href"] for tag, attributes in page.elements if tag == "a"}
    assert {"#tasks", "#submit", "#cite", "#licence", "#code", "studies.html"} <= links
    assert {link[1:] for link in links if link.startswith("#")} <= names
    assert {"v2-pickcube-mujoco-warp", "v2-pickcube-newton-warp", "v2-stackcube-mujoco-warp"} <= names


def test_a_task_is_one_section_with_a_tab_per_simulator(publish, tmp_path):
    for task, simulator in (("PickCube", "mujoco"), ("PickCube", "newton"), ("StackCube", "mujoco")):
        publish(task=task, simulator=simulator, run=simulator)
    page = parse(pages(tmp_path)["html"])
    tasks = [a for tag, a in page.elements if tag == "details" and a.get("class", "").startswith("task")]
    tabs = [a for tag, a in page.elements if tag == "input" and a.get("class") == "tab"]
    assert (len(tasks), len(tabs)) == (2, 2)
    assert ["checked" in tab for tab in tabs] == [True, False]
    text = "".join(page.text)
    assert "MuJoCo · Newton" in text


def test_filters_have_every_level_policy_and_task(publish, tmp_path):
    publish()
    publish(policy="diffusion", task="CloseBox")
    page = parse(pages(tmp_path)["html"])
    fields = [a for tag, a in page.elements if tag == "input"]
    assert [a["id"] for a in fields if a.get("name") == "level"] == [f"level-{n}" for n in range(4)]
    assert [a["id"] for a in fields if a["type"] == "checkbox"] == ["policy-0", "policy-1"]
    assert sum(tag == "option" for tag, _ in page.elements) == 1 + 6
    rules = "".join(page.text)
    assert "body:has(#policy-1:not(:checked)) .p-1 { display: none; }" in rules
    assert any("p-1" in a.get("class", "").split() for tag, a in page.elements if tag == "tr")


def test_studies_are_on_their_own_page(publish, tmp_path):
    publish()
    publish(run="study", recipe="", command="x", rates=(0.0,) * 4)
    written = pages(tmp_path)
    board, studies = (parse(written[kind]) for kind in ("html", "studies html"))
    links = {
        kind: [a.get("href") for tag, a in page.elements if tag == "a"]
        for kind, page in (("b", board), ("s", studies))
    }
    assert "v2/PickCube/act/study.json" in links["s"] and "v2/PickCube/act/study.json" not in links["b"]
    assert "v2/PickCube/act/act-s0.json" in links["b"]
    assert "1 study" in "".join(board.text) and "foreign checkpoint" in "".join(studies.text)


def test_a_folder_of_studies_alone_is_reported(publish, tmp_path):
    publish(recipe="")
    written = pages(tmp_path)
    for kind in ("html", "markdown"):
        assert "No entries yet: all results are" in written[kind]


def test_page_shows_videos_that_exist(publish, tmp_path):
    folder = video_dir(publish())
    folder.mkdir()
    for name in (
        "level3-test-9001-failure.mp4",
        "level3-test-9001-failure.png",
        "camera-train-4-success.mp4",
        "x.mp4",
    ):
        (folder / name).touch()
    page = parse(pages(tmp_path)["html"])
    videos = [attributes for tag, attributes in page.elements if tag == "video"]
    assert [video["src"] for video in videos] == [
        "v2/PickCube/act/act-s0/camera-train-4-success.mp4",
        "v2/PickCube/act/act-s0/level3-test-9001-failure.mp4",
    ]
    assert "poster" not in videos[0]
    assert videos[1]["poster"].endswith("9001-failure.png")


def test_page_escapes_what_runs_say_of_themselves(publish, tmp_path):
    evil = "<script>alert(1)</script>"
    publish(command=f"python x.py '{evil}'")
    publish(run="study", recipe="", command=evil, config={"policy": {"backend": evil}, "preset": evil})
    publish(
        run="else", config={"policy": {}, "run": {"simulator": evil, "renderer": f"[x](javascript:{evil})"}}
    )
    written = pages(tmp_path)
    for kind in ("html", "studies html", "markdown", "studies markdown"):
        assert "<script>alert" not in written[kind]
    assert "](javascript" not in written["markdown"].replace("\\](", "")
    assert "act by &lt;script&gt;alert" in written["studies html"]


def test_tables_and_page_escape_html_and_cells_in_options(publish, tmp_path):
    publish(task_kwargs={"variant": "<script>alert(1)</script>|\n# x"})
    written = pages(tmp_path)
    for kind in ("html", "markdown"):
        assert "<script>alert" not in written[kind]
    assert "variant=&lt;script&gt;alert(1)&lt;/script&gt;\\| # x" in written["markdown"]


def test_the_papers_numbers_are_marked(publish, tmp_path):
    publish()
    page = parse(pages(tmp_path)["html"])
    text = " ".join(page.text)
    assert text.count("reported by the paper") == 2 * 2 + 2, (
        "beside B at levels 0 and 3, and in the task's table"
    )
    assert "31.7 %" in text
    assert "52.7 %" in text
    assert "not comparable with the rows above" in text
    assert leaderboard.build(tmp_path)["reference"]["url"] == "https://arxiv.org/abs/2504.18904"


@pytest.mark.parametrize("kind", ["entry", "baseline", "study"])
@pytest.mark.parametrize(("episodes", "few"), [(1, True), (MIN_EPISODES - 1, True), (MIN_EPISODES, False)])
def test_a_rate_of_too_few_episodes_is_not_bold_and_has_their_number(publish, tmp_path, kind, episodes, few):
    untrained = {"policy": "random", "dataset_hash": None, "train_level": None, "checkpoint": Checkpoint()}
    changes = {"entry": {}, "baseline": untrained, "study": {}}[kind]
    protocol = Protocol(levels=(0,), splits=("test",), episodes=episodes)
    publish(protocol=protocol, recipe="act_v1" if kind == "entry" else "", rates=(1, 1, 1, 1), **changes)
    found = pages(tmp_path)
    page = "studies " if kind == "study" else ""
    rows = [line for line in found[f"{page}markdown"].splitlines() if " 100 (" in line or "**100** (" in line]
    said = f"{episodes} episode{'s' if episodes > 1 else ''})"
    assert rows and all(("**100** (" in row, said in row) == (not few, few) for row in rows)
    assert ('<td class="number few"' in found[f"{page}html"]) == few
    assert (f'episodes">{episodes} ep.</small>' in found[f"{page}html"]) == few
