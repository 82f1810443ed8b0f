"""What is imported only when it is asked for: modules of a package [PEP 562], scipy, and packages
that only extras of celnav bring.

``import celnav`` is fast, enough, and needs numpy and scipy alone.
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
    """``__getattr__`` and ``__dir__`` of a package that imports its modules when they are asked
    for.

    doors: modules of which the public names are the package's own as well, the first that has a
        name.
    late: names of the package, and the modules that have them.
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
                # No attribute where its package is not installed: `help` and `hasattr` ask for all.
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
    """A module that is imported when a name of it is first asked for."""

    def __init__(self, module: str):
        self._module = module

    def __getattr__(self, name: str) -> Any:
        self.__dict__[name] = value = getattr(import_module(self._module), name)
        return value


class MissingError(ImportError):
    """A package of an extra of celnav is not installed; the message is the command that does so."""

    def __init__(self, what: str, module: str, extra: str):
        cure = f'{PIP} install -c constraints.txt -e ".[{extra}]"'
        super().__init__(
            f"{what} needs {module}: in the folder of celnav, {cure} brings it", name=module
        )


@contextmanager
def requires_extra(what: str, extra: str) -> Iterator[None]:
    """Around imports of packages that an extra brings. MissingError names ``what`` needs the first
    that is not installed.
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
    except ModuleNotFoundError:  # from a finder that refuses it
        return False
