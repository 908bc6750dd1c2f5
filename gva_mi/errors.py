"""``from gva_mi.errors import InputError``: where programs that use this package find its error."""

from gva_mi.core.errors import InputError

__all__ = ["InputError"]
