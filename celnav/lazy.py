"""Modules of a package as its attributes, imported when asked for: ``import celnav`` is fast, and enough [PEP 562]."""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib import import_module
from pkgutil import iter_modules
from types import ModuleType


def modules(package: str) -> tuple[Callable[[str], ModuleType], Callable[[], list[str]]]:
    """``__getattr__`` and ``__dir__`` of a package that imports its modules when they are asked for."""

    def getattribute(name: str) -> ModuleType:
        if not name.startswith("_"):
            try:
                return import_module(f"{package}.{name}")
            except ModuleNotFoundError as error:
                if error.name != f"{package}.{name}":
                    raise
        raise AttributeError(f"module {package!r} has no attribute {name!r}", name=name, obj=sys.modules[package])

    def directory() -> list[str]:
        own = sys.modules[package]
        return sorted({*vars(own), *(found.name for found in iter_modules(own.__path__))})

    return getattribute, directory
