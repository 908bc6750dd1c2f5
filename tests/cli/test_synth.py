"""``gva-mi synth``: bad options are one sentence, before anything is drawn."""

import pytest


@pytest.mark.parametrize(
    "options, said",
    [
        (("--error-model", "pink"), "no error model 'pink'; there are: none, bursts"),
        (("--subject", "zoe"), "no subject 'zoe'; there are: amira, bruno"),
        (("--camera", "held", "--error-model", "none"), "--camera held needs --scene room"),
    ],
)
def test_bad_options_are_refused(tmp_path, cli, options, said):
    err = cli.fails("synth", tmp_path / "new", *options)
    assert said in err and err.count("\n") == 1
    assert not (tmp_path / "new").exists()
