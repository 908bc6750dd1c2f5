"""Rules for every source file: imports point down, files are short, nothing is dead."""

import ast
import importlib
import importlib.util
import json
import re
from collections import Counter, defaultdict
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
spec = importlib.util.spec_from_file_location("layers", ROOT / "docs/layers.py")
layers = importlib.util.module_from_spec(spec)
spec.loader.exec_module(layers)

MODULES = layers.MODULES
TREES = {name: ast.parse(path.read_text()) for name, path in MODULES.items()}
OPTIONAL = {"mitsuba", "pymeshlab", "trimesh", "skimage", "matplotlib", "av", "jinja2", "PIL",
            "scipy", "viser", "transformers", "onnxruntime", "ai_edge_litert"}  # fmt: skip
HOMES = {  # packages that only some modules may import
    "mitsuba": ("gva_mi_plugins", "gva_mi.mesh", "gva_mi.synthetic", "gva_mi.gradcheck",
                "gva_mi.avatar.stage", "gva_mi.app.scenes"),
    "pymeshlab": ("gva_mi.avatar", "gva_mi.mesh.surface"),
    "viser": ("gva_mi.viewer",),
    "transformers": ("gva_mi.networks",),
    "onnxruntime": ("gva_mi.networks",),
    "ai_edge_litert": ("gva_mi.networks",),
    "tyro": ("gva_mi.cli",),
}  # fmt: skip
CALLED_FROM_OUTSIDE = {  # by torch's autograd, Dr.Jit's, torch.nn, Mitsuba, pickle, import
    "forward", "backward", "jvp", "vmap", "setup_context", "eval",
    "render", "render_forward", "render_backward", "aov_names", "to_string",
    "sample", "sample_ray", "sample_ray_differential", "traverse", "find_class", "persistent_load",
    "create_module", "exec_module",
}  # fmt: skip


def within(name, homes):
    return any(name == home or name.startswith(home + ".") for home in homes)


def test_every_module_has_a_layer_and_imports_point_down():
    assert not [name for name in MODULES if layers.layer_of(name) < 0]
    upward = [
        f"{name} -> {other}"
        for name, path in MODULES.items()
        for other in layers.imports(path) & MODULES.keys()
        if layers.layer_of(other) > layers.layer_of(name)
    ]
    assert not upward


def test_no_files_import_each_other_in_a_cycle():
    """Imports inside functions and for types count too."""
    graph = {name: layers.imports(p) & MODULES.keys() - {name} for name, p in MODULES.items()}
    for name, path in MODULES.items():
        if path.name == "__init__.py":
            graph[name] = set()  # a package re-exports what is inside
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


def test_the_drawing_of_layers_is_current():
    page = (ROOT / "docs/architecture.md").read_text()
    assert layers.drawing() in page, "run `python docs/layers.py` and put the drawing in"


def test_the_architecture_page_names_files_that_exist():
    page = (ROOT / "docs/architecture.md").read_text()
    tops = ("gva_mi", "plugins", "docs", "tests", "benchmarks", "tools")
    files = [f"/{p.relative_to(ROOT)}" for top in tops for p in (ROOT / top).rglob("*.py")]
    named = set(re.findall(r"\w[\w/]*\.py", page))
    assert not [name for name in named if not any(f.endswith(f"/{name}") for f in files)]


def test_packages_are_imported_only_where_they_belong():
    misplaced = [
        f"{name} imports {other}"
        for name, path in MODULES.items()
        for other in layers.imports(path)
        if not within(name, HOMES.get(other.split(".")[0], (name,)))
    ]
    assert not misplaced


def test_plugins_serve_any_scene():
    """gaussian_splat may import the kernels; other plugins import only the choice of libLLVM."""
    wrong = []
    for name, path in MODULES.items():
        if not name.startswith("gva_mi_plugins"):
            continue
        allowed = ("gva_mi.core.llvm",)
        if name.startswith("gva_mi_plugins.gaussian_splat"):
            allowed += ("gva_mi.splat", "gva_mi.jit")
        ours = {o for o in layers.imports(path) if o.split(".")[0] == "gva_mi" and o != "gva_mi"}
        wrong += [f"{name} imports {other}" for other in ours if not within(other, allowed)]
    assert not wrong


