"""The command line: bad input is one sentence and exit code 2, and nothing is half-written."""

import dataclasses
import inspect
import io
import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from typing import Annotated, ClassVar, get_args, get_origin, get_type_hints

import numpy as np
import pytest

from gva_mi import InputError, __version__
from gva_mi.body.pose import Pose, Shape, save_poses
from gva_mi.cli import VERBS, load
from gva_mi.cli.parse import parse
from gva_mi.core.console import complete_streams, say
from gva_mi.core.errors import expecting
from gva_mi.core.options import ranges
from gva_mi.evaluate.measure import ALIGNED
from gva_mi.subject.pictures import write_image

TINY = ("--size", 64, "--frames", 6)


@pytest.fixture(scope="session")
def tiny_demo(tmp_path_factory):
    """A whole demo of 6 frames and 30 steps; shared, so do not change what is in it."""
    from gva_mi.app import DemoOptions, demo

    out = tmp_path_factory.mktemp("demo") / "out"
    demo(out, DemoOptions(size=64, frames=6, steps=30))
    return out


def files(folder):
    return sorted(str(p.relative_to(folder)) for p in folder.rglob("*"))


@pytest.mark.slow
def test_the_demo_writes_subject_run_and_report(tiny_demo):
    assert (tiny_demo / "subject/poses_refined.npz").exists()
    assert (tiny_demo / "run/avatar.npz").exists()
    page = (tiny_demo / "run/report.html").read_text()
    assert page.count("data:image/") > 10 and "http" not in page.split("</style>")[1]
    metrics = json.loads((tiny_demo / "run/metrics.json").read_text())
    figures, protocol = metrics["figures"], metrics["protocol"]
    scores = [row for row in figures if row["metric"] == "PSNR, dB"]
    splits = {row["split"] for row in scores}
    assert splits == {"train", "test", "novel_pose", "novel_view"}
    assert {row["region"] for row in scores} >= {"white", "person"}
    aligned = {row["split"] for row in scores if row["alignment"] == ALIGNED}
    assert aligned == {"novel_pose", "novel_view"}
    assert {"refined error, mm", "trained error, mm"} <= {row["metric"] for row in figures}
    assert "end" in {row["split"] for row in figures if row["metric"] == "spacing"}
    assert metrics["size"] == [64, 64] and protocol["similarity"]["scale"] > 0
    assert protocol["seen"]["test masks"] == ["refine"]
    assert not list(tiny_demo.rglob("*.part"))


def test_no_output_is_replaced_without_being_asked(subject, tmp_path, cli):
    """Not even with --overwrite if it is no output of this program."""
    (tmp_path / "run").mkdir()
    for name in ("options.json", "demo.json"):
        (tmp_path / "run" / name).write_text("{}")
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis/thesis.tex").write_text("years of work")
    before = files(tmp_path)
    for command in (
        ("demo", "--out", tmp_path / "run", *TINY),
        ("fit", subject, "--out", tmp_path / "run"),
        ("synth", tmp_path / "run", *TINY),
    ):
        cli.refuses("--overwrite", *command)
    for command in (
        ("demo", "--out", tmp_path / "thesis", "--overwrite", *TINY),
        ("synth", tmp_path / "thesis", "--overwrite", *TINY),
    ):
        assert "did not make it" in cli.fails(*command)
    assert files(tmp_path) == before


BAD = (
    (("refine", "nowhere"), "nowhere: no such folder"),
    (("evaluate", "nowhere", "nowhere"), "avatar.npz: no such file"),
    (("synth", "new", "--body", "nowhere.npz"), "nowhere.npz: no such file"),
    (("synth", "new", "--body", "body.npz"), "key 'f' is missing"),
    (("refine", "x", "--passes", "0"), "--passes must be a whole number from 1 to 10,000, got 0"),
    (("fit", "nowhere", "--out", "new", "--loss.alpha", "-1"), "from 0 to 1,000,000, got -1"),
    (("fit", "nowhere", "--out", "new", "--steps", "ten"), "--steps must be a whole"),
    (("render", "run", "--out", "new", "--size", "9", "1e9"), "--size must be a"),
    (("fitt", "nowhere"), "there is no command 'fitt'; expected one of demo, synth"),
    ((), "a command is missing; expected one of demo, synth"),
)


def test_bad_input_is_one_sentence_and_exit_code_2(tmp_path, monkeypatch, cli):
    monkeypatch.chdir(tmp_path)
    np.savez("body.npz", v_template=np.zeros((10, 3)))
    for command, sentence in BAD:
        cli.refuses(sentence, *command)
        assert files(tmp_path) == ["body.npz"]


def test_options_set_only_in_python_keep_their_defaults():
    """Also where the command's default is not that of the dataclass, as of the pixel's blur."""
    from gva_mi.fit.options import FitOptions

    call = parse(load("fit"), "fit", ["subject", "--out", "run", "--steps", "7"])
    assert call.keywords["options"] == FitOptions(steps=7)


