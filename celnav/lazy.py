"""Imports on first use: modules of a package [PEP 562], scipy, and packages of celnav's extras.

So ``import celnav`` is fast, gives access to all modules, and requires only numpy and scipy.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from importlib.util import find_spec
from pkgutil import iter_modules
from typing import Any

PIP = r".venv\Scripts\pip" if sys.platform == "win32" else ".venv/bin/pip"


def modules(
    package: str, *doors: str, **late: str
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """``__getattr__`` and ``__dir__`` of a package that imports its modules on first use.

    doors: modules whose public names are also names of the package; the first module with a name
        provides it.
    late: further names of the package, and the modules that have them.
    """

    def getattribute(name: str) -> Any:
        parent = sys.modules[package]
        if name in late:
            setattr(parent, name, getattr(import_module(late[name]), name))
            return vars(parent)[name]
        if not name.startswith("_"):
            try:
                return import_module(f"{package}.{name}")
            except MissingError as error:
                # AttributeError if a package is not installed, because `help` and `hasattr` try all
                # names.
                raise AttributeError(str(error), name=name, obj=parent) from error
            except ModuleNotFoundError as error:
                if error.name != f"{package}.{name}":
                    raise
            for door in doors:
                if name in (module := import_module(f"{package}.{door}")).__all__:
                    return vars(module)[name]
        raise AttributeError(f"module {package!r} has no attribute {name!r}", name=name, obj=parent)

    def directory() -> list[str]:
        parent = sys.modules[package]
        names = {*vars(parent), *late, *(info.name for info in iter_modules(parent.__path__))}
        with suppress(MissingError):
            names.update(
                name for door in doors for name in import_module(f"{package}.{door}").__all__
            )
        return sorted(names)

    return getattribute, directory


class LazyModule:
    """A module that is imported when one of its names is first used."""

    def __init__(self, module: str):
        self._module = module

    def __getattr__(self, name: str) -> Any:
        self.__dict__[name] = value = getattr(import_module(self._module), name)
        return value


class MissingError(ImportError):
    """A package of one of celnav's extras is not installed; the message has the command that
    installs it.
    """

    def __init__(self, what: str, module: str, extra: str):
        if sys.platform == "emscripten":  # Pyodide, which has no pip
            cure = f"await micropip.install('{module}') brings it if Pyodide has it"
        else:
            pip = f'{PIP} install -c constraints.txt -e ".[{extra}]"'
            cure = f"in the folder of celnav, {pip} brings it"
        super().__init__(f"{what} needs {module}: {cure}", name=module)


@contextmanager
def requires_extra(what: str, extra: str) -> Iterator[None]:
    """A context for imports of packages from an extra. If a package is not installed, MissingError
    names it and ``what`` needs it.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        raise MissingError(what, str(error.name).partition(".")[0], extra) from None


def require(what: str, extra: str, *packages: str) -> None:
    """Raise `MissingError` if one of the packages is not installed, before work begins."""
    with requires_extra(what, extra):
        for package in packages:
            if find_spec(package) is None:
                raise ModuleNotFoundError(name=package)


def installed(package: str) -> bool:
    """Whether a package of an extra is installed."""
    try:
        return find_spec(package) is not None
    except ModuleNotFoundError:  # from an import finder that blocks the package
        return False
