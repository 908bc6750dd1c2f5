"""What ``pip install .`` puts into a fresh environment is complete: packages, data, the command."""

import os
import re
import subprocess
import sys
import sysconfig
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SETUP = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
ALONE = ("--no-deps", "--no-index", "--disable-pip-version-check", "--quiet")  # without a network
TOPS = {"gva_mi": "gva_mi", "plugins": "gva_mi_plugins"}  # folder: package


def test_every_package_and_data_file_is_declared():
    """Without building a wheel."""
    packages = set()
    for top, name in TOPS.items():
        for init in (ROOT / top).rglob("__init__.py"):
            inside = init.parent.relative_to(ROOT / top).parts
            packages.add(".".join((name, *inside)))
    assert packages == set(SETUP["packages"])
    for package, patterns in SETUP["package-data"].items():
        folder = ROOT / package.replace(".", "/")
        assert all(list(folder.glob(pattern)) for pattern in patterns), package


def environment():
    """Return the environment without what would let the checkout be found."""
    return {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PYTHONHOME")}


def run(*command, cwd=None):
    done = subprocess.run(
        command, cwd=cwd, capture_output=True, text=True, env=environment(), timeout=600
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_a_wheel_is_complete_and_its_command_works_elsewhere(tmp_path):
    listed = subprocess.run(["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT, capture_output=True, text=True)  # fmt: skip
    if listed.returncode:
        pytest.skip("no checkout of git")
    sources, elsewhere = tmp_path / "sources", tmp_path / "elsewhere"
    elsewhere.mkdir()
    wanted = set()
    for name in listed.stdout.split("\0"):
        top = name.partition("/")[0]
        if top in (*TOPS, "pyproject.toml", "README.md", "LICENSE") and (ROOT / name).is_file():
            (sources / name).parent.mkdir(parents=True, exist_ok=True)
            (sources / name).write_bytes((ROOT / name).read_bytes())
            if top in TOPS and not name.endswith(".md"):
                wanted.add(name.replace(top, TOPS[top], 1))
    run(sys.executable, "-m", "pip", "wheel", "--no-build-isolation", *ALONE, "-w", tmp_path,
        sources)  # fmt: skip
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as file:
        held = {name for name in file.namelist() if not re.match(r"[^/]*\.dist-info/", name)}
    assert held == wanted

    venv.create(tmp_path / "venv", with_pip=True)
    run(tmp_path / "venv/bin/python", "-m", "pip", "install", *ALONE, wheel)
    (own,) = (tmp_path / "venv").glob("lib/python*/site-packages")
    # The needed packages come from the running environment, after its own.
    (own / "needed.pth").write_text(sysconfig.get_path("purelib") + "\n")
    assert "gradcheck" in run(tmp_path / "venv/bin/gva-mi", "--help", cwd=elsewhere)
    probe = (
        "import gva_mi; from gva_mi.body.smplx import load_body; "
        "print(gva_mi.__file__, len(load_body().v_template))"
    )
    where, vertices = run(tmp_path / "venv/bin/python", "-c", probe, cwd=elsewhere).split()
    assert where.startswith(str(own)) and int(vertices) > 1000
