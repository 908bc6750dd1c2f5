"""Whatever is broken is refused in one sentence with exit code 2, or taken; nothing is lost."""

import json
import shutil

import numpy as np
import pytest
from samples import broken_cases as cases

from gva_mi.body.pose import save_poses
from gva_mi.fit import run_folder

NOT_IN_THE_MASKS = {
    "camera is a kilometre away", "transl is in millimetres", "masks are inverted",
}  # fmt: skip
COMMANDS = {  # what of a run's folder each reads
    "export": ("export {run} --out {out}.ply --frame 0", ("avatar", "poses")),
    "render": ("render {run} --path static --size 16 16 --out {out}", ("poses",)),
    "view": ("view {run} --port 0", ("poses",)),
    "fit": ("fit {subject} --out {run} --resume --steps 3", ("records", "state")),
    "evaluate": ("evaluate {run} {subject}", ("poses", "records")),
    "track": ("track {run} {subject}", ("poses", "records")),
}
WORK = ("app.steps.fit_avatar", "app.driving.render_shots", "cli.view.serving",
    "app.steps.fit_poses", "app.steps.measure_run")  # fmt: skip


@pytest.fixture
def copied(subject, tmp_path):
    return shutil.copytree(subject, tmp_path / "subject")


@pytest.fixture
def run(known, turning, tmp_path):
    """A finished run to break."""
    folder = tmp_path / "run"
    known.save(folder / "avatar.npz")
    save_poses(folder / "poses.npz", *turning(6), stage=2)
    options = {"options": {"steps": 3, "seed": 0}, "versions": {}, "video": {}}
    (folder / "options.json").write_text(json.dumps(options))
    np.savez(folder / "history.npz", loss=np.arange(3.0), gaussians=np.arange(3))
    state = {"step": 2, "avatar": known.record(), "history": {"loss": [1.0, 2.0]}}
    run_folder.save_state(folder, state)
    return folder


@pytest.fixture
def refused_or_taken(cli, monkeypatch):
    """Run a command without its work: None if it takes its input, else its one sentence."""

    def nothing(*_, **__):
        raise SystemExit(0)

    for place in WORK:
        monkeypatch.setattr(f"gva_mi.{place}", nothing)

    def call(*arguments):
        code, _, err = cli(*arguments)
        said = [line for line in err.replace("\r", "\n").split("\n") if "%|" not in line]
        said = [line for line in said if line.startswith("gva-mi: ")]
        assert "Traceback" not in err
        if code != 2:
            assert code in (0, 1) and not said, (code, err)
            return None
        assert len(said) == 1 and said[0].isprintable() and len(said[0]) < 2000, err
        return said[0]

    return call


@pytest.mark.parametrize("name", cases.SUBJECTS)
def test_fit_takes_a_broken_subject_or_says_why(
    name, copied, refused_or_taken, tmp_path, monkeypatch
):
    warnings = []
    monkeypatch.setattr("gva_mi.subject.opened.say", warnings.append)
    cases.SUBJECTS[name](copied)
    refused = refused_or_taken("fit", copied, "--out", tmp_path / "out")
    assert (refused is None) == (name in cases.TAKEN), refused
    assert refused is None or str(copied) in refused and not (tmp_path / "out/avatar.npz").exists()
    if name in NOT_IN_THE_MASKS:
        assert any(": doubtful: " in line for line in warnings)


@pytest.mark.slow
@pytest.mark.parametrize("name", cases.SUBJECTS)
def test_check_finds_what_fit_refuses(name, copied, cli):
    cases.SUBJECTS[name](copied)
    code, said, err = cli("check", copied)
    refused = name not in cases.TAKEN and not name.startswith("poses_refined")
    assert code in (1, 2) if refused else code in (0, 1), said + err
    assert "Traceback" not in err


@pytest.mark.slow
@pytest.mark.parametrize("name", cases.TAKEN)
def test_what_is_taken_is_refined_to_its_end(name, copied, refused_or_taken):
    cases.SUBJECTS[name](copied)
    refused_or_taken("refine", copied, "--passes", 1, "--size", 32)


@pytest.mark.parametrize("verb, part, name", [
    (verb, part, name)
    for verb, (_, parts) in COMMANDS.items()
    for part in parts
    for name in cases.RUNS[part]
])  # fmt: skip
def test_commands_take_a_run_or_say_why(verb, part, name, run, subject, refused_or_taken, tmp_path):
    cases.RUNS[part][name](run)
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    if verb == "fit":  # which goes on only if no avatar is there yet
        (run / "avatar.npz").unlink()
    words = COMMANDS[verb][0].format(run=run, subject=subject, out=tmp_path / "out")
    refused = refused_or_taken(*words.split())
    if part == "avatar" and ("NaN" in name or name.startswith("avatar")):
        assert refused is not None and "avatar.npz" in refused
    if part == "poses" and verb in ("export", "render", "view"):
        assert refused is not None and "poses.npz" in refused
    if refused is not None and verb != "fit":
        assert before == {path: path.read_bytes() for path in before}
