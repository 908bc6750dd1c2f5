"""What README tells a reader to type works, in the order in which it stands there."""

import re
import shlex
from pathlib import Path

import pytest

README = (Path(__file__).parents[1] / "README.md").read_text()
COMMANDS = re.findall(r"^gva-mi .*?(?=\s*(?:#.*)?$)", README, re.MULTILINE)
PROGRAMS = re.findall(r"```python\n(.*?)```", README, re.DOTALL)

# The same command on less work.
SMALLER = {
    "synth": "--size 64 --frames 6 --novel-poses 2 --novel-views 1",
    "refine": "--passes 2 --size 64",
    "fit": "--steps 20",
    "track": "--passes 1",
}


def test_the_commands_run_one_after_the_other(tmp_path, monkeypatch, cli):
    monkeypatch.chdir(tmp_path)
    assert len(COMMANDS) >= 5
    for command in COMMANDS:
        words = shlex.split(command)[1:]
        code, _, err = cli(*words, *shlex.split(SMALLER.get(words[0], "")))
        assert code == 0, f"{command}: {err}"
    assert (tmp_path / "renders/video.mp4").exists()
    assert (tmp_path / "run/report.html").exists()
    assert (tmp_path / "turntable/000071.png").exists()
    assert (tmp_path / "person.ply").exists() and (tmp_path / "person.glb").exists()


@pytest.mark.parametrize("program", PROGRAMS, ids=lambda text: text.split("\n")[1])
def test_the_programs_run(program):
    exec(compile(program, "README.md", "exec"), {})


def test_the_folder_map_names_folders_that_exist():
    for name in re.findall(r"^  (\w+)/ ", README, re.MULTILINE):
        assert (Path(__file__).parents[1] / "gva_mi" / name).is_dir()


def test_every_picture_is_there():
    for name in re.findall(r"!\[.*?\]\((.*?)\)", README):
        assert (Path(__file__).parents[1] / name).exists(), name