def test_a_preset_sets_the_defaults_and_explicit_options_override_it():
    from gva_mi.fit import paper
    from gva_mi.fit.options import FitOptions
    from gva_mi.fit.poses import PoseOptions
    from gva_mi.refine import SequenceOptions

    words = ["subject", "--out", "run", "--steps", "7", "--poses.trained", "--preset"]
    of = lambda *last: parse(load("fit"), "fit", [*words, *last]).keywords["options"]
    assert of("paper") == replace(paper.FIT, steps=7, poses=PoseOptions())
    assert of("default").rates != of("paper").rates
    assert of("video") == replace(FitOptions(steps=2000).of_video(), steps=7)
    refined = parse(load("refine"), "refine", ["subject", "--preset=paper", "--size", "99"])
    assert refined.keywords["options"] == SequenceOptions(passes=paper.REFINE.passes, size=99)


def test_unknown_and_missing_arguments_are_answered_with_the_known_ones(cli):
    for command, there in (
        ("fit nowhere --out new --step 3", "--steps"), ("refine nowhere --preset all", "paper"),
        ("fit nowhere", "--out"), ("fit x --out new --mask-eror 3", "--mask-error"),
        ("study avatar --out x --fit.window 9", "--fit.window"),
    ):  # fmt: skip
        code, out, err = cli(*command.split())
        assert code == 2 and there in err and not out and "Traceback" not in err


def test_positional_arguments_are_shown_by_their_names_and_choices_as_such(cli):
    assert " KIND SOURCE OUT" in cli.works("prepare", "--help").splitlines()[0]
    assert " SUBJECTS ..." in cli.works("refine", "--help").splitlines()[0]
    assert " [OPTIONS] {splat,growth,fit,table}" in cli.works("bench", "--help").splitlines()[0]
    missing = cli.fails("prepare", "video.mp4", "me")
    assert "OUT" in missing and "SOURCE" not in missing and "PATH" not in missing


def test_an_error_of_a_command_is_not_taken_for_bad_arguments(monkeypatch, cli):
    def body():
        raise ValueError("a bug")

    monkeypatch.setattr("gva_mi.__main__.load", lambda verb: body)
    with pytest.raises(ValueError, match="a bug"):
        cli("body")


def test_help_names_every_command_and_version_the_version(cli):
    for asked in ("-h", "--help"):
        code, out, err = cli(asked)
        assert code == 0 and not err
        for verb, does in VERBS.items():
            assert f"  {verb}" in out and does in out
    assert cli("--version") == (0, f"gva-mi {__version__}\n", "")


def test_every_command_explains_itself_with_and_without_torch(cli, monkeypatch):
    monkeypatch.setenv("COLUMNS", "1")  # where tyro alone would not come to an end
    program = """
import sys
from contextlib import suppress
from gva_mi.__main__ import main
for verb in sys.argv[1:]:
    with suppress(SystemExit):
        main([verb, "--help"])
assert type(sys.modules["torch"]).__name__ == "_StandIn"
"""
    run = subprocess.run([sys.executable, "-c", program, *VERBS], capture_output=True, text=True)
    assert not run.stderr
    page = ""
    for verb in VERBS:
        code, out, err = cli(verb, "--help")
        assert code == 0 and not err
        assert out.startswith(f"usage: gva-mi {verb} ")
        assert inspect.getdoc(load(verb)).split()[0] in out
        page += out
    letters = lambda text: re.sub(r"\W", "", text)  # frames and lines depend on the encoding
    assert letters(run.stdout) == letters(page)


def numbers(hint, name=""):
    """Yield name and annotation of every number in a signature, as in ``--loss.alpha``."""
    hints = get_type_hints(hint, include_extras=True) if callable(hint) else {}
    for field, kind in hints.items():
        yield from number(kind, f"{name}{field}")


def number(kind, name):
    if get_origin(kind) is ClassVar:
        return
    if kind in (int, float) or get_origin(kind) is Annotated and get_args(kind)[0] in (int, float):
        yield name, kind
    elif dataclasses.is_dataclass(kind):
        yield from numbers(kind, f"{name}.")
    else:
        for part in get_args(kind):
            yield from number(part, name)


def test_every_number_states_its_range():
    found = {(verb, name): kind for verb in VERBS for name, kind in numbers(load(verb))}
    assert {("fit", "options.loss.alpha"), ("refine", "workers"), ("view", "port")} <= set(found)
    assert not [name for name, kind in found.items() if not list(ranges(kind))]


@pytest.mark.slow
@pytest.mark.parametrize("verb, words", [
    ("fit", "subject --out new"), ("track", "run subject"), ("refine", "subject"), ("synth", "x"),
])  # fmt: skip
def test_every_number_outside_its_range_is_refused_under_its_name(verb, words, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "400")
    with pytest.raises(SystemExit):
        parse(load(verb), verb, ["--help"])
    help_text = capsys.readouterr().out
    options = re.findall(r"(--[\w.-]+) [^\s\w]*(?:None[^\s\w]*)?(?:INT|FLOAT) ", help_text)
    assert len(options) > 1
    for turn, option in enumerate(options):
        bad = ("nan", "inf", "-inf", "1e30", "-1e30", "1" + 20 * "0")[turn % 6]
        with pytest.raises(InputError) as error:
            parse(load(verb), verb, [*words.split(), option, bad])
        sentence = str(error.value)
        assert sentence.startswith(f"{option} must be a") and sentence.endswith(f", got {bad}")


