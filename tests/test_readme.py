"""README and docs name commands, options, files and links that exist; their programs run.

README's other command, ``avatar``, needs a video of a person: tests/cli/test_avatar.py makes one.
"""

import doctest
import io
import json
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from contextlib import redirect_stdout
from pathlib import Path
from types import SimpleNamespace

import cells
import pytest
import tables

ROOT = Path(__file__).parents[1]
site_pages = SimpleNamespace(**runpy.run_path(str(ROOT / "docs/site_pages.py")))
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def _number(path):
    """Return the number of a lesson, and the letter behind it."""
    return int(re.match(r"\d+", path.name)[0]), path.name.partition("_")[0]


LESSONS = sorted((ROOT / "notebooks").glob("*.ipynb"), key=_number)
INDEX = ROOT / "docs/lessons.md"
BLOCKS = re.compile(r"```(\w*)\n(.*?)```", re.DOTALL)
LINE = re.compile(r"^gva-mi .*?(?=\s*(?:#[ ].*)?$)", re.MULTILINE)
QUICK = {  # options that make the commands of docs/steps.md quick
    "synth": "--size 48 --frames 4",
    "refine": "--passes 1 --size 32",
    "fit": "--steps 20",
    "track": "--passes 1",
}


def text_of(page):
    """Return a page's text, or the text cells of a lesson; commands on one line."""
    text = page.read_text()
    if page.suffix == ".ipynb":
        cells = [cell for cell in json.loads(text)["cells"] if cell["cell_type"] == "markdown"]
        text = "\n\n".join("".join(cell["source"]) for cell in cells)
    return text.replace("\\\n", " ")


def in_blocks(page):
    """Return the commands in the shell blocks of a page."""
    blocks = BLOCKS.findall(text_of(page))
    return [line for kind, block in blocks if kind == "sh" for line in LINE.findall(block)]


def commands(page):
    """Yield the commands of a page: lines of its shell blocks, and words in backquotes."""
    yield from in_blocks(page)
    for written in re.findall(r"`([^`\n]+)`", BLOCKS.sub("", text_of(page))):
        if written.startswith("gva-mi "):
            # Optional options are read, too.
            yield re.sub(r"\[(--\w.*?)\]", r"\1", written)


def anchors(page):
    """Return the anchors that a forge gives to the headings of a page."""
    heads = re.findall(r"^#+ (.*)", BLOCKS.sub("", text_of(page)), re.MULTILINE)
    heads = [re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads]
    return {*heads, *re.findall(r"^::: (\S+)", page.read_text(), re.MULTILINE)}


def misunderstood(page):
    """Yield the commands of a page that cannot be parsed; a verb alone in backquotes is a name."""
    from gva_mi.cli import VERBS, load
    from gva_mi.cli.parse import parse

    for command in commands(page):
        verb, *arguments = shlex.split(command)[1:]
        if verb == "COMMAND":  # any
            continue
        if verb not in VERBS:
            yield f"{page.name}: {command}: there is no such command"
        elif arguments:
            try:
                parse(load(verb), verb, arguments)
            except (SystemExit, ValueError) as error:
                yield f"{page.name}: {command}: {error}"


def test_every_command_is_understood():
    assert not [failure for page in (*PAGES, *LESSONS) for failure in misunderstood(page)]


def test_the_index_has_every_lesson_and_the_minutes_of_its_reading():
    index = re.findall(r"\(\.\./(notebooks/.*?)\).*\| (\d+) \|$", INDEX.read_text(), re.MULTILINE)
    assert [name for name, _ in index] == [f"notebooks/{path.name}" for path in LESSONS]
    for name, minutes in index:
        code = [
            c for c in json.loads((ROOT / name).read_text())["cells"] if c["cell_type"] == "code"
        ]
        lines = sum(len("".join(cell["source"]).splitlines()) for cell in code)
        words = len(text_of(ROOT / name).split())
        assert abs(int(minutes) - (words / 200 + lines / 30)) < 1, name


