"""The public names, and what importing them imports."""

import subprocess
import sys

import gva_mi.splat


def test_all_names_exist():
    assert all(hasattr(gva_mi.splat, name) for name in gva_mi.splat.__all__)


def test_torch_is_not_imported():
    code = (
        "import gva_mi.splat.drjit_render, sys; assert not {'torch', 'mitsuba'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)


def test_render_and_rasterization_are_functions_where_users_look_for_them():
    """Also after their modules were imported: a module does not hide the function."""
    code = (
        "from gva_mi.splat import rasterization, render, Screen\n"
        "import gva_mi.splat.gsplat, gva_mi.splat.torch_render, gva_mi.splat.drjit_render\n"
        "import gva_mi.splat as splat\n"
        "assert callable(rasterization) and splat.rasterization is rasterization\n"
        "assert callable(render) and splat.render is gva_mi.splat.torch_render.render is render\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)
