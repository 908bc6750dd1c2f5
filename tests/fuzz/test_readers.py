"""Whatever a file holds, who reads it ends with one sentence, in bounded time and memory.

Files are made by a seeded generator (mutations.py) of good ones (seeds.py). The short form takes a
few of each kind; ``pytest -m slow tests/fuzz`` more than 10,000.
"""

import random
import resource
import shutil
import signal
from contextlib import contextmanager
from pathlib import Path

import pytest

from gva_mi.core.errors import InputError

READERS = (
    "subject", "views", "true masks", "film", "check", "synth.json", "run", "study", "gaussians",
    "body", "motion", "footage", "ranges", "hdf5", "wham", "gvhmr", "4dhumans",
    "pymafx", "hybrik", "tram", "romp", "multihmr", "smplifyx", "smplerx", "osx", "smplestx",
    "parameters", "snapshot", "instantavatar", "zju", "easymocap", "easymocap smplx", "avatarrex",
    "exavatar", "sam", "onnx", "perceptual",
)  # fmt: skip
SECONDS, MEMORY = 20, 3 << 30  # that one file may take
QUICK, THOROUGH = 12, 400  # files for each reader


@contextmanager
def bounded():
    """No more than so many seconds, and so much memory beyond what this process has."""

    def late(*_):
        raise AssertionError(f"still reading after {SECONDS} s")

    before = resource.getrlimit(resource.RLIMIT_AS)
    now = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    handler = signal.signal(signal.SIGALRM, late)
    signal.alarm(SECONDS)
    resource.setrlimit(resource.RLIMIT_AS, (now + MEMORY, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)
        signal.alarm(0)
        signal.signal(signal.SIGALRM, handler)


@pytest.fixture(scope="module")
def whole(seeds, tmp_path_factory):
    """A folder of good files for a reader, which reads them."""
    made = {}

    def of(name):
        if name not in made:
            write, read = seeds[name]
            made[name] = tmp_path_factory.mktemp(name)
            write(made[name])
            read(made[name])
        return made[name]

    return of


def attack(name, whole, seeds, mutated, tmp_path, count, first=0):
    """How many of so many bad files were refused; the others were taken for good."""
    good, bad, refused = whole(name), tmp_path / "bad", 0
    files = sorted(path.relative_to(good) for path in good.rglob("*") if path.is_file())
    strangers = [(good / path).read_bytes() for path in files][:20]
    shutil.copytree(good, bad)
    for k in range(first, first + count):
        rng = random.Random(f"{name} {k}")
        path = rng.choice(files)
        content = (good / path).read_bytes()
        (bad / path).write_bytes(mutated(rng, path.name, content, strangers))
        try:
            with bounded():
                seeds[name][1](bad, path)
        except InputError as error:
            refused += 1
            sentence = str(error)
            assert "\n" not in sentence and sentence.isprintable(), (name, k, sentence)
            assert len(sentence) < 2000, (name, k, sentence)
        except BaseException as error:
            error.add_note(f"{name}: {path}, file {k}")
            raise
        (bad / path).write_bytes(content)
    return refused


def test_every_reader_has_good_files(seeds):
    assert set(READERS) == set(seeds)


@pytest.mark.parametrize("name", READERS)
def test_some_bad_files(name, whole, seeds, mutated, tmp_path):
    assert attack(name, whole, seeds, mutated, tmp_path, QUICK) > 0 or name in ("check", "run")


@pytest.mark.slow
@pytest.mark.parametrize("name", READERS)
def test_thousands_of_bad_files(name, whole, seeds, mutated, tmp_path):
    attack(name, whole, seeds, mutated, tmp_path, THOROUGH, QUICK)