def test_study_all_runs_the_studies_of_the_documents():
    from gva_mi.cli.study import STUDIES

    for line in (line for page in PAGES for line in in_blocks(page)):
        words = shlex.split(line)
        if words[:2] == ["gva-mi", "study"] and words[2] in ("refine", "avatar", "relight"):
            at = words.index("--out")
            if words[at + 1] != "study":  # an example's folder
                written = shlex.split(STUDIES[words[at + 1]])
                assert written == words[2:at] + words[at + 2 :], line


def unmarked(text):
    """Yield the first lines of tables that show figures and are not written by docs/tables.py."""
    for found in re.finditer(r"(.*)\n\n((?:^\|.*\n)+)", BLOCKS.sub("", text), re.MULTILINE):
        above, lines = found[1], found[2].splitlines()
        written = [cell.strip() for line in lines[2:] for cell in line.strip("|").split("|")]
        if not above.startswith(("<!-- figures of ", "<!-- quoted")):
            if any(re.fullmatch(r"[+−~]?\d[\d.,]*( (%|dB|mm))?", cell) for cell in written):
                yield lines[0]


def test_the_tables_of_figures_are_written_from_the_figures_of_the_studies():
    writer = cells.Writer(tables.load())
    assert not tables.unequal(tables.load())
    wrong = [
        page.name for page in PAGES if tables.written(page.read_text(), writer) != page.read_text()
    ]
    assert not wrong, f"run `python docs/tables.py`: {wrong}"
    named = [match[1] for page in PAGES for match in tables.MARKED.findall(page.read_text())]
    assert sorted(named) == sorted(tables.TABLES)
    assert writer.used == set(range(len(writer.figures)))  # none that no table shows
    for page in (ROOT / "README.md", ROOT / "docs/studies.md", ROOT / "docs/paper.md"):
        assert not list(unmarked(page.read_text())), page.name


def test_a_wrong_figure_and_an_unmarked_table_are_found():
    page = "<!-- figures of eq8 -->\n\n| | mm |\n|---|---|\n| refined | 1234.5 |\n"
    assert "1234.5" not in tables.written(page, cells.Writer(tables.load()))
    assert list(unmarked("text\n\n| a | b |\n|---|---|\n| refined | 1234.5 |\n")) == ["| a | b |"]
    assert not list(unmarked(page))


def test_cells_are_means_over_subjects_differences_and_ranges():
    values = {("1", "kept"): 30.0, ("1", "relit"): 33.0, ("2", "kept"): 20.0, ("2", "relit"): 21.0}
    named = {"study": "s", "row": "", "variant": "v", "split": "test", "region": "white"}
    writer = cells.Writer([
        named | {"subject": s, "alignment": way, "metric": "PSNR, dB", "value": str(value)}
        for (s, way), value in values.items()
    ])  # fmt: skip
    column = cells.part("relit", tables.psnr("test", "relit"), study="s")
    shown = tables.psnr("test", "relit", form="+.1f", join=" … ", of=cells.extremes,
                        minus={"alignment": "kept"})  # fmt: skip
    gain = cells.part("gain", shown, study="s")
    found = cells.Table(
        "", [cells.part("v", variant="v"), cells.part("w", variant="w")], [column, gain]
    )
    assert writer.table(found).splitlines()[2:] == ["| v | 27.0 | +1.0 … +3.0 |", "| w | – | – |"]
    assert cells.number(-0.02, cells.Shown("", form="+.1f")) == "0.0"
    assert cells.number(-0.26, cells.Shown("", form="+.0f", scale=100)) == "−26"


def test_a_wrong_command_is_found(tmp_path):
    (tmp_path / "page.md").write_text("```sh\ngva-mi fit subject --outt run   # a slip\n```\n")
    assert any("--outt run" in failure for failure in misunderstood(tmp_path / "page.md"))


