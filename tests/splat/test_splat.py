"""The public names, and what importing them costs."""

import subprocess
import sys

import gva_mi.splat


def test_all_names_exist():
    assert all(hasattr(gva_mi.splat, name) for name in gva_mi.splat.__all__)


def test_torch_is_not_imported():
    code = "import gva_mi.splat.drjit_op, sys; assert not {'torch', 'mitsuba'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)
