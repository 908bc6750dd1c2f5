"""The examples of docs/plugins.md run."""

import re
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

DOCS = Path(__file__).parents[3] / "docs"
SECTION = (
    (DOCS / "plugins.md").read_text().partition("## `gaussian_splat`")[2].partition("\n## ")[0]
)


def run(samples):
    """Run the example in the current folder, and return its names."""
    (program,) = re.findall(r"```python\n(.*?)```", SECTION, re.DOTALL)
    assert '"sample_count": 64' in program
    names = {}
    program = program.replace('"sample_count": 64', f'"sample_count": {samples}')
    exec(compile(program, "plugins.md", "exec"), names)
    return names


def difference(folder):
    """Difference of the example's picture and the one in docs, of 255."""
    made, shown = (np.array(mi.Bitmap(str(p / "gaussian_splat.png"))) for p in (folder, DOCS))
    return made.astype(float) - shown


def test_the_example_runs(splats, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run(samples=1)
    np.testing.assert_allclose(
        difference(tmp_path)[:, 320:640], 0, atol=1
    )  # the part without noise


@pytest.mark.slow
def test_the_example_makes_its_picture_and_its_figure(splats, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = run(samples=64)
    assert np.sqrt(np.mean(difference(tmp_path) ** 2)) < 1
    error = np.array(names["traced"]) - np.array(names["splatted"])
    assert f"agree to {-10 * np.log10(np.mean(error**2)):.0f} dB" in SECTION


def test_every_parameter_is_documented(splats):
    """Mitsuba refuses unknown properties, so the table lists all."""
    table = re.findall(r"^\| `(\w+)` \|", SECTION, re.MULTILINE)
    assert table == ["meshes", "background", "srgb_primitives", "depth", "blur", "antialiased"]
    given = {"srgb_primitives": False, "depth": True, "blur": 0.1, "antialiased": True}
    assert set(given) < set(table)
    mi.load_dict({"type": "gaussian_splat", "meshes": "none", "background": 0.5} | given)
