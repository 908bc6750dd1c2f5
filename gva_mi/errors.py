"""The one error a user can cause: input that does not have the expected form."""


class InputError(ValueError):
    """A file, folder or option that cannot be used, in one sentence.

    The sentence names what was found, where, and which form was expected. The command line prints
    it and leaves with exit code 2; everything else is a bug and keeps its traceback.
    """


def require_at_least(command: str, options: object, **smallest: float) -> None:
    """Raise an InputError for the first option below its smallest value, or not a number."""
    for name, least in smallest.items():
        found = getattr(options, name)
        if not found >= least:
            raise InputError(f"{command}: {name} must be at least {least}, got {found}")


def require_positive(command: str, options: object, *names: str) -> None:
    """Raise an InputError for the first option that is not above zero."""
    for name in names:
        found = getattr(options, name)
        if not found > 0:
            raise InputError(f"{command}: {name} must be above 0, got {found}")
