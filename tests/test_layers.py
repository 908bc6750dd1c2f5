"""The folder list tells the paper: a file imports only from the floors below it."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCES = sorted((ROOT / "gva_mi").rglob("*.py")) + sorted((ROOT / "plugins").rglob("*.py"))
HEAVY = {"mitsuba", "pymeshlab", "trimesh", "skimage", "matplotlib", "av", "jinja2", "PIL", "scipy"}

# Every folder stands on a floor of its own, and a file imports only from the floors below, or from
# its own folder. The first prefix that fits names the floor.
FLOORS = [
    ("gva_mi.errors", 0),
    ("gva_mi.files", 0),
    ("gva_mi.llvm", 0),
    ("gva_mi.page", 0),
    ("gva_mi.console", 0),
    ("gva_mi.threads", 0),
    ("gva_mi.versions", 0),
    ("gva_mi.splat.gradcheck", 3),
    ("gva_mi.splat.bench", 3),
    ("gva_mi.splat", 1),
    ("gva_mi_plugins", 2),
    ("gva_mi.body", 4),
    ("gva_mi.mesh", 5),
    ("gva_mi.data.synthetic", 7),
    ("gva_mi.data", 6),
    ("gva_mi.sculptor", 7),
    ("gva_mi.avatar", 8),
    ("gva_mi.pose", 9),
    ("gva_mi.fit", 10),
    ("gva_mi.commands", 11),
    ("gva_mi.__main__", 12),
]
ALLOWED_BESIDE = {  # packages that only some folders may import, at any depth of the file
    "mitsuba": ("gva_mi_plugins", "gva_mi.mesh", "gva_mi.data.synthetic", "gva_mi.sculptor",
                "gva_mi.commands.doctor"),
    "pymeshlab": ("gva_mi.data.synthetic", "gva_mi.sculptor", "gva_mi.avatar.reinit",
                  "gva_mi.pose.coarse_body", "gva_mi.commands.doctor"),
    "torch": ("gva_mi.splat.torch_op", "gva_mi.splat.reference", "gva_mi.splat.gradcheck",
              "gva_mi.splat.gsplat_compat", "gva_mi.splat.bench", "gva_mi.splat.scene",
              "gva_mi.body", "gva_mi.mesh", "gva_mi.data", "gva_mi.sculptor",
              "gva_mi.avatar", "gva_mi.pose", "gva_mi.fit", "gva_mi.threads", "gva_mi.commands"),
}  # fmt: skip


def module(path: Path) -> str:
    parts = list(path.relative_to(ROOT).with_suffix("").parts)
    if parts[0] == "plugins":
        parts[0] = "gva_mi_plugins"
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def floor(name: str) -> int:
    if name == "gva_mi":
        return 0
    fits = [level for prefix, level in FLOORS if name == prefix or name.startswith(prefix + ".")]
    assert fits, f"{name} stands on no floor: give it one in FLOORS"
    return fits[0]


def imports(path: Path, *, top_level_only: bool = False) -> set[str]:
    """Every module that a file imports; ``from a import b`` counts as ``a.b`` if that is one."""
    found = set()
    tree = ast.parse(path.read_text())
    for node in tree.body if top_level_only else ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative imports hide the floor"
            names = {f"{node.module}.{alias.name}" for alias in node.names}
            modules = {module(p) for p in SOURCES}
            found |= {n if n in modules else node.module for n in names}
    return found


@pytest.mark.parametrize("path", SOURCES, ids=module)
def test_imports_point_down(path):
    here = module(path)
    for name in imports(path):
        if name.split(".")[0] in ("gva_mi", "gva_mi_plugins"):
            assert floor(name) <= floor(here), f"{here} (floor {floor(here)}) imports {name}"


@pytest.mark.parametrize("path", SOURCES, ids=module)
def test_each_package_is_imported_only_where_it_belongs(path):
    here = module(path)
    for name in imports(path):
        homes = ALLOWED_BESIDE.get(name.split(".")[0])
        if homes:
            fits = any(here == home or here.startswith(home + ".") for home in homes)
            assert fits, f"{here} imports {name}, which belongs to {', '.join(homes)}"


@pytest.mark.parametrize("path", [p for p in SOURCES if "plugins" in p.relative_to(ROOT).parts[:1]], ids=module)
def test_a_plugin_serves_any_scene(path):
    """gaussian_splat knows the kernels, and no plugin anything else of gva_mi but its libLLVM."""
    here = module(path)
    allowed = (
        ("gva_mi.splat",) if here.startswith("gva_mi_plugins.gaussian_splat") else ()
    )
    for name in imports(path):
        if name.split(".")[0] == "gva_mi":
            assert name == "gva_mi.llvm" or name.startswith(allowed), f"{here} imports {name}"


@pytest.mark.parametrize("path", SOURCES, ids=module)
def test_importing_costs_nothing(path):
    if module(path).startswith("gva_mi_plugins."):
        return  # loaded by register() alone, when Mitsuba is there
    heavy = {name.split(".")[0] for name in imports(path, top_level_only=True)} & HEAVY
    assert not heavy, f"{module(path)} imports {heavy} at its top: move it into the function"


@pytest.mark.parametrize("path", [p for p in SOURCES if p.name == "__init__.py"], ids=module)
def test_public_names_exist(path):
    import importlib

    package = importlib.import_module(module(path))
    for name in getattr(package, "__all__", []):
        assert hasattr(package, name), (
            f"{package.__name__}.__all__ lists {name}, which is not there"
        )
