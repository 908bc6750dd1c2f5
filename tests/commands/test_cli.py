"""The command line: bad input is one sentence and exit code 2, and nothing is half-written."""

import inspect
import json
import os
import subprocess
import sys

import numpy as np
import pytest

from gva_mi import __version__
from gva_mi.body.pose import Pose, Shape, save_poses
from gva_mi.body.smplx import load_body
from gva_mi.commands import VERBS, load
from gva_mi.fit.evaluation.metrics import ALIGNED

TINY = ("--size", 64, "--frames", 6)


@pytest.fixture(scope="session")
def tiny_demo(tmp_path_factory):
    """A whole demo of 6 frames and 30 steps; shared, so do not change what is in it."""
    from gva_mi.commands.demo import DemoOptions, demo

    out = tmp_path_factory.mktemp("demo") / "out"
    demo(DemoOptions(size=64, frames=6, steps=30), out=out)
    return out


def files(folder):
    return sorted(str(p.relative_to(folder)) for p in folder.rglob("*"))


def test_the_demo_writes_subject_run_and_report(tiny_demo):
    assert (tiny_demo / "subject/poses_refined.npz").exists()
    assert (tiny_demo / "avatar.npz").exists()
    page = (tiny_demo / "report.html").read_text()
    assert page.count("data:image/") > 10 and "http" not in page.split("</style>")[1]
    metrics = json.loads((tiny_demo / "metrics.json").read_text())
    splits = {row["split"] for row in metrics["rows"]}
    assert splits == {"train", "test", "novel_pose", "novel_view"}
    assert metrics["refinement"]["vertex_mm"] is not None
    assert metrics["training"]["size"] == [64, 64]
    assert {row["region"] for row in metrics["rows"]} >= {"white", "black", "person"}
    assert {row["split"] for row in metrics["rows"] if row["name"] == ALIGNED} == {
        "novel_pose", "novel_view"
    }  # fmt: skip
    assert metrics["similarity"]["scale"] > 0 and metrics["surface"][-1]["moment"] == "end"
    assert metrics["protocol"]["seen"]["test masks"] == ["refine"]
    assert not list(tiny_demo.rglob("*.part"))


def test_a_run_is_not_replaced_without_being_asked(tiny_demo, cli):
    before = files(tiny_demo)
    for command in (
        ("demo", "--out", tiny_demo, *TINY),
        ("fit", tiny_demo / "subject", "--out", tiny_demo),
        ("synth", tiny_demo / "subject", *TINY),
        ("refine", tiny_demo / "subject"),
    ):
        code, _, err = cli(*command)
        assert code == 2 and "--overwrite" in err and err.count("\n") == 1, err
    assert files(tiny_demo) == before


def test_a_folder_that_is_not_ours_is_never_replaced(tmp_path, cli):
    (tmp_path / "thesis.tex").write_text("years of work")
    for command in (
        ("demo", "--out", tmp_path, "--overwrite", *TINY),
        ("synth", tmp_path, "--overwrite", *TINY),
    ):
        code, _, err = cli(*command)
        assert code == 2 and "did not make it" in err
    assert (tmp_path / "thesis.tex").read_text() == "years of work"


def test_an_avatar_is_driven_by_other_poses(tiny_demo, tmp_path, cli):
    save_poses(
        tmp_path / "poses.npz", Pose.rest(3), Shape(load_body().v_template.new_zeros(10)), stage=1
    )
    cameras = tiny_demo / "subject/cameras.npz"
    out = tmp_path / "renders"
    command = (
        "render",
        tiny_demo,
        "--poses",
        tmp_path / "poses.npz",
        "--cameras",
        cameras,
        "--out",
        out,
    )
    code, _, err = cli(*command, "--video")
    assert code == 0, err
    assert {"000000.png", "000001.png", "000002.png", "video.mp4"} <= set(files(out))


