"""The site before Sphinx: its pages, its navigation, its links, and its extensions."""

from __future__ import annotations

import importlib
import os
import re
import sys
import tomllib
from collections import Counter
from fnmatch import fnmatch
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import dmframe

ROOT = Path(__file__).parents[2]


def part(name: str) -> Any:
    """A module of the documentation's folder."""
    sys.path.insert(0, str(ROOT / "docs"))
    try:
        return importlib.import_module(name)
    finally:
        sys.path.remove(str(ROOT / "docs"))


make_site = part("make_site")
api, live, mathematics = part("site_parts.api"), part("site_parts.live"), part("site_parts.mathematics")
pages, references = part("site_parts.pages"), part("site_parts.references")

LOADS = re.compile(r"""(?:src|href)\s*=\s*["']?(?:https?:)?//|url\(\s*["']?(?:https?:)?//|@import|<link|cdn\.""", re.I)
"""Texts by which a page, a style or a configuration makes a browser load a resource."""
PLAIN_LINK = re.compile(r"(?<!!)\[[^\]]*\]\(https?://")


@pytest.fixture(scope="module")
def files() -> dict[str, str | bytes]:
    """All sources of the site except the blocks' pages, which have their own tests."""
    shown = set[Path]()
    found: dict[str, str | bytes] = {
        place: pages.linked(path.read_text(encoding="utf-8"), path, place, shown.add)
        for place, path in pages.sources().items()
    }
    found |= {place: path.read_bytes() for place, path in make_site.pictures().items()}
    found |= api.pages() | {"reference/references.rst": references.text()}
    return found | {pages.shown_place(path): pages.shown_text(path) for path in shown}


def navigation(files: dict[str, str | bytes]) -> Counter[str]:
    """Number of tables of contents that list each page."""
    names = {re.sub(r"\.(md|rst)$", "", place): place for place in files if place.endswith((".md", ".rst"))}
    listed = Counter[str]()
    for place, text in files.items():
        if isinstance(text, str) and not place.startswith("files/"):
            for line in entries(place, text):
                name = os.path.normpath(Path(place).parent / line)
                several = [
                    known
                    for known in names
                    if fnmatch(known, name) and "/" not in known[len(str(Path(name).parent)) + 1 :]
                ]
                assert several or name.startswith(pages.CATALOGUE), f"{place}: {line} is no page"
                listed.update(several if "*" in name else [name])
    return listed


def entries(place: str, text: str) -> list[str]:
    if place.endswith(".md"):
        return pages.children(text)
    return re.findall(r"^   (\w+)$", text, re.MULTILINE) if place.endswith("api/index.rst") else []


def test_a_build_takes_nothing_out_of_a_folder_that_is_not_its_own(tmp_path):
    others = tmp_path / "site-source"
    others.mkdir()
    (others / "thesis.md").write_text("mine")
    with pytest.raises(SystemExit, match="expected no files but those of an earlier build"):
        make_site.claim(others)
    own = tmp_path / "own"
    make_site.claim(own)
    make_site.lay_out({"a.md": "a"}, own)
    make_site.claim(own)
    make_site.lay_out({"b.md": "b"}, own)
    assert sorted(path.name for path in own.iterdir()) == [make_site.MARK, "b.md"]
    assert (others / "thesis.md").read_text() == "mine"


def test_sphinx_counts_its_pages_in_a_terminal_and_is_quiet_elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "-q" in make_site.options()
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    assert "-q" not in make_site.options()
    assert {"-W", "--keep-going"} < set(make_site.options())


def test_every_page_is_in_the_navigation_once(files: dict[str, str | bytes]) -> None:
    listed = navigation(files)
    wanted = {re.sub(r"\.(md|rst)$", "", place) for place in files if place.endswith((".md", ".rst"))}
    wanted = {name for name in wanted if not name.startswith("files/") and name != "index"}
    assert len(wanted) > 50
    assert {name for name, count in listed.items() if count > 1} == set()
    assert wanted - set(listed) == set()


def test_a_page_that_is_listed_twice_or_nowhere_is_seen() -> None:
    tree = "```{toctree}\n:hidden:\n\na\nsub/*\na\n```\n"
    listed = navigation({"index.md": tree, "a.md": "", "b.md": "", "sub/c.md": "", "sub/deep/d.md": ""})
    assert listed == {"a": 2, "sub/c": 1}


def test_every_link_of_a_gathered_page_leads_to_a_page_of_the_site(files: dict[str, str | bytes]) -> None:
    found = 0
    for place, text in files.items():
        if place.endswith(".md") and isinstance(text, str):
            for is_prose, part in pages.parted(text):
                for link in pages.LINK.finditer(part) if is_prose and not place.startswith("files/") else ():
                    target, _, anchor = link["target"].partition("#")
                    if "://" in target:
                        continue
                    found += 1
                    goal = os.path.normpath(Path(place).parent / target) if target else place
                    assert goal in files or goal.startswith(pages.CATALOGUE), f"{place}: {link['target']}"
                    assert not anchor or anchor in anchors(str(files[goal])), f"{place}: {link['target']}"
    assert found > 200