def test_importing_loads_no_optional_package():
    """Optional packages are imported inside the functions that need them."""
    eager = {
        name: found
        for name, path in MODULES.items()
        if not name.startswith("gva_mi_plugins.")  # loaded by register(), once Mitsuba is there
        and (
            found := {o.split(".")[0] for o in layers.imports(path, top_level_only=True)} & OPTIONAL
        )
    }
    assert not eager


def test_files_and_functions_are_short():
    """At most 450 lines a file, and 60 a function below its signature and docstring."""
    long = [f"{n}: {len(p.read_text().splitlines())}" for n, p in MODULES.items()
            if len(p.read_text().splitlines()) > 450]  # fmt: skip
    for name, tree in TREES.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef):
                documented = ast.get_docstring(node, clean=False) or ""
                lines = node.end_lineno - node.body[0].lineno + 1 - len(documented.splitlines())
                long += [f"{name}.{node.name}: {lines}"] if lines > 60 else []
    assert not long


def test_a_class_name_has_one_meaning():
    places = defaultdict(list)
    for name, tree in TREES.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                places[node.name].append(name)
    assert not {name: where for name, where in places.items() if len(where) > 1}


def test_public_names_exist():
    missing = []
    for name, path in MODULES.items():
        if path.name == "__init__.py" and not name.startswith("gva_mi_plugins."):
            package = importlib.import_module(name)
            missing += [
                f"{name}.{x}" for x in getattr(package, "__all__", []) if not hasattr(package, x)
            ]
    assert not missing


def used_names(tree):
    """Count how often each name is used, other than by its own definition."""
    found = Counter()
    for node in ast.walk(tree):
        if isinstance(node, ast.Name):
            found[node.id] += 1
        elif isinstance(node, ast.Attribute):
            found[node.attr] += 1
        elif isinstance(node, ast.alias):
            found[node.name.rsplit(".")[-1]] += 1
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            found.update(re.findall(r"^\w+$", node.value))  # getattr, __all__, tables of names
    return found


def shown_names():
    """Count the names in programs of README and docs, in notebooks, benchmarks and tools."""
    found = Counter()
    for page in [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]:
        for program in re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL):
            found.update(re.findall(r"\w+", program))
    for notebook in (ROOT / "notebooks").glob("*.ipynb"):
        for cell in json.loads(notebook.read_text())["cells"]:
            if cell["cell_type"] == "code":
                found.update(re.findall(r"\w+", "".join(cell["source"])))
    for folder in ("benchmarks", "docs", "tools"):
        for path in (ROOT / folder).rglob("*.py"):
            found.update(re.findall(r"\w+", path.read_text()))
    return found


def definitions(tree):
    """Yield public functions and classes, and the public methods of these."""
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
            yield node
        if isinstance(node, ast.ClassDef):
            for inner in node.body:
                if isinstance(inner, ast.FunctionDef) and not inner.name.startswith("_"):
                    yield inner


def unreached(trees, shown):
    """Return public definitions that nothing but tests reaches, by name."""
    used = sum((used_names(tree) for tree in trees.values()), Counter())
    return [
        f"{name}.{node.name}"
        for name, tree in trees.items()
        for node in definitions(tree)
        if used[node.name] <= used_names(node)[node.name]
        and not shown[node.name]
        and node.name not in CALLED_FROM_OUTSIDE
    ]


def test_no_public_definition_is_dead():
    planted = ast.parse("def alive(): return 1\ndef dead(): return dead()\nx = alive()\n")
    assert unreached({"m": planted}, Counter()) == ["m.dead"]
    assert not unreached(TREES, shown_names())
