"""Run commands and kill them: a line of JSON in, a line of JSON out.

Each command runs in a fork of a process that has imported everything and started no thread, so a
start costs milliseconds. Python's audit events count the fork's changes to the disk: opening to
write, renaming, removing, making folders. Between two of them only the length of an open file
changes, so a kill before each of them covers a kill at any moment.
"""

import json
import os
import resource
import selectors
import signal
import sys

PATIENCE = 900  # seconds before a command counts as hanging
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC
CHANGING = ("os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.link")


class Counter:
    """Counts changes to some files of a folder, and kills its process before one of them."""

    def __init__(self, folder, last, named):
        self.folder, self.last, self.named, self.count = folder, last, named, 0

    def __call__(self, event, arguments):
        if event == "open":
            path, _, flags = arguments
            if not isinstance(flags, int) or not flags & WRITING:
                return
        elif event in CHANGING:
            path = arguments[0]
        else:
            return
        try:
            path = os.fspath(path)
        except TypeError:  # a file descriptor
            return
        # rmtree names files relative to the descriptor of their folder.
        inside = str(path).startswith(self.folder) or (event != "open" and arguments[-1] != -1)
        if not inside or self.named not in str(path):
            return
        if self.count == self.last:
            os.kill(os.getpid(), signal.SIGKILL)
        self.count += 1


def work(task):
    """Run a command in the fork; return its exit code."""
    from gva_mi.__main__ import main
    from gva_mi.jit.frozen import exclusive

    exclusive._forked = False  # Dr.Jit was imported but has started no thread
    signal.alarm(PATIENCE)
    if task["room"] is not None:  # of any file, bytes
        _, most = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (task["room"], most))
    try:
        main(task["words"])
        return 0
    except SystemExit as stop:
        return stop.code or 0
    except BaseException:
        import traceback

        traceback.print_exc()
        return 1
    finally:
        sys.stdout.flush()
        sys.stderr.flush()


def run(task):
    """Run a command in a fork; return its exit code and its output."""
    ends = {name: os.pipe() for name in ("out", "err", "changes")}
    pid = os.fork()
    if pid == 0:
        for number, name in enumerate(ends, start=1):
            os.dup2(ends[name][1], number if number < 3 else ends[name][1])
        counter = Counter(task["folder"], task["last"], task["named"])
        sys.addaudithook(counter)
        code = work(task)
        os.write(ends["changes"][1], str(counter.count).encode())
        os._exit(code)
    said, waiting = dict.fromkeys(ends, b""), selectors.DefaultSelector()
    for name, (reading, writing) in ends.items():
        os.close(writing)
        waiting.register(reading, selectors.EVENT_READ, name)
    while waiting.get_map():
        for key, _ in waiting.select():
            if piece := os.read(key.fd, 1 << 16):
                said[key.data] += piece
            else:
                waiting.unregister(key.fd)
                os.close(key.fd)
    status = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    return {"code": status, **{name: text.decode() for name, text in said.items()}}


def main():
    from gva_mi.cli import VERBS, load

    for verb in VERBS:
        load(verb)
    answers = os.fdopen(os.dup(1), "w")
    for line in sys.stdin:
        answers.write(json.dumps(run(json.loads(line))) + "\n")
        answers.flush()


if __name__ == "__main__":
    main()
