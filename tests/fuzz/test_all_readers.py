"""No reader is forgotten: whatever opens a file has been tried with good ones, and with bad ones.

Functions that open files are found in the program's text; that the seeds reach them is seen as
their good files are read.
"""

import ast
import sys
from pathlib import Path

import pytest

from gva_mi.data.importers.datasets import DATASETS
from gva_mi.data.importers.estimators import KINDS
from gva_mi.splat.formats import LOAD

ROOT = Path(__file__).parents[2]
OPEN = {  # names under which files are opened for reading
    "open", "read_bytes", "read_text", "fromfile", "memmap", "ZipFile", "File", "from_pretrained",
    "InferenceSession", "read_array", "read_arrays", "read_json", "read_objects", "read_image",
    "rows_of_hdf5", "read_hdf5", "decoded", "opened",
}  # fmt: skip
OPEN_OF = {("np", "load"), ("torch", "load"), ("jit", "load")}
NOT_A_USERS = {  # functions that read what is no user's file, or not as data; and why
    "gva_mi/core/lock.py": "the lock's own file, whose words a test of its own bends",
    "gva_mi/__main__.py": "/dev/null",
    "gva_mi/core/provenance.py": "this program, and bytes that are hashed",
    "gva_mi/study/scores.py": "bytes that are hashed",
    "gva_mi/data/importers/by_networks.py": "pictures that prepare has just written",
    "gva_mi/synthetic/estimates.py _true_pictures": "pictures that synth has just written",
    "gva_mi/core/cpu.py": "this machine's own words about itself",
    "gva_mi/data/networks/normals.py _torch_script": "a program, trusted as one: networks.py",
    "gva_mi/data/pictures.py write_movie": "is written",
    "gva_mi/data/pictures.py write_see_through": "is written",
    "gva_mi/cli/render.py render": "pictures that render has written before it was cut short",
    "gva_mi/avatar/formats/glb.py": "is written",
}


def opens(node):
    """Whether a call opens a file to read it."""
    name = node.func
    if isinstance(name, ast.Attribute):
        of = name.value.id if isinstance(name.value, ast.Name) else getattr(name.value, "attr", "")
        return name.attr in OPEN or (of, name.attr) in OPEN_OF
    return isinstance(name, ast.Name) and name.id in OPEN


def functions(path):
    """Name and first line of the outermost functions in a file that open one."""
    found = {}

    def look(node, outer):
        inside = isinstance(node, ast.FunctionDef)
        outer = node if inside and outer is None else outer
        if isinstance(node, ast.Call) and outer is not None and opens(node):
            found[outer.lineno] = outer
        for child in ast.iter_child_nodes(node):
            look(child, outer)

    look(ast.parse(path.read_text()), None)
    decorated = lambda node: min([node.lineno, *(d.lineno for d in node.decorator_list)])
    return {decorated(node): node.name for node in found.values()}


READERS = {
    (path, line): name
    for path in sorted((ROOT / "gva_mi").rglob("*.py"))
    for line, name in functions(path).items()
}


def named(path, name):
    return f"{path.relative_to(ROOT)} {name}"


def test_functions_that_open_files_are_found():
    names = {named(path, name) for (path, _), name in READERS.items()}
    assert {
        "gva_mi/body/pose.py read_pose_file", "gva_mi/splat/formats/spz.py load_spz",
        "gva_mi/data/importers/multi_view.py _yaml", "gva_mi/fit/run_folder.py load_state",
        "gva_mi/data/importers/hdf5.py _opened", "gva_mi/data/networks/sam_weights.py load_network",
    } <= names  # fmt: skip
    assert len(READERS) > 60
    for pattern in NOT_A_USERS:
        assert any(name.startswith(pattern) for name in names), f"{pattern} opens nothing any more"


def test_every_kind_has_good_files(seeds):
    assert set(KINDS) | set(DATASETS) <= set(seeds)


def test_whatever_opens_a_file_has_read_a_good_one(seeds, tmp_path):
    called = set()

    def watch(frame, event, _):
        if event == "call":
            called.add((frame.f_code.co_filename, frame.f_code.co_firstlineno))

    for number, (write, read) in enumerate(seeds.values()):
        folder = tmp_path / str(number)
        folder.mkdir()
        write(folder)
        sys.setprofile(watch)
        try:
            read(folder)
        finally:
            sys.setprofile(None)
    unseen = [
        named(path, name)
        for (path, line), name in READERS.items()
        if (str(path), line) not in called
        and not any(named(path, name).startswith(known) for known in NOT_A_USERS)
    ]
    assert not unseen, "\n".join(unseen)


@pytest.mark.parametrize("suffix", LOAD)
def test_every_form_of_gaussians_has_a_good_file(suffix, seeds, tmp_path):
    seeds["gaussians"][0](tmp_path)
    assert list(tmp_path.glob(f"*{suffix}"))
