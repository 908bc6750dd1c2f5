"""What README and the pages of docs/ name is there, and links lead somewhere.

Their commands are read here and run in tests/docs.
"""

import importlib.util
import io
import re
import shlex
import shutil
import subprocess
import sys
from contextlib import redirect_stdout
from pathlib import Path

import pytest


def module_at(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


ROOT = Path(__file__).parents[1]
pages, site_pages = map(module_at, (ROOT / "tests/docs/pages.py", ROOT / "docs/site_pages.py"))
PAGES, BLOCKS, commands = pages.PAGES, pages.BLOCKS, pages.commands
PAGE = pytest.mark.parametrize("page", PAGES, ids=lambda path: str(path.relative_to(ROOT)))


def anchors(page):
    """What a forge calls the headings of a page."""
    heads = re.findall(r"^#+ (.*)", BLOCKS.sub("", page.read_text()), re.MULTILINE)
    heads = [re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads]
    return {*heads, *re.findall(r"^::: (\S+)", page.read_text(), re.MULTILINE)}


@PAGE
def test_every_command_is_one_of_the_command_line(page):
    """Parsed and not run. A verb alone, in backquotes, is a name."""
    from gva_mi.commands import VERBS, load
    from gva_mi.parse import parse

    for command in commands(page):
        verb, *arguments = shlex.split(command)[1:]
        if verb == "COMMAND":  # any
            continue
        assert verb in VERBS, command
        if arguments:
            try:
                parse(load(verb), f"gva-mi {verb}", arguments)
            except SystemExit:
                pytest.fail(f"{page.name}: {command}")


@pytest.fixture(scope="module")
def options():
    """All that the commands' --help names."""
    from gva_mi.commands import VERBS, load
    from gva_mi.parse import parse

    told = set()
    for verb in VERBS:
        for words in ([], ["refine"], ["avatar"]) if verb == "study" else ([],):
            page = io.StringIO()
            with redirect_stdout(page), pytest.raises(SystemExit):
                parse(load(verb), f"gva-mi {verb}", [*words, "--help"])
            told |= set(re.findall(r"--[a-z][\w.-]*\w", page.getvalue()))
    return told


@PAGE
def test_every_option_that_is_named_alone_is_one(page, options):
    """A switch is given or not, and takes no True or False."""
    named = re.findall(r"`(--[a-z][\w.-]*\w)( [^`]*)?`", BLOCKS.sub("", page.read_text()))
    for name, value in named:
        assert name in options, f"{page.name}: {name}"
        assert value.strip() not in ("True", "False"), f"{page.name}: {name}{value}"


def test_a_wrong_command_is_found(tmp_path):
    (tmp_path / "page.md").write_text("```sh\ngva-mi fit subject --outt run   # a slip\n```\n")
    with pytest.raises(pytest.fail.Exception, match="--outt run"):
        test_every_command_is_one_of_the_command_line(tmp_path / "page.md")


def test_the_table_of_kinds_is_whole():
    from gva_mi.data.importers.datasets import DATASETS
    from gva_mi.data.importers.estimators import KINDS

    text = (ROOT / "docs/sources.md").read_text()
    for kind in (*KINDS, *DATASETS):
        assert f"\n| `{kind}` | " in text, kind


def test_the_families_of_noise_and_the_extras_are_all_there():
    import tomllib

    from gva_mi.data.synthetic.noise.families import FAMILIES

    people, installation = (
        (ROOT / "docs" / n).read_text() for n in ("people.md", "installation.md")
    )
    for family in FAMILIES:
        assert f"`{family}`" in people, family
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    for extra in project["optional-dependencies"]:
        assert f"\n| `{extra}` | " in installation, extra


PROGRAMS = [  # those of plugins.md below its first heading are run by tests/plugins
    ((ROOT / "docs" / name).read_text().partition(end)[0], name)
    for name, end in (("splatting.md", "## Conventions"), ("plugins.md", "\n## "))
]


@pytest.mark.parametrize("text, name", PROGRAMS, ids=[name for _, name in PROGRAMS])
def test_the_programs_run(text, name):
    (program,) = [block for kind, block in BLOCKS.findall(text) if kind == "python"]
    exec(compile(program, name, "exec"), {})


@PAGE
def test_every_link_leads_to_a_file(page):
    for link in site_pages.links(page.read_text()):
        assert (page.parent / link).is_file(), link  # of a folder the site has no page


@PAGE
def test_every_link_within_pages_leads_to_a_heading(page):
    text = BLOCKS.sub("", page.read_text())
    for link, anchor in re.findall(r"\]\(([^)\s#:]*)#([^)\s]+)\)", text):
        target = page.parent / link if link else page
        assert anchor in anchors(target), f"{link}#{anchor}"


def test_every_page_is_in_the_menu():
    """And what the menu names is there: a page, or a lesson or a page that hooks add."""
    menu = (ROOT / "mkdocs.yml").read_text().partition("\nnav:")[2].partition("\nplugins:")[0]
    named = set(re.findall(r": ([\w/.]+\.md)$", menu, re.MULTILINE))
    pages = {str(page.relative_to(ROOT / "docs")) for page in PAGES[1:]}
    lessons = {f"notebooks/{path.name}" for path in (ROOT / "notebooks").glob("*.ipynb")}
    assert named == pages | {
        site_pages.page_of(name) for name in (*lessons, *site_pages.AT_THE_TOP)
    }


MODULES = [
    name for page in PAGES for name in re.findall(r"^::: (\S+)$", page.read_text(), re.MULTILINE)
]


@pytest.mark.parametrize("name", MODULES)
def test_every_module_of_the_reference_is_there(name):
    """The site is built where mkdocs is; a module that has moved is found without it."""
    path = Path(*name.replace("gva_mi_plugins", "plugins").split("."))
    assert (ROOT / path).with_suffix(".py").is_file() or (ROOT / path / "__init__.py").is_file()


@pytest.mark.slow
def test_the_site_is_built(tmp_path):
    """Strictly: a link, an anchor or a docstring that is wrong ends it."""
    own = Path(sys.executable).parent / "mkdocs"
    mkdocs = own if own.exists() else shutil.which("mkdocs")
    if mkdocs is None:
        pytest.skip("mkdocs is not installed: pip install 'gva_mi[docs]'")
    build = [mkdocs, "build", "--strict", "--quiet", "--site-dir", tmp_path]
    done = subprocess.run(build, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    index, page = ((tmp_path / name).read_text() for name in ("index.html", "splatting.html"))
    assert "overview.png" in index and "\\tag" not in page and page.count("<math") > 100
    assert 'href="source/gva_mi/splat/kernels/pixel.py.html"' in page
    assert "(N, 3)" in (tmp_path / "api/splat.html").read_text()
