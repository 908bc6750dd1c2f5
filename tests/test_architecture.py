"""The floors of the house: a file imports only from below, and the drawing is the code's own."""

import ast
import importlib
import importlib.util
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
spec = importlib.util.spec_from_file_location("floors", ROOT / "docs/layers.py")
floors = importlib.util.module_from_spec(spec)
spec.loader.exec_module(floors)

SOURCES, MODULES, module = floors.SOURCES, floors.MODULES, floors.module
HEAVY = {"mitsuba", "pymeshlab", "trimesh", "skimage", "matplotlib", "av", "jinja2", "PIL", "scipy",
         "viser", "h5py", "transformers", "onnxruntime"}  # fmt: skip
HOMES = {  # packages that only some folders may import, at any depth of the file
    "mitsuba": ("gva_mi_plugins", "gva_mi.mesh", "gva_mi.synthetic", "gva_mi.synthetic.body_generator",
                "gva_mi.cli.doctor"),
    "pymeshlab": ("gva_mi.synthetic.body_generator", "gva_mi.synthetic", "gva_mi.avatar.reinit",
                  "gva_mi.avatar.envelope", "gva_mi.mesh.coarse_body", "gva_mi.cli.doctor"),
    "torch": ("gva_mi.splat.torch_render", "gva_mi.splat.geometry", "gva_mi.splat.autograd",
              "gva_mi.splat.screen",
              "gva_mi.splat.means2d", "gva_mi.splat.first_order",
              "gva_mi.splat.gsplat_compat", "gva_mi.splat.gsplat_meta",
              "gva_mi.splat.gsplat_lists", "gva_mi.splat.gsplat_pixels",
              "gva_mi.splat.gsplat_views", "gva_mi.splat.gsplat_projection",
              "gva_mi.splat.gsplat_functions", "gva_mi.splat.formats", "gva_mi.splat.reference",
              "gva_mi.splat.scene",
              "gva_mi.splat.gradcheck",
              "gva_mi.splat.bench", "gva_mi.body", "gva_mi.mesh", "gva_mi.data", "gva_mi.data.check",
              "gva_mi.synthetic.body_generator", "gva_mi.avatar", "gva_mi.pose", "gva_mi.fit", "gva_mi.core.threads",
              "gva_mi.viewer", "gva_mi.cli"),
    "viser": ("gva_mi.viewer.server", "gva_mi.viewer.controls"),
    "transformers": ("gva_mi.data.networks.sam_weights",),
    "onnxruntime": ("gva_mi.data.networks.normals",),
    "tyro": ("gva_mi.cli", "gva_mi.cli.parse", "gva_mi.__main__"),
}  # fmt: skip
MODULE = pytest.mark.parametrize("path", SOURCES, ids=module)


def within(name, homes):
    return any(name == home or name.startswith(home + ".") for home in homes)


@MODULE
def test_imports_point_down(path):
    here = module(path)
    assert floors.floor(here) >= 0, f"{here} stands on no floor: give it one in docs/layers.py"
    for name in floors.imports(path) & MODULES.keys():
        above = floors.floor(name) > floors.floor(here)
        assert not above, (
            f"{here} ({floors.FLOORS[floors.floor(here)][0]}) imports {name}, which stands above"
        )


def test_no_circle_of_files():
    """Whatever is imported at the top, inside a function, or for a type."""
    graph = {name: floors.imports(path) & MODULES.keys() - {name} for name, path in MODULES.items()}
    for package in [name for name, path in MODULES.items() if path.name == "__init__.py"]:
        graph[package] = set()  # a folder's face shows what is inside
    assert not floors.circle(graph)


def test_a_circle_is_found():
    graph = {"a": {"b"}, "b": {"c"}, "c": {"d", "b"}, "d": set()}
    assert floors.circle(graph) == ["b", "c", "b"]
    assert not floors.circle(graph | {"c": {"d"}})


@pytest.mark.parametrize("name", [name for _, _, prefixes in floors.FLOORS for name in prefixes])
def test_every_floor_has_a_room(name):
    assert name in MODULES, f"docs/layers.py names {name}, which does not exist"


def test_the_drawing_is_of_the_code_as_it_is():
    page = (ROOT / "docs/architecture.md").read_text()
    assert floors.drawing() in page, "run `python docs/layers.py` and put the drawing in"


def test_the_page_of_the_house_names_files_that_exist():
    page = (ROOT / "docs/architecture.md").read_text()
    sources = [*SOURCES, *(ROOT / "docs").glob("*.py")]
    there = [f"/{path.relative_to(ROOT)}" for path in sources]
    there.append("/tests/test_layers.py")
    for name in set(re.findall(r"[\w/]+\.py", page)):
        assert any(path.endswith(f"/{name}") for path in there), name


@MODULE
def test_each_package_is_imported_only_where_it_belongs(path):
    here = module(path)
    for name in floors.imports(path):
        homes = HOMES.get(name.split(".")[0])
        assert not homes or within(here, homes), (
            f"{here} imports {name}, which belongs to {', '.join(homes)}"
        )


@pytest.mark.parametrize(
    "path", [p for p in SOURCES if module(p).startswith("gva_mi_plugins")], ids=module
)
def test_a_plugin_serves_any_scene(path):
    """gaussian_splat knows the kernels, and no plugin anything else of gva_mi but its libLLVM."""
    here = module(path)
    allowed = ("gva_mi.core.llvm",)
    if here.startswith("gva_mi_plugins.gaussian_splat"):
        allowed += ("gva_mi.splat",)
    for name in floors.imports(path):
        assert name.split(".")[0] != "gva_mi" or name == "gva_mi" or within(name, allowed), (
            f"{here} imports {name}"
        )


@MODULE
def test_importing_costs_nothing(path):
    if module(path).startswith("gva_mi_plugins."):
        return  # loaded by register() alone, when Mitsuba is there
    heavy = {name.split(".")[0] for name in floors.imports(path, top_level_only=True)} & HEAVY
    assert not heavy, f"{module(path)} imports {heavy} at its top: move it into the function"


@MODULE
def test_a_file_is_one_idea(path):
    """What takes more than 400 lines to say is two."""
    assert len(path.read_text().splitlines()) <= 400


@MODULE
def test_a_function_fits_on_a_screen(path):
    """60 lines, below its signature and its docstring."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.FunctionDef):
            documented = ast.get_docstring(node, clean=False) or ""
            lines = node.end_lineno - node.body[0].lineno + 1 - len(documented.splitlines())
            assert lines <= 60, f"{module(path)}.{node.name} has {lines} lines"


@pytest.mark.parametrize("path", [p for p in SOURCES if p.name == "__init__.py"], ids=module)
def test_public_names_exist(path):
    if module(path).startswith("gva_mi_plugins."):
        return
    package = importlib.import_module(module(path))
    for name in getattr(package, "__all__", []):
        assert hasattr(package, name), (
            f"{package.__name__}.__all__ lists {name}, which is not there"
        )
