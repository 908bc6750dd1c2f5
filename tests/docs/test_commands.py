"""The commands of README run on tiny inputs, and (slow) those of the other pages."""

import runpy
import shlex
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest


def beside(name):
    return SimpleNamespace(**runpy.run_path(str(Path(__file__).with_name(f"{name}.py"))))


pages, less = beside("pages"), beside("less")


def new_commands():
    """Return the commands of each page that neither README nor a page before it has."""
    known, found = set(), {}
    for page in sorted(pages.PAGES, key=lambda page: page.name != "README.md"):
        for command in pages.typed(page):
            same = command.replace(" --overwrite", "")
            if same not in known and command not in less.NOT_RUN:
                found.setdefault(page.name, []).append(command)
            known.add(same)
    del found["README.md"]
    del found["sources.md"]  # other programs' files: tests/data/importers makes and reads them
    return found


NEW = new_commands()


def test_the_commands_of_readme_run_one_after_the_other(readers_folder):
    assert len(list(pages.typed(pages.PAGES[0]))) >= 9
    assert (readers_folder / "renders/video.mp4").exists()
    assert (readers_folder / "run/report.html").exists()
    assert (readers_folder / "turntable/000071.png").exists()
    assert (readers_folder / "person.ply").exists() and (readers_folder / "person.glb").exists()


def run_commands(page, folder, gva):
    """Run a page's commands in its folder."""
    for command in NEW[page]:
        words = less.named(command)
        before = BEFORE.get((words[0], "--resume" in words))
        if before is not None:
            before(folder, gva)
        code, _, err = gva(folder, *words, *less.smaller(command))
        assert code == 0, f"{page}: {command}: {err}"


def kill_a_fit(folder, gva):
    """Leave an interrupted run."""
    from gva_mi.fit.train import Run

    shutil.rmtree(folder / "run")
    whole, steps = Run.descend, iter(range(12))

    def descend(*arguments):
        if next(steps, None) is None:
            raise KeyboardInterrupt
        return whole(*arguments)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Run, "descend", descend)
        words = shlex.split("fit subject --out run")
        code, _, err = gva(folder, *words, *less.smaller("gva-mi fit subject"))
    assert code == 130, err


BEFORE = {("fit", True): kill_a_fit}


def after_export(folder):
    for name in ("person.splat", "frame.ply", "person.glb", "motion.npz"):
        assert (folder / name).stat().st_size > 100, name
    assert (folder / "again/000002.png").exists()


def after_motions(folder):
    assert len(np.load(folder / "walk.npz")["transl"]) == 4  # 9 frames at 60 a second, now at 25
    assert (folder / "orbit/video.mp4").exists() and (folder / "turntable/000071.png").exists()


AFTER = {"export.md": after_export, "motions.md": after_motions}


@pytest.mark.slow
@pytest.mark.parametrize("page", NEW)
def test_the_commands_of_a_page_run(page, reader, gva, monkeypatch):
    def stopped(server):
        raise KeyboardInterrupt

    monkeypatch.setattr("gva_mi.cli.view.pages", stopped)  # ends at once
    folder = reader(page)
    run_commands(page, folder, gva)
    if page in AFTER:
        AFTER[page](folder)


def test_a_command_that_does_not_run_is_found(tmp_path, gva, monkeypatch):
    monkeypatch.setitem(NEW, "steps.md", ["gva-mi fit nowhere --out run"])
    with pytest.raises(AssertionError, match="steps.md: gva-mi fit nowhere.*no such folder"):
        run_commands("steps.md", tmp_path, gva)