def anchors(text: str) -> set[str]:
    """The anchors of a page's headings, as in GitHub and MyST."""
    heads = [
        line.lstrip("#").strip()
        for is_prose, part in pages.parted(text)
        if is_prose
        for line in re.findall(r"^#+ .*$", part, re.M)
    ]
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


def test_a_link_that_leads_nowhere_is_refused() -> None:
    page = ROOT / "docs" / "index.md"
    with pytest.raises(pages.LinkError, match=r"docs/index\.md: nosuch\.md leads nowhere"):
        pages.linked("see [this](nosuch.md)", page, "index.md", print)


def test_links_lead_where_the_site_has_the_page() -> None:
    page, shown = ROOT / "docs" / "how_to" / "laws.md", list[Path]()
    text = (
        "[a](../../CLAIMS.md#proof) [`b`](../../dmframe/common/errors.py) "
        "![c](../images/ur10_fast.png) [d](../../plants) "
        "[e](https://example.org) [f](../../README.md)\n```text\n[g](nosuch.md)\n```\n"
        ":::{note}\n[h](proofs.md)\n```console\n[i](nosuch.md)\n```\n:::\n[j](rank.md)"
    )
    assert pages.linked(text, page, "how_to/laws.md", shown.append) == (
        "[a](../CLAIMS.md#proof) [`b`](../files/dmframe/common/errors.py.md) ![c](../images/ur10_fast.png) d "
        "[e](https://example.org) [f](../index.md)\n```text\n[g](nosuch.md)\n```\n"
        ":::{note}\n[h](proofs.md)\n```console\n[i](nosuch.md)\n```\n:::\n[j](rank.md)"
    )
    assert shown == [ROOT / "dmframe" / "common" / "errors.py"]


def test_nothing_is_loaded_from_a_network(files: dict[str, str | bytes]) -> None:
    texts = {
        place: str(text)
        for place, text in files.items()
        if place.endswith((".md", ".rst")) and not place.startswith("files/")
    }
    own = [
        *(ROOT / "docs" / "_static").iterdir(),
        *(ROOT / "docs" / "site_parts").glob("*.py"),
        ROOT / "docs" / "conf.py",
    ]
    texts |= {
        str(path): path.read_text(encoding="utf-8") for path in own if path.suffix in (".py", ".css", ".js", ".svg")
    }
    prose = {
        place: PLAIN_LINK.sub("", "".join(part for is_prose, part in pages.parted(text) if is_prose))
        for place, text in texts.items()
    }
    assert {place: LOADS.findall(text) for place, text in prose.items() if LOADS.search(text)} == {}
    assert not [place for place, text in prose.items() if re.search(r"!\[[^\]]*\]\((?:https?:)?//", text)]


@pytest.mark.parametrize(
    "text",
    ['<img src="https://a.org/b.png">', "url(//fonts.org/x.woff2)", "@import 'x.css'", "<script src=//cdn.org/m.js>"],
)
def test_a_remote_resource_is_seen(text: str) -> None:
    assert LOADS.search(text)


def test_what_a_built_page_loads_from_a_network_is_found(tmp_path: Path) -> None:
    tmp_path.joinpath("good.html").write_text('<a href="https://a.org">a</a><img src="_images/b.png"><pre>url(x)</pre>')
    assert make_site.remote(tmp_path) == []
    tmp_path.joinpath("bad.html").write_text('<script async src="https://cdn.org/a.js"></script><link href=//b.org/c>')
    tmp_path.joinpath("bad.css").write_text("a { background: url('https://fonts.org/d.woff2') }")
    assert [text.split(" loads ")[0] for text in make_site.remote(tmp_path)] == ["bad.css", "bad.html", "bad.html"]


def test_the_configuration_sets_formulas_without_a_script() -> None:
    text = (ROOT / "docs" / "conf.py").read_text(encoding="utf-8")
    assert 'html_math_renderer = "dmframe"' in text
    assert "mathjax" not in text.lower()
    assert "nb_execution_raise_on_error = True" in text
    assert '"-W"' in (ROOT / "docs" / "make_site.py").read_text(encoding="utf-8")


def test_a_live_page_is_written_once_for_each_graph_and_its_settings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain, faster = live.graph_of("pendulum"), live.graph_of("pendulum", "dynamics.Gamma=20 clock='2 ms'")
    assert (faster.blocks["dynamics"].Gamma, faster.clock) == (20, 0.002)
    assert live.file_of(plain) == "live/pendulum.html"
    settings = "dynamics.Gamma=20 clock='2 ms'"
    assert re.fullmatch(r"live/pendulum-[0-9a-f]{8}\.html", live.file_of(faster, settings))
    other = live.graph_of("pendulum", "dynamics.Gamma=30")
    assert live.file_of(faster, settings) != live.file_of(other, "dynamics.Gamma=30")
    monkeypatch.setattr(type(plain), "page", lambda self: SimpleNamespace(html=f"<!doctype html>{self.name}"))
    path = live.write(plain, tmp_path / live.file_of(plain))
    assert path.read_text(encoding="utf-8") == "<!doctype html>pendulum"
    assert [item.name for item in path.parent.iterdir()] == ["pendulum.html"]


