"""Tasks run in order, here or in an executor; an error of theirs is raised, lost work explained."""

from concurrent.futures import CancelledError, Future

import pytest

from gva_mi import InputError
from gva_mi.core.tasks import run


class Nested:
    """A task that runs other tasks."""

    steps = 1

    def __init__(self, *parts):
        self.parts = parts

    def solve(self, progress=None):
        return 1 + sum(done.result for done in run(self.parts))


def test_a_task_may_run_tasks():
    (done,) = run([Nested(Nested(), Nested(Nested()))])
    assert done.result == 4


class Failing:
    """An executor whose tasks end with an error."""

    def __init__(self, error):
        self.error = error

    def submit(self, function, task):
        future = Future()
        future.set_exception(self.error)
        return future


def test_cancelled_work_is_one_sentence():
    with pytest.raises(InputError, match="a worker process is gone"):
        list(run([Nested()], Failing(CancelledError())))


def test_an_error_of_the_task_itself_is_raised_as_it_is():
    with pytest.raises(ValueError, match="a bug"):
        list(run([Nested()], Failing(ValueError("a bug"))))


def test_remaining_tasks_are_cancelled():
    class Pending:
        cancelled = 0
        result = staticmethod(lambda: "solved")

        def cancel(self):
            Pending.cancelled += 1

    class Executor:
        submit = staticmethod(lambda function, task: Pending())

    found = run([Nested()] * 3, Executor())
    assert next(found) == "solved"
    found.close()
    assert Pending.cancelled == 3
