"""The pages: every link leads somewhere, and together they can be read in an evening."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md")]
PAGES += sorted((ROOT / "docs").glob("*.md"))
MOST_WORDS = {"accuracy.md": 1200, "experiments.md": 4000, "method.md": 4000}
MOST_WORDS_IN_ALL = 30_000


def without_code(text: str) -> str:
    """The text without blocks and spans of code, in which nothing is a link or a heading."""
    return re.sub(r"`[^`\n]*`", "", re.sub(r"^```.*?^```$", "", text, flags=re.S | re.M))


def anchors(page: Path) -> set[str]:
    """What a link into the page may name: ids, and headings as GitHub names them."""
    text = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.S | re.M)
    found = set(re.findall(r'<a id="([^"]+)"></a>', text))
    for heading in re.findall(r"^#+ (.+)$", text, re.M):
        plain = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower()
        found.add(re.sub(r"[^\w\- ]", "", plain).replace(" ", "-"))
    return found


def links(page: Path) -> Iterator[tuple[Path, str]]:
    """Page or file and anchor of each link that stays within the project."""
    for target in re.findall(r"\]\(([^)\s]+)\)", without_code(page.read_text(encoding="utf-8"))):
        if not re.match(r"[a-z]+:", target):
            path, _, anchor = target.partition("#")
            yield (page.parent / path if path else page), anchor


def words(page: Path) -> int:
    """Words of a page, as `wc -w` counts them but for the lines of its tables."""
    return sum(any(map(str.isalnum, word)) for word in page.read_text(encoding="utf-8").split())


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    for path, anchor in links(page):
        assert path.exists(), path
        assert not anchor or anchor in anchors(path), f"{path.name}#{anchor}"


def test_links_and_anchors_are_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "See [b](b.md#some-thing) `[no](none.md)`\n\n## The `x` of [this](c.md)?\n"
        '<a id="old"></a>\n'
        "```\n# no heading\n[no](none.md)\n```\n[here](#old) [web](https://example.org/a.md)\n"
    )
    assert list(links(page)) == [
        (tmp_path / "b.md", "some-thing"),
        (tmp_path / "c.md", ""),
        (page, "old"),
    ]
    assert anchors(page) == {"the-x-of-this", "old"}


@pytest.mark.parametrize("name", MOST_WORDS)
def test_page_is_short(name: str) -> None:
    assert 500 < words(ROOT / "docs" / name) <= MOST_WORDS[name]


def test_all_pages_together_are_short() -> None:
    assert sum(map(words, PAGES)) <= MOST_WORDS_IN_ALL
