"""Hooks of mkdocs: pages that are files of the repository, formulas as MathML, drawings as SVG.

On the forge, pages link to code and lessons by relative paths. On the site, such a link leads to a
page that shows the file: ``../gva_mi/core/llvm.py`` becomes
``source/gva_mi/core/llvm.py.md``. README.md is the page ``demo.md``, and CHANGELOG.md is
``changes.md``. Formulas become MathML, and drawings SVG: the site needs no script for them, and no
network. The font of the formulas is STIX Two Math (OFL), which the package ziamath brings.
"""

from __future__ import annotations

import html
import itertools
import json
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[1]
AT_THE_TOP = {"README.md": "demo.md", "CHANGELOG.md": "changes.md"}  # pages of Markdown already
SHOWN_AS_THEY_ARE = (".md", ".png", ".webp")  # of docs/
_FENCES = re.compile(r"^(```+).*?^\1", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"(\]\()(?!\w+:)([^)\s#]+)((?:#[^)\s]*)?\))")  # a relative one
_FORMULA = re.compile(
    r'<(div|span) class="arithmatex">\s*\\[\[(](.*?)\\[\])]\s*</\1>', re.DOTALL
)  # as pymdownx.arithmatex leaves them
_kept: list[tempfile.TemporaryDirectory] = []  # until the process ends
_TAG = re.compile(r"\\tag\{(.*?)\}")
_DRAWING = re.compile(r'<pre class="mermaid"><code>(.*?)</code></pre>', re.DOTALL)
FONT = "STIXTwoMath-Regular.ttf"  # that site.css names


def links(markdown: str) -> list[str]:
    """Return the relative links and pictures of a page, without anchors; programs do not count."""
    return [match[2] for match in _LINK.finditer(_FENCES.sub("", markdown))]


def source_of(folder: Path, link: str) -> str | None:
    """Return the path in the repository of a linked file; None if the site has it as a page."""
    path = (folder / link).resolve()
    own = path.is_relative_to(ROOT / "docs") and path.suffix in SHOWN_AS_THEY_ARE
    if own or not path.is_relative_to(ROOT) or not path.is_file():
        return None
    return path.relative_to(ROOT).as_posix()


def page_of(source: str) -> str:
    """Return the page of the site that shows a file of the repository."""
    return AT_THE_TOP.get(source, f"source/{source}.md")


def shown(source: str) -> str:
    """Return a file of the repository as Markdown: a program with line numbers, or a lesson."""
    text = (ROOT / source).read_text()
    if source.endswith(".ipynb"):
        return "\n\n".join(_cells(json.loads(text)))
    kind = {".py": "python", ".toml": "toml"}.get(Path(source).suffix, "text")
    return f'# {source}\n\n~~~~~~{kind} linenums="1"\n{text}\n~~~~~~\n'


def _cells(notebook: dict) -> Iterator[str]:
    for cell in notebook["cells"]:
        text = "".join(cell["source"])
        yield text if cell["cell_type"] == "markdown" else f"~~~~~~python\n{text}\n~~~~~~"
        for output in cell.get("outputs", ()):
            data = output.get("data", {})
            said = "".join(output.get("text", ())) or "".join(data.get("text/plain", ()))
            if "image/png" in data:
                picture = "".join(data["image/png"]).replace("\n", "")
                yield f"![what the cell draws](data:image/png;base64,{picture})"
            elif said:
                yield f"~~~~~~text\n{said}\n~~~~~~"


def mathml(page: str) -> str:
    """Convert a page's formulas to MathML; ``\\tag`` becomes the number at the right."""
    from latex2mathml.converter import convert

    def one(match: re.Match[str]) -> str:
        latex, block = html.unescape(match[2]), match[1] == "div"
        if not block:
            return convert(latex)
        tag = _TAG.search(latex)
        number = f"<span>({tag[1]})</span>" if tag else ""
        return f'<div class="formula">{convert(_TAG.sub("", latex), display="block")}{number}</div>'

    return _FORMULA.sub(one, page)


def drawings(page: str) -> str:
    """Draw a page's Mermaid flowcharts, by Mermaid itself."""
    import mermaidx

    numbers = itertools.count()

    def one(match: re.Match[str]) -> str:
        svg = mermaidx.render(html.unescape(match[1])).svg()
        return f'<div class="drawing">{svg.replace("my-svg", f"drawing-{next(numbers)}")}</div>'

    return _DRAWING.sub(one, page)


def on_config(config: MkDocsConfig) -> None:
    """Let mkdocstrings find ``gva_mi_plugins``, whose folder is ``plugins/``."""
    _kept.append(tempfile.TemporaryDirectory(prefix="gva_mi_docs_"))
    folder = Path(_kept[-1].name)
    (folder / "gva_mi_plugins").symlink_to(ROOT / "plugins")
    config.plugins["mkdocstrings"].config["handlers"]["python"]["paths"] = [str(ROOT), str(folder)]


on_config.mkdocs_priority = 100  # before mkdocstrings reads its own configuration


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add a page for each file of the repository that a page links to, and the formulas' font."""
    import ziamath
    from mkdocs.structure.files import File

    font = Path(ziamath.__file__).parent / "fonts" / FONT
    files.append(File.generated(config, FONT, abs_src_path=str(font)))

    lessons = {path.relative_to(ROOT).as_posix() for path in (ROOT / "notebooks").glob("*.ipynb")}
    sources = lessons | set(AT_THE_TOP)
    pages = [(Path(f.abs_src_path).parent, f.content_string) for f in files.documentation_pages()]
    pages += [(ROOT / "notebooks", shown(lesson)) for lesson in lessons]
    pages += [(ROOT, (ROOT / page).read_text()) for page in AT_THE_TOP]
    for folder, text in pages:
        found = (source_of(folder, link) for link in links(text))
        sources.update(source for source in found if source)
    for source in sorted(sources):
        text = (ROOT / source).read_text() if source in AT_THE_TOP else shown(source)
        files.append(File.generated(config, page_of(source), content=text))
    return files


def on_page_markdown(markdown: str, page: Page, **_: object) -> str:
    """Redirect links from files of the repository to the pages that show them."""
    uri = page.file.src_uri
    if uri.startswith("source/") and not uri.startswith("source/notebooks/"):
        return markdown
    at_home = page.file.abs_src_path
    if at_home:
        folder = Path(at_home).parent
    else:
        folder = ROOT if uri in AT_THE_TOP.values() else ROOT / "notebooks"
    up = "../" * uri.count("/")

    def turned(match: re.Match[str]) -> str:
        source = source_of(folder, match[2])
        if source is None and at_home:
            return match[0]
        path = (folder / match[2]).resolve()
        if source is None and path.is_relative_to(ROOT / "docs"):  # from outside into docs/
            return f"{match[1]}{up}{path.relative_to(ROOT / 'docs').as_posix()}{match[3]}"
        return f"{match[1]}{up}{page_of(source)}{match[3]}" if source else match[0]

    return _LINK.sub(turned, markdown)


def on_page_content(html: str, **_: object) -> str:
    """Convert formulas to MathML and drawings to SVG."""
    return drawings(mathml(html))
