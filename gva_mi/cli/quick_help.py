"""Show a command's help without the packages that only its work needs.

Importing torch and Dr.Jit takes a second. Help needs only signatures and option dataclasses, whose
defaults are plain values. So for help alone these packages are replaced by stand-ins, as
``autodoc_mock_imports`` of Sphinx does. The process ends with the help, before anything computes.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

HEAVY = ("drjit", "torch")  # chosen: no other package takes longer than a tenth of a second


def asks_for_help(arguments: Sequence[str]) -> bool:
    """Return whether nothing but help can come of a command's arguments.

    Example:
        >>> asks_for_help(["me", "--help"]), asks_for_help(["--", "--help"]), asks_for_help(["me"])
        (True, False, False)
    """
    return bool(arguments) and arguments[-1] in ("-h", "--help") and "--" not in arguments


def without_heavy_packages() -> None:
    """Let all later imports of these packages in this process find stand-ins."""
    if not set(HEAVY) & sys.modules.keys():
        sys.meta_path.insert(0, _Finder())


class _StandIn(ModuleType):
    """A package, and everything in it: any attribute, call, item or operation gives another one."""

    __path__ = ()

    def __getattr__(self, name: str) -> _StandIn:
        if name.startswith("__"):  # Python asks which protocols an object has
            raise AttributeError(name)
        return _StandIn(name)

    def __call__(self, *values: object, **options: object) -> object:
        return values[0] if len(values) == 1 and callable(values[0]) else self  # as a decorator

    def __mro_entries__(self, bases: tuple) -> tuple:
        return ()  # as the base of a class

    def __iter__(self) -> None:
        raise TypeError(f"{self.__name__} stands in for a package that help does not need")

    def _other(self, *_: object) -> _StandIn:
        return self

    __getitem__ = __or__ = __ror__ = __add__ = __mul__ = __rmul__ = __truediv__ = __neg__ = _other


class _Finder(MetaPathFinder, Loader):
    def find_spec(self, name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        return ModuleSpec(name, self, is_package=True) if name.split(".")[0] in HEAVY else None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        return _StandIn(spec.name)

    def exec_module(self, module: ModuleType) -> None:
        pass