def test_every_option_named_alone_exists():
    """A switch takes no value True or False."""
    from gva_mi.cli import VERBS, load
    from gva_mi.cli.parse import parse

    options = set()
    for verb in VERBS:
        studies = ([], ["refine"], ["avatar"], ["relight"], ["multiview"])
        for words in studies if verb == "study" else ([],):
            page = io.StringIO()
            with redirect_stdout(page), pytest.raises(SystemExit):
                parse(load(verb), verb, [*words, "--help"])
            options |= set(re.findall(r"--[a-z][\w.-]*\w", page.getvalue()))
    wrong = []
    for page in PAGES:
        named = re.findall(r"`(--[a-z][\w.-]*\w)( [^`]*)?`", BLOCKS.sub("", page.read_text()))
        wrong += [
            f"{page.name}: {name}{value}" for name, value in named
            if name not in options or value.strip() in ("True", "False")
        ]  # fmt: skip
    assert not wrong


def test_tables_list_every_source_error_model_and_extra():
    import tomllib

    from gva_mi.readers.datasets import DATASETS
    from gva_mi.readers.estimators import KINDS
    from gva_mi.synthetic.errors.models import ERROR_MODELS

    sources, people, installation = (
        (ROOT / "docs" / n).read_text()
        for n in ("sources.md", "synthetic_subjects.md", "installation.md")
    )
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert not [kind for kind in (*KINDS, *DATASETS) if f"\n| `{kind}` | " not in sources]
    assert not [name for name in ERROR_MODELS if f"`{name}`" not in people]
    extras = project["optional-dependencies"]
    assert not [extra for extra in extras if f"\n| `{extra}` | " not in installation]


