"""``gva-mi synth --like``: a recording with another error model."""

import json

import pytest

from gva_mi.body.smplx import load_body
from gva_mi.synthetic import SynthOptions, make_subject

pytest.importorskip("mitsuba")


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    out = tmp_path_factory.mktemp("recording") / "subject"
    options = SynthOptions(
        frames=2, size=32, samples=4, clothes=False, hair=False, novel_poses=0, novel_views=0
    )
    make_subject(out, options, load_body())
    return out


def test_a_recording_gets_another_error_model(recording, tmp_path, cli):
    out = tmp_path / "other"
    printed = cli.works("synth", out, "--like", recording, "--error-model", "lean", "--seed", 3)
    assert "error model lean, seed 3" in printed
    assert json.loads((out / "noise.json").read_text())["levels"]["mask"] == 1
    assert (out / "frames/000001.png").samefile(recording / "frames/000001.png")


def test_options_of_the_recording_are_refused(recording, tmp_path, cli):
    for option, value, said in (
        ("--frames", 3, "--frames is fixed by the recording"),
        ("--error-model", "pink", "no error model 'pink'; there are: bursts, white"),
    ):
        err = cli.fails("synth", tmp_path / "other", "--like", recording, option, value)
        assert said in err and err.count("\n") == 1
        assert not (tmp_path / "other").exists()


def test_a_recording_is_not_replaced_by_itself(recording, cli):
    for option, reason in (((), "is the recording itself"), (("--overwrite",), "would remove")):
        err = cli.fails("synth", recording, "--like", recording, *option)
        assert reason in err and (recording / "synth.json").exists()
