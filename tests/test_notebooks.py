"""Every notebook is a short lesson whose outputs are those of its cells, and runs (slow)."""

import ast
import importlib
import importlib.util
import runpy
from pathlib import Path
from types import SimpleNamespace

import pytest

nbformat = pytest.importorskip("nbformat")
pytest.importorskip("nbclient")

from gva_mi.core.stamp import RESULTS_VERSIONS  # noqa: E402

FOLDER = Path(__file__).parents[1] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
tool = SimpleNamespace(**runpy.run_path(str(FOLDER / "execute.py")))
SHORT = {  # set after the parameter cell
    "1_one_gaussian": "SIZE, STEPS = 16, 8",
    "2_checking_gradients": "GAUSSIANS, SIZE, SWEEP = 12, 16, 5",
    "2b_other_renderers": "GAUSSIANS, SIZE, RAYED, PERSON, WINDOW, REPEATS = 8, 16, 4, 60, 24, 1",
    "3_refining_a_pose": "SIZE, STEPS, SWEEP, FRAMES, PASSES = 48, 20, 3, 3, 1",
    "3b_silhouettes": "SIZE, POSES, SEEDS, LINES, AROUND = 32, 1, 2, 1000, (4, 6)",
    "7_a_kernel": "SIZE, COUNT, PERSON, WINDOW, REPEATS = 16, 5, 500, 64, 2",
    "7b_reproducible_is_not_significant": "SIZE, COUNT, STEPS, RUNS = 16, 20, 12, 2",
    "7c_what_a_wrong_gradient_costs": "SIZE, COUNT, STEPS, SCENES, NUDGES = 16, 10, 3, 2, 1\n"
    "TALL, PASSES, PEOPLE, NUDGED = 48, 3, 2, 1",
    "4_fitting_an_avatar": "SIZE, FRAMES, STEPS = 48, 9, 8",
    "5_reinitialising_on_the_surface": "SIZE, FRAMES, STEPS = 48, 9, 10",
    "6_an_ablation": "",
    "9_a_phone_video": "SIDE, FRAMES, PASSES, STEPS = 192, 12, 1, 8",
    "10_a_scene": "SIZE, RAYS, ROWS, COLUMNS, STEPS = 48, 4, 3, 4, 2",
    "11_what_one_camera_sees": "SIZE, FRAMES, PASSES = 96, 9, 1",
    "8_hands": "SIZE, FRAMES, STEPS, PASSES = 128, 9, 10, 2",
}
PARTS = ("overview", "you will learn", "setup", "reference", "initial state", "results",
         "exercises", "see also")  # fmt: skip


def cells(notebook, kind):
    return [cell for cell in notebook.cells if cell.cell_type == kind]


def parameters(notebook):
    return [c for c in notebook.cells if "parameters" in c.metadata.get("tags", [])]


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path):
    notebook = nbformat.read(path, as_version=4)
    (cell,) = parameters(notebook)
    cell.source += "\n" + SHORT[path.stem]
    tool.run_cells(notebook, FOLDER, timeout=300)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_stored_outputs_are_those_of_the_cells(path):
    command = f"python notebooks/execute.py notebooks/{path.name}"
    assert not tool.is_stale(path), f"{path.name}: its outputs are stale; run `{command}`"


def test_whatever_changes_outputs_makes_them_stale(tmp_path, monkeypatch):
    code = nbformat.v4.new_code_cell('from gva_mi.fit import ssim\nprint(open("page.md").read())')
    text = nbformat.v4.new_markdown_cell("a page")
    notebook, path = nbformat.v4.new_notebook(cells=[text, code]), tmp_path / "reading.ipynb"
    page = tmp_path / "page.md"
    page.write_text("a table\n| 1 |\n")

    def stale():
        nbformat.write(notebook, path)
        return tool.is_stale(path)

    assert stale()  # never executed
    notebook.metadata["made_from"] = tool.made_from(notebook, path)
    text.source = "this page"
    page.write_text("a table of one figure\n| 1 |\n")
    assert not stale()
    page.write_text("a table\n| 2 |\n")
    assert stale()
    notebook.metadata["made_from"] = tool.made_from(notebook, path)
    code.source += "  # twice"
    assert stale()
    notebook.metadata["made_from"] = tool.made_from(notebook, path)
    monkeypatch.setitem(RESULTS_VERSIONS, "refine", RESULTS_VERSIONS["refine"] + 1)
    assert not stale()  # it refines nothing
    monkeypatch.setitem(RESULTS_VERSIONS, "avatar", RESULTS_VERSIONS["avatar"] + 1)
    assert stale()


def test_every_notebook_is_a_short_lesson_with_small_outputs():
    for path in NOTEBOOKS:
        notebook = nbformat.read(path, as_version=4)
        text = "\n".join(cell.source for cell in cells(notebook, "markdown")).lower()
        places = [text.find(part) for part in PARTS]
        assert -1 not in places and places == sorted(places), path
        assert "](https://" in text, path  # it cites
        assert len(parameters(notebook)) == 1, path
        assert all(len(cell.source.splitlines()) <= 45 for cell in cells(notebook, "code")), path
        assert path.stat().st_size < 600_000, path
        outputs = [output for cell in cells(notebook, "code") for output in cell.outputs]
        assert any("image/png" in output.get("data", {}) for output in outputs), path
        assert not any(output.output_type == "error" for output in outputs), path
        shown = [o.get("text", o.get("data", {}).get("text/plain", "")) for o in outputs]
        assert not any(" at 0x" in text for text in shown), path  # an address: never twice the same


def test_every_import_of_a_notebook_exists():
    missing = []
    for path in NOTEBOOKS:
        for cell in cells(nbformat.read(path, as_version=4), "code"):
            for node in ast.walk(ast.parse(cell.source)):
                if isinstance(node, ast.ImportFrom) and node.module.startswith("gva_mi"):
                    module = importlib.import_module(node.module)
                    missing += [f"{node.module}.{x.name}" for x in node.names
                                if not hasattr(module, x.name) and not importlib.util.find_spec(
                                    f"{node.module}.{x.name}")]  # fmt: skip
    assert not missing
