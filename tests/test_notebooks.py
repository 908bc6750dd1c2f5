"""Every notebook is a short lesson with stored outputs, and runs (slow) with small parameters."""

import ast
import importlib
import importlib.util
from pathlib import Path

import pytest

nbformat = pytest.importorskip("nbformat")
nbclient = pytest.importorskip("nbclient")

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.ipynb"))
SHORT = {  # set after the parameter cell
    "1_one_gaussian": "SIZE, STEPS = 16, 8",
    "2_checking_gradients": "GAUSSIANS, SIZE, SWEEP = 12, 16, 5",
    "2b_other_renderers": "GAUSSIANS, SIZE, RAYED, PERSON, WINDOW, REPEATS = 8, 16, 4, 60, 24, 1",
    "3_refining_a_pose": "SIZE, STEPS, SWEEP, FRAMES, PASSES = 48, 20, 3, 3, 1",
    "3b_silhouettes": "SIZE, POSES, SEEDS, LINES, AROUND = 32, 1, 2, 1000, (4, 6)",
    "7_a_kernel": "SIZE, COUNT, PERSON, WINDOW, REPEATS = 16, 5, 500, 64, 2",
    "4_fitting_an_avatar": "SIZE, FRAMES, STEPS = 48, 9, 8",
    "5_reinitialising_on_the_surface": "SIZE, FRAMES, STEPS = 48, 9, 10",
    "6_an_ablation": "SIZE, FRAMES, STEPS, PASSES, ROWS = 48, 9, 10, 1, ROWS[::5]",
}
PARTS = ("overview", "setup", "reference", "initial state", "results", "see also")


def cells(notebook, kind):
    return [cell for cell in notebook.cells if cell.cell_type == kind]


def parameters(notebook):
    return [c for c in notebook.cells if "parameters" in c.metadata.get("tags", [])]


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path, monkeypatch):
    from traitlets.config import Config

    notebook = nbformat.read(path, as_version=4)
    (cell,) = parameters(notebook)
    cell.source += "\n" + SHORT[path.stem]
    monkeypatch.setenv("MPLBACKEND", "Agg")
    local = Config({"KernelManager": {"transport": "ipc"}})
    nbclient.NotebookClient(notebook, timeout=300, config=local).execute()


def test_every_notebook_is_a_short_lesson_with_small_outputs():
    for path in NOTEBOOKS:
        notebook = nbformat.read(path, as_version=4)
        text = "\n".join(cell.source for cell in cells(notebook, "markdown")).lower()
        places = [text.find(part) for part in PARTS]
        assert -1 not in places and places == sorted(places), path
        assert len(parameters(notebook)) == 1, path
        assert all(len(cell.source.splitlines()) <= 45 for cell in cells(notebook, "code")), path
        assert path.stat().st_size < 600_000, path
        outputs = [output for cell in cells(notebook, "code") for output in cell.outputs]
        assert any("image/png" in output.get("data", {}) for output in outputs), path
        assert not any(output.output_type == "error" for output in outputs), path


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
