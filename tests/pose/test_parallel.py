"""Whoever does the work, the result is the same to the bit."""

import os
import signal
import sys
from concurrent.futures import CancelledError, Future
from dataclasses import replace

import numpy as np
import pytest
import torch

from gva_mi import InputError
from gva_mi.pose import SequenceOptions, SingleFrameOptions, refine
from gva_mi.pose.parallel import cluster, run, workers
from gva_mi.pose.refine import refine_all

# Three frames in two clips of two, skimmed first.
CLIPS = SequenceOptions(size=64, passes=6, part=2, overlap=0, skim=3)
SINGLE = SingleFrameOptions(size=64, steps=2)


def same(a, b):
    return (
        torch.equal(a.pose.rotations, b.pose.rotations)
        and torch.equal(a.pose.transl, b.pose.transl)
        and torch.equal(a.offsets, b.offsets)
        and a.kept == b.kept
    )


@pytest.fixture(scope="module")
def alone(clip, body):
    """Two subjects, one of which lacks a frame, refined by this process."""
    return list(refine_all(subjects(clip), body))


def subjects(clip):
    return [(clip, CLIPS), (shorter(clip), CLIPS)]


def shorter(clip):
    return replace(clip, pictures=clip.pictures[:2], pose=clip.pose[:2])


def test_a_video_in_clips_shares_one_displacement(alone, clip, body):
    refined = alone[0]
    assert refined.offsets.any() and not refined.kept
    assert (refined.losses < refined.losses_stage1).all()
    assert not torch.equal(refined.pose.rotations, clip.pose.rotations)


def test_a_clip_in_which_nobody_is_seen_changes_nothing_for_the_others(alone, clip, body):
    """The first clip, from which the shared surface could have been taken, says nothing."""
    gone = {0: "it has no picture", 1: "it has no mask"}
    pictures = [(np.zeros((96, 96), np.float32), None)] * 2 + clip.pictures[2:]
    options = replace(CLIPS, part=1)
    refined = refine(replace(clip, pictures=pictures, absent=gone), body, options)
    assert refined.kept == gone and refined.offsets.any()
    assert torch.equal(refined.pose.rotations[:2], clip.pose.rotations[:2])
    assert refined.losses[2] < refined.losses_stage1[2]


def test_several_subjects_are_refined_as_if_alone(alone, clip, body):
    assert same(alone[1], refine(shorter(clip), body, CLIPS))


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 3])
def test_any_number_of_workers_finds_the_same_bits(alone, clip, body, count):
    calls = []
    with workers(count) as pool:
        found = list(refine_all(subjects(clip), body, lambda *a: calls.append(a), pool))
    assert all(same(a, b) for a, b in zip(alone, found, strict=True))
    assert calls == sorted(calls) and calls[-1][0] == calls[-1][1]


@pytest.mark.slow
def test_a_cluster_finds_the_same_bits(alone, clip, body):
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=50
    ) as local:
        with cluster(local.scheduler_address) as executor:
            found = list(refine_all(subjects(clip), body, executor=executor))
    assert all(same(a, b) for a, b in zip(alone, found, strict=True))


@pytest.mark.slow
def test_a_worker_of_a_cluster_that_is_killed_changes_no_bit(alone, clip, body):
    """The scheduler gives its work to the other one, and to the one that takes its place."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=50
    ) as local:
        victims = [next(iter(local.workers.values())).pid]

        def kill(*_, **__):
            while victims:
                os.kill(victims.pop(), signal.SIGKILL)

        with cluster(local.scheduler_address) as executor:
            found = list(refine_all(subjects(clip), body, kill, executor))
    assert not victims
    assert all(same(a, b) for a, b in zip(alone, found, strict=True))


class Killed:
    """Work that ends its process."""

    steps = 1

    def solve(self, progress=None):
        os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.slow
def test_a_worker_that_is_killed_is_one_sentence():
    with workers(2) as pool, pytest.raises(InputError) as error:
        list(run([Killed(), Nested()], pool))
    assert "a worker process, or the scheduler, is gone" in str(error.value)
    assert "\n" not in str(error.value)


KilledWorker = type("KilledWorker", (Exception,), {"__module__": "distributed.scheduler"})


@pytest.mark.parametrize("error", [KilledWorker("lost 3 times"), CancelledError()], ids=repr)
def test_a_scheduler_that_is_gone_is_one_sentence(error):
    """As futures end whose scheduler was killed, and those whose workers all were."""

    class Gone:
        def submit(self, function, work):
            future = Future()
            future.set_exception(error)
            return future

    with pytest.raises(InputError, match="a worker process, or the scheduler, is gone"):
        list(run([Nested()], Gone()))


def test_an_error_of_the_work_itself_is_not_taken_for_a_lost_worker():
    class Broken:
        def submit(self, function, work):
            future = Future()
            future.set_exception(ValueError("a bug"))
            return future

    with pytest.raises(ValueError, match="a bug"):
        list(run([Nested()], Broken()))


def test_single_frames_are_independent_work(clip, body):
    """A frame's result does not depend on what its job also holds."""
    whole = refine(clip, body, SINGLE)
    first = refine(shorter(clip), body, SINGLE)
    assert torch.equal(first.pose.rotations, whole.pose.rotations[:2])


def test_jobs_that_are_not_wanted_any_more_are_cancelled():
    class Future:
        cancelled = 0

        def result(self):
            return "solved"

        def cancel(self):
            Future.cancelled += 1

    class Executor:
        def submit(self, function, job):
            return Future()

    class Work:
        steps = 1

    found = run([Work(), Work(), Work()], Executor())
    assert next(found) == "solved"
    found.close()
    assert Future.cancelled == 3


def test_one_worker_is_this_process():
    with workers(1) as executor:
        assert executor is None
    with pytest.raises(InputError, match="--workers must be at least 1, got 0"):
        workers(0).__enter__()


def test_a_missing_package_and_a_missing_scheduler_are_explained(monkeypatch):
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "distributed", None)
        with pytest.raises(InputError, match=r"pip install 'gva_mi\[cluster\]'"):
            cluster("tcp://127.0.0.1:1").__enter__()
    pytest.importorskip("distributed")
    monkeypatch.setattr("gva_mi.pose.parallel.CONNECT", 0.2)
    with pytest.raises(InputError, match="no scheduler answers at tcp://127.0.0.1:1"):
        cluster("tcp://127.0.0.1:1").__enter__()


class Nested:
    """Work that holds other work."""

    steps = 1

    def __init__(self, *parts):
        self.parts = parts

    def solve(self, progress=None):
        return 1 + sum(done.result for done in run(self.parts))


def test_work_may_hold_work():
    (done,) = run([Nested(Nested(), Nested(Nested()))])
    assert done.result == 4
