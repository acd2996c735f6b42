"""What code, tests and pages cite is there: documents, sections, files and headings."""

import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FOLDERS = ("slam", "drivers", "frontend", "backend", "logs", "benchmarks", "tests")
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")])
SOURCES = sorted(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py"))
# Whose comments say "section N" and mean the page of the devices.
DEVICE_SOURCES = [path for path in SOURCES if "drivers" in path.parts]

DOCUMENT = re.compile(r"(?<![\w/.*-])((?:[\w-]+/)*[\w-]+\.md)\b")
SECTION = re.compile(r"\bsections? (\d+(?:\.\d+)?)(?:(?:, | and | to )(\d+(?:\.\d+)?))?", re.I)
HEADING = re.compile(r"^#+ +(.+?)\s*$", re.M)
LINK = re.compile(r"\]\(([^)\s]+)\)")
CODE_PATH = re.compile(r"`((?:slam|drivers|frontend|backend|logs|benchmarks|tests|docs)/[\w./-]+)`")
WRITTEN_BY_PROGRAM = {"paper.md", "a.md"}  # results, not documents


def name(path):
    return str(path.relative_to(ROOT))


def without_code(text):
    return re.sub(r"^```.*?^```", "", text, flags=re.M | re.S)


@cache
def headings(page):
    return HEADING.findall(without_code(page.read_text("utf-8")))


def numbered_sections(page):
    return {m[1] for title in headings(page) if (m := re.match(r"(\d+(?:\.\d+)?)\.? ", title))}


def anchors(page):
    """As mkdocs and GitHub make them of headings."""
    plain = (re.sub(r"[^\w\- ]", "", title.lower()) for title in headings(page))
    return {re.sub(r" ", "-", title) for title in plain}


@pytest.mark.parametrize("path", [p for p in SOURCES if p != Path(__file__)], ids=name)
def test_every_cited_document_exists(path):
    for cited in DOCUMENT.findall(path.read_text("utf-8")):
        if cited not in WRITTEN_BY_PROGRAM:
            places = (folder / cited for folder in (ROOT, ROOT / "docs", path.parent))
            assert any(place.is_file() for place in places), f"{name(path)} cites {cited}"


def test_every_cited_section_of_the_devices_exists():
    known = numbered_sections(ROOT / "docs" / "devices.md")
    found = 0
    for path in DEVICE_SOURCES:
        for match in SECTION.finditer(path.read_text("utf-8")):
            for section in filter(None, match.groups()):
                assert section in known, f"{name(path)} cites section {section}"
                found += 1
    assert found > 60


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_links_lead_to_files_and_headings(page):
    for target in LINK.findall(without_code(page.read_text("utf-8"))):
        if target.startswith(("http://", "https://", "mailto:")):
            continue
        file, _, anchor = target.partition("#")
        other = (page.parent / file).resolve() if file else page
        assert other.exists(), f"{name(page)} links to {target}"
        if anchor and other.suffix == ".md":
            assert anchor in anchors(other), f"{name(page)} links to {target}"


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_source_files_that_a_page_names_exist(page):
    for path in CODE_PATH.findall(page.read_text("utf-8")):
        assert (ROOT / path).exists(), f"{name(page)} names {path}"


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_sections_that_a_page_cites_exist(page):
    """`[method](method.md), section 4` and the like."""
    cited = re.compile(r"\]\(([\w/]+\.md)\), section (\d+(?:\.\d+)?)")
    for file, section in cited.findall(page.read_text("utf-8")):
        assert section in numbered_sections(page.parent / file), f"{name(page)}: {file} {section}"


def test_references_to_the_bibliography_exist():
    known = anchors(ROOT / "docs" / "bibliography.md")
    assert len(known) > 10
    for page in PAGES:
        for anchor in re.findall(r"bibliography\.md#([\w-]+)", page.read_text("utf-8")):
            assert anchor in known, f"{name(page)} cites {anchor}"


def test_the_patterns_see_what_is_cited():
    assert DOCUMENT.findall("see docs/devices.md, section 4") == ["docs/devices.md"]
    assert SECTION.search("(docs/devices.md, sections 4 and 8)").groups() == ("4", "8")
    assert CODE_PATH.findall("`slam/mapping/slam.py` and `a/b.py`") == ["slam/mapping/slam.py"]
