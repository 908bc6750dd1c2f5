"""Execute the lessons, and store with the outputs what they were made from.

    python notebooks/execute.py                 each lesson whose outputs are stale
    python notebooks/execute.py notebooks/1*    these lessons

Outputs are stale if a code cell, a file that a cell names, or the results version of a package that
a cell imports (:data:`gva_mi.core.stamp.RESULTS_VERSIONS`) have changed since they were made.
Of a page, only the tables count; of figures.csv, only the studies that a cell names.
``tests/test_notebooks.py`` finds stale outputs without a kernel.
"""

import base64
import hashlib
import io
import os
import re
import sys
import tempfile
import time
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from PIL import Image
from traitlets.config import Config

from gva_mi.core.stamp import RESULTS_VERSIONS

HERE = Path(__file__).parent
STAMP = "made_from"  # in a notebook's metadata
# Packages that make each kind of results.
RESULTS = {"video": "gva_mi.stage1", "refine": "gva_mi.refine", "avatar": "gva_mi.fit"}


def made_from(notebook, path):
    """Return what outputs depend on: code, files that it names, the program's results."""
    code = [cell.source for cell in notebook.cells if cell.cell_type == "code"]
    named = {
        name for source in code for name in re.findall(r'"([\w./-]+\.(?:csv|json|md))"', source)
    }
    there = sorted(name for name in named if (path.parent / name).is_file())
    return {
        "cells": [_digest(source.encode()) for source in code],
        "figures": {name: _digest(_figures_of(path.parent / name, code)) for name in there} or None,
        "results_versions": {
            kind: RESULTS_VERSIONS[kind]
            for kind, package in RESULTS.items()
            if any(f"from {package}" in source for source in code)
        },
    }


def _digest(content):
    return hashlib.sha256(content).hexdigest()[:16]


def _figures_of(path, code):
    lines = path.read_bytes().splitlines()
    if path.suffix == ".csv":  # of the studies that the code names
        lines = [x for x in lines if any(f'"{x.decode().split(",")[0]}"' in cell for cell in code)]
    return b"\n".join(x for x in lines if path.suffix != ".md" or x.startswith(b"|"))


def is_stale(path):
    """Return whether a lesson's outputs were made from something else than is there now."""
    notebook = nbformat.read(path, as_version=4)
    return notebook.metadata.get(STAMP) != made_from(notebook, path)


def run_cells(notebook, folder, timeout=None):
    """Execute a notebook's cells in place, in a folder; seconds a cell, None: no limit."""
    os.environ["MPLBACKEND"] = "module://matplotlib_inline.backend_inline"  # keep the figures
    with tempfile.TemporaryDirectory() as sockets:  # no ports, which need a network
        kernel = {"KernelManager": {"transport": "ipc", "ip": f"{sockets}/kernel"}}
        place = {"metadata": {"path": str(folder)}}
        client = NotebookClient(notebook, timeout=timeout, config=Config(kernel), resources=place)
        client.execute()


def shrink_pictures(notebook):
    """Store pictures with 256 colours, which is a third of the size and looks the same."""
    for cell in notebook.cells:
        for output in cell.get("outputs", ()):
            if (png := output.get("data", {}).get("image/png")) is not None:
                shrunk = io.BytesIO()
                picture = Image.open(io.BytesIO(base64.b64decode(png))).convert("RGB")
                picture.quantize(256).save(shrunk, "PNG", optimize=True)
                output["data"]["image/png"] = base64.b64encode(shrunk.getvalue()).decode()


def execute(path):
    """Execute a lesson and write its outputs and their stamp; a failure leaves the file alone."""
    notebook, start = nbformat.read(path, as_version=4), time.perf_counter()
    run_cells(notebook, path.parent)
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)  # times, which differ from run to run
    shrink_pictures(notebook)
    notebook.metadata.language_info = {"name": "python"}
    notebook.metadata[STAMP] = made_from(notebook, path)
    nbformat.write(notebook, path)
    print(f"{path.name}: {time.perf_counter() - start:.0f} s, {path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    lessons = [Path(name) for name in sys.argv[1:]] or sorted(
        filter(is_stale, HERE.glob("*.ipynb"))
    )
    for lesson in lessons:
        execute(lesson)
