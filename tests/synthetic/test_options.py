"""Options that do not exist or do not fit together are one sentence."""

import pytest

from gva_mi import InputError
from gva_mi.synthetic import SynthOptions

HELD = {"noise": 0.0, "scene": "room", "camera": "held"}


@pytest.mark.parametrize(
    "options, sentence",
    [
        ({"frames": 1}, "frames"),
        ({"samples": 5}, "samples must be a square number, got 5"),
        ({"samples": 9, "shutter": 0.05}, "4 times a square number with a shutter, got 9"),
        ({"subject": "zoe"}, "amira, bruno"),
        ({"motion": "crawl"}, "everyday"),
        ({"scene": "garden"}, "no scene 'garden'; there are: white, room"),
        ({"error_model": "brown"}, "no error model 'brown'; there are: bursts, white"),
        ({"noise_seed": -1}, "noise_seed must be from 0 to .*, got -1"),
        ({"camera": "circles"}, "--noise 0"),
        (HELD | {"noise": 1.0}, "--camera held needs --noise 0"),
        (HELD | {"scene": "white"}, "--camera held needs --scene room"),
    ],
)
def test_bad_options_are_refused(options, sentence):
    with pytest.raises(InputError, match=sentence):
        SynthOptions(**options)
