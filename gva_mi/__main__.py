"""The command line: finds the verb, reads its arguments, and says in one sentence what is wrong."""

from __future__ import annotations

import functools
import io
import os
import re
import select
import sys
from collections.abc import Callable
from contextlib import redirect_stderr

from gva_mi import __version__, llvm
from gva_mi.commands import VERBS, load
from gva_mi.errors import InputError

BAD_INPUT = 2  # exit codes
INTERRUPTED, BROKEN_PIPE = 130, 141  # a shell's for SIGINT and SIGPIPE
OF_COMMANDS = (
    "av jinja2 matplotlib mitsuba PIL pymeshlab roma scipy skimage tqdm trimesh tyro".split()
)


def main(arguments: list[str] | None = None) -> None:
    """Run ``gva-mi``; bad input ends with one sentence and exit code 2."""
    arguments = sys.argv[1:] if arguments is None else arguments
    # torch's idle threads would spin on the cores that Dr.Jit's kernels need; read at its import.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    try:
        try:
            _run(arguments)
        finally:
            sys.stdout.flush()  # here, where a reader that is gone can still be dealt with
    except (InputError, ImportError) as error:
        print(f"gva-mi: {_explained(error)}", file=sys.stderr)
        sys.exit(BAD_INPUT)
    except KeyboardInterrupt:
        print("\ngva-mi: stopped; --resume goes on with a fit", file=sys.stderr)
        sys.exit(INTERRUPTED)
    except BrokenPipeError:
        if not _reader_is_gone():
            raise  # it is another pipe that broke, such as that to a worker
        # Python flushes once more at its end, and would complain: let it write into nothing.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(BROKEN_PIPE)


def _explained(error: InputError | ImportError) -> str:
    """What is wrong; of a package that the bare installation lacks, how it is installed."""
    package = (getattr(error, "name", None) or "").split(".")[0]
    if not isinstance(error, ModuleNotFoundError) or package not in OF_COMMANDS:
        return str(error)
    return f"{package} is not installed; the commands need: pip install 'gva_mi[avatar]'"


def _run(arguments: list[str]) -> None:
    verb = arguments[0] if arguments else ""
    if verb in ("-h", "--help"):
        print(_overview())
    elif verb == "--version":
        print(f"gva-mi {__version__}")
    elif verb.startswith("--tyro-"):
        _write_completion(arguments)
    elif arguments == ["doctor"]:  # without tyro and libLLVM, which may be what is missing
        load(verb)()
    elif verb in VERBS:
        llvm.require()
        _parse(load(verb), f"gva-mi {verb}", arguments[1:])()
    else:
        found = f"there is no command '{verb}'" if verb else "a command is missing"
        raise InputError(f"{found}; expected one of {', '.join(VERBS)}")


def _overview() -> str:
    """What ``gva-mi --help`` says."""
    width = max(map(len, VERBS))
    verbs = "\n".join(f"  {verb:<{width}}  {does}" for verb, does in VERBS.items())
    return (
        "usage: gva-mi [-h] [--version] COMMAND [OPTIONS]\n\n"
        "A monocular video of a person becomes a drivable 3D Gaussian avatar.\n\n"
        f"{verbs}\n\n"
        "gva-mi COMMAND --help tells all options of a command."
    )


def _write_completion(arguments: list[str]) -> None:
    """Let tyro write its script for a shell's completion, which has to know every command."""
    import tyro

    commands = {verb: load(verb) for verb in VERBS}
    tyro.extras.subcommand_cli_from_dict(commands, prog="gva-mi", args=arguments)


def _parse(command: Callable[..., None], program: str, arguments: list[str]) -> Callable[[], None]:
    """Read a command's arguments, and return the call without making it.

    So whatever is raised here is about the arguments, and what the command raises later is not.

    Raises:
        InputError: a value that cannot be read, or that options refuse.
    """
    import tyro

    @functools.wraps(command)
    def call(*values: object, **options: object) -> Callable[[], None]:
        return functools.partial(command, *values, **options)

    complaint = io.StringIO()
    try:
        with redirect_stderr(complaint):
            return tyro.cli(call, prog=program, args=arguments)
    except ValueError as error:  # of options without a prefix, which tyro lets through
        raise InputError(str(error)) from None
    except SystemExit as stop:
        refusal = _refusal(stop)
        if refusal is not None:
            raise InputError(_sentence(refusal, complaint.getvalue())) from None
        sys.stderr.write(complaint.getvalue())  # arguments that are missing, unknown, no choice
        raise


def _refusal(stop: SystemExit) -> ValueError | None:
    """The error of a value for which tyro stopped, which Python keeps as the context of the exit.

    tyro draws a frame around this error's sentence and breaks its lines; the error has it whole.
    """
    error: BaseException | None = stop
    while error is not None and not isinstance(error, ValueError):
        error = error.__context__
    return error


def _sentence(refusal: ValueError, text: str) -> str:
    """What was wrong, with the option's name and form where tyro's text tells them.

    Options refuse a value in a sentence that names them, but text that is no number does not say
    which option it stood for. Then tyro's text has "Error parsing --steps:" in one line and
    "--steps INT" in another. Were its wording to change, the sentence would be the bare error.
    """
    text = re.sub(r"\x1b\[[\d;]*m", "", text)  # colours
    named = re.search(r"Error parsing (--[\w.-]+):", text)
    if named is None:
        return str(refusal)
    option = named.group(1)
    form = re.search(rf"^\W*{option} (.*?)[\s│]*$", text, re.MULTILINE)
    return f"{option} must be {form.group(1)}: {refusal}" if form else f"{option}: {refusal}"


def _reader_is_gone() -> bool:
    """Whether nobody reads the output any more, as after ``gva-mi ... | head``."""
    poll = select.poll()
    poll.register(sys.stdout.fileno(), 0)
    return any(event & select.POLLERR for _, event in poll.poll(0))


if __name__ == "__main__":
    main()
