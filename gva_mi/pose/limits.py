"""Options that cannot be used are refused in one sentence that names the command."""

from __future__ import annotations

from gva_mi.errors import InputError


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