def test_the_steps_run_one_after_the_other(tmp_path, cli, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for command in in_blocks(ROOT / "docs/steps.md"):
        verb, *words = shlex.split(command)[1:]
        small = ["--size", "32", "48"] if "--path" in words else shlex.split(QUICK.get(verb, ""))
        cli.works(verb, *words, *small)
    assert (tmp_path / "renders/video.mp4").exists() and (tmp_path / "run/report.html").exists()
    assert (tmp_path / "turntable/000071.png").exists() and (tmp_path / "person.glb").exists()


def test_readmes_program_leads_from_a_video_to_an_avatar(tmp_path, subject, monkeypatch):
    """On a tiny subject that was prepared before, with options that make it quick.

    The examples of the steps are skipped in test_examples.py: here is what they need.
    """
    from gva_mi import app
    from gva_mi.app import steps
    from gva_mi.fit.options import FitOptions
    from gva_mi.fit.photometric import PhotometricOptions
    from gva_mi.fit.renders import CameraPath
    from gva_mi.refine.sequence import SequenceOptions

    (program,) = (
        block for kind, block in BLOCKS.findall((ROOT / "README.md").read_text())
        if kind == "python" and "gva_mi.app" in block
    )  # fmt: skip
    monkeypatch.chdir(tmp_path)
    examples = {
        name: doctest.DocTestParser().get_doctest(step.__doc__, vars(steps).copy(), name, "", 0)
        for name, step in vars(app).items() if name in app.__all__ and name in vars(steps)
    }  # fmt: skip
    for name in ("prepare", "fit", "evaluate"):
        (line,) = examples[name].examples
        assert line.source.partition("  #")[0].rpartition(" = ")[2] in program.splitlines()
    monkeypatch.setattr(app, "prepare", lambda video, out: shutil.copytree(subject, out))
    for step, options in (
        (app.refine, SequenceOptions(passes=1, size=32)), (app.fit, FitOptions(steps=20)),
        (app.render, CameraPath(frames=2, size=(32, 48))),
        (app.track, PhotometricOptions(passes=1)),
    ):  # fmt: skip
        monkeypatch.setattr(step, "__defaults__", (options,))
    exec(compile(program, "README.md", "exec"), {})
    assert (tmp_path / "me/run/report.html").exists()
    assert (tmp_path / "me/turntable/000001.png").exists()
    monkeypatch.setattr("gva_mi.app.steps.say", lambda line: None)  # examples show no such lines
    for name in ("check", "track"):
        for line in examples[name].examples:
            line.options.clear()  # no longer skipped
        assert not doctest.DocTestRunner().run(examples[name]).failed


@pytest.mark.parametrize(
    ("name", "end"),
    [("splatting.md", "## Conventions"), ("plugins.md", "\n## "), ("gradients.md", "## Five")],
)
def test_python_programs_run(name, end):
    """Programs of plugins.md below its first heading are run by tests/plugins."""
    text = (ROOT / "docs" / name).read_text().partition(end)[0]
    programs = [block for kind, block in BLOCKS.findall(text) if kind == "python"]
    assert programs
    for program in programs:
        exec(compile(program, name, "exec"), {})


def dead_links(page):
    """Yield the relative links of a page or lesson that have no page on the site, or no heading."""
    text = BLOCKS.sub("", text_of(page))
    for link in site_pages.links(text):  # a folder has no page, nor has a file beside the project
        path = (page.parent / link).resolve()
        if not path.is_file() or not path.is_relative_to(ROOT):
            yield f"{page.name}: {link}"
    for link, anchor in re.findall(r"\]\(([^)\s#:]*)#([^)\s]+)\)", text):
        to = page.parent / link if link else page
        if to.is_file() and anchor not in anchors(to):
            yield f"{page.name}: {link}#{anchor}"


def not_in_the_menu(menu, pages):
    """Return the pages that only the menu or only the site has; hooks add lessons and others."""
    named = set(re.findall(r": ([\w/.]+\.md)$", menu, re.MULTILINE))
    lessons = {f"notebooks/{path.name}" for path in LESSONS}
    hooks = {site_pages.page_of(name) for name in (*lessons, *site_pages.AT_THE_TOP)}
    return named ^ ({str(page.relative_to(ROOT / "docs")) for page in pages} | hooks)


def test_every_link_leads_to_a_file_or_a_heading():
    pages = (*PAGES, *LESSONS, ROOT / "CHANGELOG.md")
    assert not [link for page in pages for link in dead_links(page)]


def test_the_menu_and_the_pages_agree():
    menu = (ROOT / "mkdocs.yml").read_text().partition("\nnav:")[2].partition("\nplugins:")[0]
    assert not not_in_the_menu(menu, PAGES[1:])
    assert not_in_the_menu(menu.replace("paper.md", "papers.md"), PAGES[1:]) == {
        "paper.md", "papers.md"
    }  # fmt: skip


def test_faults_that_stop_the_building_of_the_site_are_found_without_it(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(
        "# Head\n\n[a](#head) [b](#heads) [c](gone.md) [d](page.md#no) [e](https://x.org/#y)\n\n"
        "```sh\n# [in a program](nowhere.md)\n```\n"
    )
    outside = "page.md: page.md"  # it is there, but not in the project
    assert sorted(dead_links(page)) == sorted(
        ["page.md: #heads", "page.md: gone.md", outside, "page.md: page.md#no"]
    )


def test_every_module_of_the_reference_exists():
    for page in PAGES:
        for name in re.findall(r"^::: (\S+)$", page.read_text(), re.MULTILINE):
            path = ROOT / Path(*name.replace("gva_mi_plugins", "plugins").split("."))
            assert path.with_suffix(".py").is_file() or (path / "__init__.py").is_file(), name


@pytest.mark.slow
def test_the_site_is_built(tmp_path):
    """Strictly: a wrong link, anchor or docstring is an error."""
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
    drawn = (tmp_path / "architecture.html").read_text()  # without a network
    assert drawn.count("<svg id=") == 4 and 'class="mermaid"' not in drawn
    assert (tmp_path / site_pages.FONT).exists() and site_pages.FONT in (
        tmp_path / "site.css"
    ).read_text()
