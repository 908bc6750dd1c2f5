"""What ``pip install .`` puts into a fresh environment is whole: packages, data, the command."""

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
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
DATA = ("gva_mi/body/puppet.npz", "gva_mi/page.html")
ALONE = ("--no-deps", "--no-index", "--disable-pip-version-check", "--quiet")  # without a network
PROBE = """
import importlib, sys
for name in sys.argv[2:]:
    module = importlib.import_module(name)
    assert module.__file__.startswith(sys.argv[1]), (name, module.__file__)
from gva_mi.body.smplx import load_body
print(len(load_body().v_template))
"""


@pytest.fixture(scope="module")
def sources(tmp_path_factory):
    """A copy of what is under version control: a build leaves folders beside the sources."""
    folder = tmp_path_factory.mktemp("sources")
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT, capture_output=True, text=True,
    )  # fmt: skip
    if listed.returncode:
        pytest.skip("no checkout of git")
    for name in listed.stdout.split("\0"):
        if name.startswith(("gva_mi/", "plugins/", "pyproject.toml", "README.md", "LICENSE")):
            if (ROOT / name).is_file():
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                (folder / name).write_bytes((ROOT / name).read_bytes())
    return folder


@pytest.fixture(scope="module")
def wheel(sources, tmp_path_factory):
    """What ``pip install .`` makes first, built with the packages of this environment."""
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "pip", "wheel", "--no-build-isolation", *ALONE]
    done = subprocess.run(
        [*build, "-w", folder, sources], capture_output=True, text=True, env=environment()
    )
    assert done.returncode == 0, done.stderr
    (found,) = folder.glob("*.whl")
    return found


@pytest.fixture(scope="module")
def fresh(wheel, tmp_path_factory):
    """An environment with the project alone; what it needs is taken from the one that runs."""
    folder = tmp_path_factory.mktemp("fresh") / "venv"
    venv.create(folder, with_pip=True)
    install = [folder / "bin/python", "-m", "pip", "install", *ALONE, wheel]
    done = subprocess.run(install, capture_output=True, text=True, env=environment())
    assert done.returncode == 0, done.stderr
    (own,) = folder.glob("lib/python*/site-packages")
    # After its own, and without the .pth files there: what is installed here comes first.
    (own / "needed.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return folder, own


def environment():
    """Without what would let the checkout be found."""
    return {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PYTHONHOME")}


def run(fresh, tmp_path, *words):
    """A program of the environment, in a folder that is not the checkout."""
    command = [fresh[0] / "bin" / words[0], *words[1:]]
    return subprocess.run(
        command, cwd=tmp_path, capture_output=True, text=True, env=environment(), timeout=300
    )


@pytest.mark.slow
def test_every_package_comes_from_there_with_its_data(fresh, tmp_path):
    packages = PROJECT["tool"]["setuptools"]["packages"]
    done = run(fresh, tmp_path, "python", "-c", PROBE, str(fresh[1]), *packages)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 1000
    for name in DATA:
        assert (fresh[1] / name).read_bytes() == (ROOT / name).read_bytes()


@pytest.mark.slow
def test_its_command_works_elsewhere(fresh, tmp_path):
    done = run(fresh, tmp_path, "gva-mi", "--help")
    assert done.returncode == 0 and "gradcheck" in done.stdout, done.stderr
    done = run(fresh, tmp_path, "gva-mi", "gradcheck", "--window", "8", "--count", "1")
    assert done.returncode == 0, done.stderr
    assert "all gradients are right" in done.stdout


@pytest.mark.slow
def test_every_file_of_the_sources_is_in_the_wheel(sources, wheel):
    with zipfile.ZipFile(wheel) as file:
        held = {name for name in file.namelist() if not re.match(r"[^/]*\.dist-info/", name)}
    wanted = set()
    for top, name in (("gva_mi", "gva_mi"), ("plugins", "gva_mi_plugins")):
        files = (p for p in (sources / top).rglob("*") if p.is_file())
        wanted |= {f"{name}/{p.relative_to(sources / top)}" for p in files if p.suffix != ".md"}
    assert held == wanted
