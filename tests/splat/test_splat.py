"""The public names, and what importing them imports."""

import subprocess
import sys

import gva_mi.splat

PROGRAMS = (
    "import gva_mi.splat.drjit_render, sys; assert not {'torch', 'mitsuba'} & set(sys.modules)",
    # A module that was imported does not hide the function of its name.
    "from gva_mi.splat import rasterization, render, Screen\n"
    "import gva_mi.splat.gsplat, gva_mi.splat.torch_render, gva_mi.splat.drjit_render\n"
    "import gva_mi.splat as splat\n"
    "assert callable(rasterization) and splat.rasterization is rasterization\n"
    "assert callable(render) and splat.render is gva_mi.splat.torch_render.render is render\n",
)


def test_names_are_where_users_look_for_them_and_drjits_need_no_torch():
    assert all(hasattr(gva_mi.splat, name) for name in gva_mi.splat.__all__)
    for program in PROGRAMS:
        subprocess.run([sys.executable, "-c", program], check=True, timeout=120)