@pytest.mark.parametrize("stream, words, unbuffered, code", [
    ("stdout", "--help", "", 141),
    ("stdout", "--help", "1", 141),
    ("stderr", "no-command", "", 2),
])  # fmt: skip
def test_a_closed_pipe_ends_quietly(stream, words, unbuffered, code):
    """As after ``gva-mi ... | head -3``, when head has ended before the first word."""
    reader, writer = os.pipe()
    os.close(reader)
    program = [sys.executable, "-m", "gva_mi", words]
    environment = os.environ | {"PYTHONUNBUFFERED": unbuffered}
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, stream: writer}
    run = subprocess.run(program, env=environment, **streams)
    os.close(writer)
    assert not run.stdout and not run.stderr and run.returncode == code


def test_any_name_can_be_printed_in_ascii(monkeypatch):
    written = io.BytesIO()
    monkeypatch.setattr("sys.stdout", io.TextIOWrapper(written, "ascii"))
    complete_streams()
    say("\u00fc and a byte \udcff of no text")
    sys.stdout.flush()
    assert written.getvalue() == b"\\xfc and a byte \\udcff of no text\n"


@pytest.mark.parametrize("error", [
    MemoryError("Unable to allocate 9 GiB"),
    RuntimeError("DefaultCPUAllocator: can't allocate memory: you tried to allocate 8 bytes"),
    ImportError("lib.so: failed to map segment from shared object"),
])  # fmt: skip
def test_missing_memory_is_no_fault_of_a_file(error, monkeypatch, cli):
    def command(verb):
        with expecting("body.npz", "a body"):
            raise error

    monkeypatch.setattr("gva_mi.__main__.load", command)
    complaint = cli.fails("check", "subject")
    assert complaint.startswith("gva-mi: there is not enough memory (")
    assert "body.npz" not in complaint


def test_help_imports_no_command():
    program = """
import sys
from gva_mi.__main__ import main
main(["--help"])
print("imported", *sorted(x for x in sys.modules if x.startswith(("gva_mi.cli.", "torch"))))
"""
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert run.stdout.splitlines()[-1] == "imported gva_mi.cli.parse gva_mi.cli.quick_help"


def test_a_missing_package_is_named_with_its_extra(monkeypatch, cli):
    monkeypatch.setitem(sys.modules, "tyro", None)
    code, out, complaint = cli("synth", "new")
    assert code == 2 and not out
    needed = "the commands need: pip install 'gva_mi[avatar]'"
    assert complaint == f"gva-mi: tyro is not installed; {needed}\n"


def test_a_command_without_stdout_writes_into_no_file_of_its_own(tmp_path):
    """The first file that is opened would get the number of the stream that is missing."""
    program = """
import os, sys
from gva_mi.__main__ import main
main(["--version"])
with open(sys.argv[1], "w") as file:
    os.write(1, b"printed by a library")
"""
    line = f"{sys.executable} -c '{program}' {tmp_path / 'a'} >&-"
    run = subprocess.run(["sh", "-c", line], capture_output=True, text=True)
    assert run.returncode == 0 and not run.stderr and (tmp_path / "a").read_text() == ""


@pytest.mark.parametrize("command, told", [
    ("demo --out {0}/file", "file: is a file; expected a folder"),
    ("synth {0}/file/out", "file: cannot be written to: a file is in the way"),
    ("avatar {0}/subject --out {0}/o", "is a subject's folder; its pictures are"),
    ("prepare video {0}/frames {0}/o --keypoints {0}/none", "none: no such file; expected key"),
    ("prepare auto {0}/none {0}/o --body built-in", "none: no such file or folder"),
    ("evaluate {0}/run/avatar.npz {0}/subject", "avatar.npz: is a file; expected a folder"),
    ("evaluate {0}/run {0}/none", "none: no such folder; expected a subject"),
    ("check {0}/file", "file: is a file; expected a subject"),
    ("render {0}/run/poses.npz --out {0}/o", "poses.npz: unexpected format"),
    ("render {0}/run --out {0}/turn.mp4", "turn.mp4: expected a folder; with --video"),
])  # fmt: skip
def test_what_beginners_mistake_for_another_thing_is_named(command, told, tmp_path, known, cli):
    (tmp_path / "file").write_text("hello")
    for folder in ("subject/frames", "frames"):
        write_image(tmp_path / folder / "000000.png", np.zeros((64, 64, 3), np.uint8))
    known.save(tmp_path / "run/avatar.npz")
    save_poses(tmp_path / "run/poses.npz", Pose.rest(), Shape(known.rig.betas), stage=2)
    about = {"options": {}, "sources": {"poses": "poses.npz"}}
    (tmp_path / "run/options.json").write_text(json.dumps(about))
    before = files(tmp_path / "run")
    err = cli.fails(*command.format(tmp_path).split())
    assert told in err and err.count("\ngva-mi: ") + err.startswith("gva-mi: ") == 1, err
    assert files(tmp_path / "run") == before
