"""Whatever a file holds, its reader ends with one sentence, in bounded time and memory.

Damaged files come from a seeded generator and good ones (samples/mutations.py and the seeds beside
it). The quick test takes 12 files of the main readers, ``pytest -m slow tests/fuzz`` 400 of every
reader.
"""

import random
import resource
import shutil
import signal
from contextlib import contextmanager
from pathlib import Path

import pytest
from samples.mutations import mutated
from samples.reader_seeds import readers
from samples.seeds import seeds as good_files

from gva_mi.core.errors import InputError

READERS = ("subject", "video", "run", "study", "gaussians", "body", "motion", "wham", "gvhmr",
           "romp", "zju", "smplerx")  # fmt: skip
SECONDS, MEMORY = 20, 3 << 30  # that one file may take
QUICK, THOROUGH = 12, 400  # files for each reader


@pytest.fixture(scope="module")
def seeds(subject, known):
    """For each reader, a function that writes its good files and one that reads them."""
    return good_files(subject, known) | readers()


@contextmanager
def bounded():
    """Allow SECONDS, and MEMORY beyond what this process has."""

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


def attack(name, seeds, tmp_path, count, first=0):
    """Damage one good file after another; return how many of them were refused."""
    (write, read), good, bad, refused = seeds[name], tmp_path / "good", tmp_path / "bad", 0
    good.mkdir()
    write(good)
    read(good)
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
                read(bad, path)
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


@pytest.mark.parametrize("name", READERS)
def test_some_bad_files(name, seeds, tmp_path):
    assert attack(name, seeds, tmp_path, QUICK) > 0 or name == "run"


@pytest.mark.slow
@pytest.mark.parametrize("name", READERS)
def test_hundreds_of_bad_files(name, seeds, tmp_path):
    attack(name, seeds, tmp_path, THOROUGH, QUICK)
