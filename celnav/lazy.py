"""Modules of a package as its attributes, imported when asked for: ``import celnav`` is fast, and enough [PEP 562]."""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib import import_module
from pkgutil import iter_modules
from typing import Any


def modules(package: str, *doors: str) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """``__getattr__`` and ``__dir__`` of a package that imports its modules when they are asked for.

    doors: modules of which the public names are the package's own as well, the first that has a name.
    """

    def getattribute(name: str) -> Any:
        if not name.startswith("_"):
            try:
                return import_module(f"{package}.{name}")
            except ModuleNotFoundError as error:
                if error.name != f"{package}.{name}":
                    raise
            for door in doors:
                if name in vars(module := import_module(f"{package}.{door}")):
                    return vars(module)[name]
        raise AttributeError(f"module {package!r} has no attribute {name!r}", name=name, obj=sys.modules[package])

    def directory() -> list[str]:
        own = sys.modules[package]
        public = (name for door in doors for name in vars(import_module(f"{package}.{door}")) if name[0] != "_")
        return sorted({*vars(own), *(found.name for found in iter_modules(own.__path__)), *public})

    return getattribute, directory
