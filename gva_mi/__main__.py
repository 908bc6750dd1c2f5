"""The entry point ``gva-mi``: find the command, read its arguments, explain errors."""

from __future__ import annotations

import errno
import os
import shutil
import sys
from contextlib import suppress
from typing import NoReturn

from gva_mi import __version__
from gva_mi.cli import VERBS, load
from gva_mi.cli.parse import parse
from gva_mi.cli.quick_help import asks_for_help, without_heavy_packages
from gva_mi.core import cpu, llvm
from gva_mi.core.console import complete_streams, discard_what_is_unread
from gva_mi.core.errors import InputError, is_memory

BAD_INPUT = 2  # exit codes
INTERRUPTED, BROKEN_PIPE = 130, 141  # a shell's for SIGINT and SIGPIPE
ALL_COMPLETE = "all files on disk are complete"
DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  # full disk, quota, largest file
AFTER_STOP = {  # how to continue after Ctrl-C
    "avatar": "run the same command again to resume",
    "batch": "run the same command again to resume",
    "fit": "run it with --resume to continue",
    "render": "run the same command again to resume",
    "study": "run the same command again to resume",
}
PACKAGES_OF_COMMANDS = (
    "av jinja2 matplotlib mitsuba PIL pymeshlab scipy skimage tqdm trimesh tyro".split()
)


def main(arguments: list[str] | None = None) -> None:
    """Run a command; bad input ends with one sentence and exit code 2."""
    arguments = sys.argv[1:] if arguments is None else arguments
    complete_streams()
    # Read when torch is imported: its idle threads must not spin on the cores that Dr.Jit needs.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    cpu.pin_cpu_features()
    try:
        try:
            _run(arguments)
        except RuntimeError as error:
            raise _original(error) from None
        finally:
            sys.stdout.flush()  # here, where a closed pipe can still be handled
    except InputError as error:
        _end(BAD_INPUT, str(error))
    except KeyboardInterrupt:
        verb = arguments[0] if arguments else ""
        _end(INTERRUPTED, f"stopped; {AFTER_STOP.get(verb, ALL_COMPLETE)}", "\n")
    except BrokenPipeError:  # the reader of the output has closed it
        _end(BROKEN_PIPE)
    except shutil.Error as error:  # while a folder was copied: from, to and reason of each file
        _, to, reason = error.args[0][0]
        _end(BAD_INPUT, f"{to}: {reason}; {ALL_COMPLETE}")
    except OSError as error:  # a full disk, an unreadable folder
        if error.strerror is None or (error.filename is None and error.errno not in DISK_FULL):
            raise
        _end(BAD_INPUT, f"{error.filename or 'the output'}: {error.strerror}; {ALL_COMPLETE}")
    except (MemoryError, RuntimeError, ImportError) as error:
        if is_memory(error):
            _end(BAD_INPUT, f"there is not enough memory ({error!s:.200}); {ALL_COMPLETE}")
        if not isinstance(error, ImportError):
            raise
        _end(BAD_INPUT, _explained(error))


def _original(error: BaseException) -> BaseException:
    """Return what a function raised that Dr.Jit recorded: Dr.Jit makes a RuntimeError of it."""
    while isinstance(error, RuntimeError) and error.__cause__ is not None:
        error = error.__cause__
    return error


def _end(code: int, sentence: str = "", before: str = "") -> NoReturn:
    """Print a sentence and exit, even if stderr is closed."""
    with suppress(OSError):
        if sentence:
            print(f"{before}gva-mi: {sentence}", file=sys.stderr)
    discard_what_is_unread()
    sys.exit(code)


def run() -> None:
    """Run :func:`main` as a process, and exit without cleanup after Ctrl-C.

    Dr.Jit and Mitsuba may crash or hang in their cleanup after interrupted kernels. Files, locks
    and workers are cleaned up before.
    """
    try:
        main()
    except SystemExit as stop:
        if stop.code == INTERRUPTED:
            with suppress(OSError):
                sys.stdout.flush()
                sys.stderr.flush()
            os._exit(INTERRUPTED)
        raise


def _explained(error: ImportError) -> str:
    """Return the error's sentence; for a missing package, how to install it."""
    package = (error.name or "").split(".")[0]
    if not isinstance(error, ModuleNotFoundError) or package not in PACKAGES_OF_COMMANDS:
        return str(error)
    return f"{package} is not installed; the commands need: pip install 'gva_mi[avatar]'"


def _run(arguments: list[str]) -> None:
    verb = arguments[0] if arguments else ""
    try:
        os.getcwd()  # without a working folder, oneMKL ends the process with a message of its own
    except FileNotFoundError:
        raise InputError("the working folder does not exist any more; cd to another one") from None
    if verb in ("-h", "--help"):
        print(_overview())
    elif verb == "--version":
        print(f"gva-mi {__version__}")
    elif arguments == ["doctor"]:  # works without tyro and libLLVM, which may be missing
        load(verb)()
    elif verb in VERBS:
        if asks_for_help(arguments):
            without_heavy_packages()
        else:
            llvm.require()
        parse(load(verb), verb, arguments[1:])()
    else:
        found = f"there is no command '{verb}'" if verb else "a command is missing"
        raise InputError(f"{found}; expected one of {', '.join(VERBS)}")


def _overview() -> str:
    """Return the text of ``gva-mi --help``."""
    width = max(map(len, VERBS))
    verbs = "\n".join(f"  {verb:<{width}}  {does}" for verb, does in VERBS.items())
    return (
        "usage: gva-mi [-h] [--version] COMMAND [OPTIONS]\n\n"
        "A monocular video of a person becomes a drivable 3D Gaussian avatar.\n\n"
        f"{verbs}\n\n"
        "gva-mi COMMAND --help lists all options of a command."
    )


if __name__ == "__main__":
    run()