BAD = {
    "no subject": (("refine", "nowhere"), "nowhere: no such folder"),
    "no run": (("evaluate", "nowhere", "nowhere"), "avatar.npz: no such file"),
    "no body": (("synth", "new", "--body", "nowhere.npz"), "nowhere.npz: no such file"),
    "no pickled body": (("synth", "new", "--body", "SMPLX_NEUTRAL.pkl"), "no such file"),
    "no passes": (
        ("refine", "nowhere", "--passes", "0"),
        "--passes must be a whole number from 1 to 10,000, got 0",
    ),
    "no steps": (
        ("demo", "--out", "new", "--steps", "0"),
        "--steps must be a whole number from 1 to",
    ),
    "nobody": (("demo", "--out", "new", "--subject", "nobody"), "nobody"),
    "negative frames": (
        ("synth", "new", "--frames", "-1"),
        "--frames must be a whole number from 2 to",
    ),
    "negative weight": (
        ("fit", "nowhere", "--out", "new", "--loss.alpha", "-1"),
        "--loss.alpha must be a number from 0 to 1,000,000, got -1",
    ),
    "negative blur": (
        ("fit", "nowhere", "--out", "new", "--splat.blur", "-1"),
        "--splat.blur must be a",
    ),
    "no number": (("fit", "nowhere", "--out", "new", "--steps", "ten"), "--steps must be a whole"),
    "no calls": (
        ("bench", "splat", "--repeats", "0"),
        "--repeats must be a whole number from 1 to",
    ),
    "no window": (("gradcheck", "--window", "0"), "--window must be a whole number from 1"),
    "no images": (("gradcheck", "--images"), "images must be some of color, alpha, depth"),
    "no size": (("gradcheck", "normals", "--size", "0"), "--size must be a whole number from 32"),
    "too many cases": (
        ("gradcheck", "normals", "--count", "99"),
        "count must be from 1 to 16, got 99",
    ),
    "no lines": (("gradcheck", "normals", "--lines", "0"), "--lines must be a whole number from 1"),
    "no scene": (
        ("gradcheck", "--scene", "nowhere.npz"),
        "nowhere.npz: no such file; expected a scene",
    ),
    "no command": (("fitt", "nowhere"), "there is no command 'fitt'; expected one of demo, synth"),
    "nothing": ((), "a command is missing; expected one of demo, synth"),
    "no numbers": (
        ("fit", "nowhere", "--out", "new", "--schedule.reinit-at", "never"),
        "--schedule.reinit-at must be a number above 0 and below 1, got never",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_one_sentence_and_exit_code_2(name, tmp_path, monkeypatch, cli):
    monkeypatch.chdir(tmp_path)
    command, sentence = BAD[name]
    code, _, err = cli(*command)
    assert code == 2 and sentence in err
    assert err.count("\n") == 1 and "Traceback" not in err
    assert not files(tmp_path)


def test_a_body_with_a_missing_key_is_named(tmp_path, cli):
    np.savez(tmp_path / "body.npz", v_template=np.zeros((10, 3)))
    code, _, err = cli("synth", tmp_path / "new", "--body", tmp_path / "body.npz")
    assert code == 2 and "key 'f' is missing" in err
    assert files(tmp_path) == ["body.npz"]


# What nobody asked for, and what is none of the choices: tyro's frame tells what there is instead.
UNKNOWN = {
    "option": (("fit", "nowhere", "--out", "new", "--step", "3"), "--steps"),
    "choice": (("bench", "all"), "viewer"),
    "missing": (("fit", "nowhere"), "--out"),
}


@pytest.mark.parametrize("name", UNKNOWN)
def test_unknown_arguments_are_answered_with_those_there_are(name, tmp_path, monkeypatch, cli):
    monkeypatch.chdir(tmp_path)
    command, there = UNKNOWN[name]
    code, out, err = cli(*command)
    assert code == 2 and there in err and not out and "Traceback" not in err
    assert not files(tmp_path)


def test_colours_of_a_terminal_do_not_hide_what_was_wrong(monkeypatch, cli):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    _, _, err = cli(*BAD["no number"][0])
    assert BAD["no number"][1] in err and err.count("\n") == 1


def test_an_error_of_a_command_is_not_taken_for_bad_arguments(monkeypatch, cli):
    def body():
        raise ValueError("a bug")

    monkeypatch.setattr("gva_mi.__main__.load", lambda verb: body)
    with pytest.raises(ValueError, match="a bug"):
        cli("body")


def test_help_names_every_command(cli):
    for asked in ("-h", "--help"):
        code, out, err = cli(asked)
        assert code == 0 and not err
        for verb, does in VERBS.items():
            assert f"  {verb}" in out and does in out


@pytest.mark.parametrize("verb", VERBS)
def test_every_command_explains_itself(verb, cli):
    code, out, err = cli(verb, "--help")
    assert code == 0 and not err
    assert out.startswith(f"usage: gva-mi {verb} ")
    assert inspect.getdoc(load(verb)).split(".")[0].split()[0] in out


def test_a_shell_s_completion_knows_every_command(cli):
    code, out, err = cli("--tyro-print-completion", "bash")
    assert not code and not err and all(f"'{verb}'" in out for verb in VERBS)


def test_the_version_is_said(cli):
    assert cli("--version") == (0, f"gva-mi {__version__}\n", "")


def test_help_of_what_is_on_says_what_turning_it_on_and_off_does(cli):
    _, out, _ = cli("synth", "--help")
    assert "--hair, --no-hair" in out and "--clothes, --no-clothes" in out
    assert "--overwrite " in out and "--no-overwrite" not in out
    _, out, _ = cli("demo", "--help")
    assert "--no-refine " in out and "--no-no-refine" not in out


@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize("command", [("--help",), ("fit", "--help"), ("doctor",)], ids=" ".join)
def test_output_that_nobody_reads_ends_quietly(command, unbuffered):
    """As after ``gva-mi ... | head -3``, when head has gone before the first word."""
    reader, writer = os.pipe()
    os.close(reader)
    program = [sys.executable, "-m", "gva_mi", *command]
    environment = os.environ | {"PYTHONUNBUFFERED": unbuffered}
    run = subprocess.run(program, env=environment, stdout=writer, stderr=subprocess.PIPE)
    os.close(writer)
    assert run.stderr == b"" and run.returncode == 141


@pytest.mark.parametrize(
    ("arguments", "imported"),
    [
        (["--help"], []),
        (["nosuch"], []),
        (["gradcheck", "--help"], ["arguments", "gradcheck"]),
    ],
)
def test_only_the_command_that_is_asked_for_is_imported(arguments, imported):
    program = f"""
import sys
from gva_mi.__main__ import main
try:
    main({arguments})
except SystemExit:
    pass
print("imported", *sorted(name for name in sys.modules if name.startswith("gva_mi.commands.")))
"""
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    _, *found = run.stdout.splitlines()[-1].split()
    assert found == [f"gva_mi.commands.{name}" for name in imported]


def test_a_package_that_the_bare_installation_lacks_is_named_with_its_extra(monkeypatch, cli):
    monkeypatch.setitem(sys.modules, "tyro", None)
    code, out, complaint = cli("bench", "splat")
    assert code == 2 and not out
    needed = "the commands need: pip install 'gva_mi[avatar]'"
    assert complaint == f"gva-mi: tyro is not installed; {needed}\n"
