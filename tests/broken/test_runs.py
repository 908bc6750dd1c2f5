"""Runs broken by hand: what reads them takes them, or says in one sentence what is wrong."""

import importlib.util
from pathlib import Path

import pytest

spec = importlib.util.spec_from_file_location("runs", Path(__file__).with_name("runs.py"))
runs = importlib.util.module_from_spec(spec)
spec.loader.exec_module(runs)

COMMANDS = {  # and what of a run's folder each reads
    "export": ("export {run} --out {out}.ply --frame 0", ("AVATAR", "POSES")),
    "render": ("render {run} --path static --size 16 16 --out {out}", ("POSES",)),
    "view": ("view {run} --port 0 --out {out}", ("POSES",)),
    "fit": ("fit {subject} --out {run} --resume --steps 3", ("RECORDS", "STATE")),
    "evaluate": ("evaluate {run} {subject}", ("POSES", "RECORDS")),
    "track": ("track {run} {subject}", ("POSES", "RECORDS")),
}
CASES = [
    (verb, name)
    for verb, (_, parts) in COMMANDS.items()
    for part in parts
    for name in getattr(runs, part)
]


@pytest.fixture
def no_work(monkeypatch):
    """The commands read what they need, and do none of their work."""

    def nothing(*_, **__):
        raise SystemExit(0)

    for place in (
        "commands.render.render_shots", "commands.view.open_server", "commands.track.fit_poses",
        "commands.evaluate.measure_run", "fit.train.Samples",
    ):  # fmt: skip
        monkeypatch.setattr(f"gva_mi.{place}", nothing)


@pytest.mark.parametrize("verb, name", CASES)
def test_a_broken_run_is_taken_or_refused_in_one_sentence(
    verb, name, run, subject, no_work, refused_or_taken, tmp_path
):
    runs.RUNS[name](run)
    if verb == "fit":  # which goes on where no avatar is there yet
        (run / "avatar.npz").unlink()
    words = COMMANDS[verb][0].format(run=run, subject=subject, out=tmp_path / "out")
    refused = refused_or_taken(*words.split())
    if name in runs.AVATAR and ("NaN" in name or "avatar" in name):
        assert refused is not None and "avatar.npz" in refused
    if name in runs.POSES and verb in ("export", "render", "view"):
        assert refused is not None and "poses.npz" in refused