def test_a_live_page_is_embedded_lazily_with_its_title_a_still_picture_and_a_link() -> None:
    html = live.embedded("../live/a.html", 'A "b" < c', 700, still="../_images/a.png", command=["dmframe", "page", "a"])
    assert re.search(r'<iframe loading="lazy" title="A &quot;b&quot; &lt; c" src="../live/a.html" height="700">', html)
    assert "background-image:url(../_images/a.png)" in html
    assert '<a href="../live/a.html" target="_blank">' in html
    assert "<code>dmframe page a</code>" in html


def test_a_still_picture_is_copied_to_where_the_page_seeks_it(tmp_path: Path) -> None:
    picture, site = tmp_path / "a.png", tmp_path / "site"
    picture.write_bytes(b"a picture")
    assert (site / live.still(picture, site)).read_bytes() == b"a picture"
    assert live.still(picture, site) == "_images/a.png"


def test_formulas_are_aligned_and_numbered() -> None:
    html = mathematics.display(r"\dot w &= -\Lambda \tau \sigma \tag{1} \\ S &= \tfrac12 |w|^2 \tag{2}")
    assert html.count("<tr>") == 2
    assert re.findall(r"<td[^>]*><math", html) == ["<td><math", '<td class="last"><math'] * 2
    assert re.findall(r'class="tag">\((\w+)\)', html) == ["1", "2"]
    assert 'class="aligned"' in html


def test_a_long_formula_may_break_between_its_terms_alone() -> None:
    html = mathematics.display(r"\dot S &= -|s|^2_{K + B} - \left(a + b\right)^2 + c")
    assert [re.findall(r"<m[in]>(\w)<", piece) for piece in html.split("<wbr>")] == [
        ["S", "s", "K", "B", "2"],
        ["a", "b", "2"],
        ["c"],
    ]
    assert "<wbr>" not in mathematics.inline("a + b - c")


def test_a_matrix_keeps_its_own_rows() -> None:
    html = mathematics.display(r"\begin{aligned} A &= \begin{pmatrix} a & b \\ c & d \end{pmatrix} \end{aligned}")
    assert (html.count("<tr>"), html.count("<mtr>")) == (1, 2)


@pytest.mark.parametrize("latex", [r"\newcommand{\a}{b} \a", r"\frac{a", r"\nosuchcommand{x}"])
def test_a_formula_that_cannot_be_set_is_refused(latex: str) -> None:
    with pytest.raises(mathematics.MathError):
        mathematics.inline(latex)


def test_the_python_interface_lists_all_public_modules() -> None:
    reported = set(re.findall(r"(?<!`)`(dmframe\.\w+)`(?!`)", dmframe.__doc__ or ""))
    assert "dmframe.block" in reported
    texts = "\n".join(api.pages().values())
    assert [module for module in sorted(reported) if f"automodule:: {module}\n" not in texts] == []


def test_the_python_interface_documents_each_class_and_function_once() -> None:
    found = list[object]()
    for text in api.pages().values():
        for module, but in re.findall(
            r"automodule:: (\S+)\n   :members:\n(?:   :show.*\n)?(?:   :excl.*: (.*)\n)?", text
        ):
            names = [name for name in api.public(module) if name not in but.split(", ")]
            found += [getattr(importlib.import_module(module), name) for name in names]
        for name in re.findall(r"autoclass:: (\S+)", text):
            module, _, last = name.rpartition(".")
            found.append(getattr(importlib.import_module(module), last))
    found = [item for item in found if callable(item) and item is not Any]
    twice = [item for place, item in enumerate(found) if any(item is other for other in found[:place])]
    assert (len(found) > 100, twice) == (True, [])


def test_every_source_that_the_code_cites_is_on_the_page_of_references() -> None:
    text = references.text()
    cited = {
        key
        for path in (ROOT / "dmframe").rglob("*.py")
        for key in re.findall(r"\[([A-Z]\w+)\]_", path.read_text(encoding="utf-8"))
    }
    assert "WangTAC2020" in cited
    assert [key for key in sorted(cited) if f".. [{key}] " not in text] == []


def test_the_site_installs_what_the_configuration_names() -> None:
    group = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["dependency-groups"]["docs"]
    names = {re.split(r"[<>=]", line)[0].replace("-", "_") for line in group}
    extensions = set(
        re.findall(r'^    "(myst_nb|sphinx_\w+)",', (ROOT / "docs" / "conf.py").read_text(encoding="utf-8"), re.M)
    )
    assert len(extensions) == 3
    assert extensions | {"furo", "sphinx", "ipykernel"} == names
