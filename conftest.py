"""Tests run studies and notebooks with few runs, and each paper's study once; the kernels of
notebooks inherit this.
"""

import atexit
import json
import os
import shutil
import sys
import tempfile

import pytest

os.environ.setdefault("CELNAV_EFFORT", "0.03")
os.environ.setdefault("OMP_NUM_THREADS", "1")
# A hundred processes import the package: each would compile its source anew without bytecode.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
if (
    "PYTEST_XDIST_WORKER" not in os.environ
):  # a worker has the folder of the process that started it
    os.environ["CELNAV_OUT"] = tempfile.mkdtemp(prefix="celnav-tests-")
    atexit.register(shutil.rmtree, os.environ["CELNAV_OUT"], ignore_errors=True)


def pytest_collection_modifyitems(items):
    """The papers first: what their tests have flown, notebooks read."""
    items.sort(key=lambda item: "papers" not in item.path.parts)


@pytest.fixture(autouse=True, scope="module")
def machine_code(request):
    """Machine code is not optimized, which takes half of the time, except where a module asks for
    it.

    A module that compares the code that users get with numpy has ``OPTIMIZED = True``.
    """
    from celnav.tape import llvm

    with pytest.MonkeyPatch.context() as patch:
        if getattr(request.module, "OPTIMIZED", False):
            patch.setattr(llvm, "_ADDRESSES", {})  # of code that is not
        else:
            patch.setattr(llvm, "QUICK", 0)
        yield


@pytest.fixture(autouse=True, scope="session")
def valid_claims():
    """Every ledger that a test writes follows the schema."""
    from celnav.files import Outputs, data

    write = Outputs.bytes

    def checked(outputs, name, content):
        if name in ("claims.json", "checks.json"):
            from jsonschema import Draft202012Validator

            schema = json.loads(data("claims.schema.json").read_text(encoding="utf-8"))
            Draft202012Validator(schema).validate(json.loads(content))
        write(outputs, name, content)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Outputs, "bytes", checked)
        yield


@pytest.fixture
def eager(monkeypatch):
    """`celnav.run` is numpy's where no engine is named, and "auto" compiles whatever can be
    compiled.
    """
    from celnav.engine import compiled
    from celnav.filters.run import ENGINE

    monkeypatch.setattr(compiled, "operation_limit", lambda *_work: compiled.MOST_AUTO)
    monkeypatch.setattr(compiled, "SHARED", 10**6)
    token = ENGINE.set("numpy")
    yield
    ENGINE.reset(token)


@pytest.fixture(autouse=True)
def no_viewer(request, monkeypatch):
    """Studies are written without the viewer for the browser, 23 MB, except in tests of it."""
    from celnav.show import viewer

    if "package" not in request.fixturenames:
        monkeypatch.setattr(viewer, "available", lambda: False)
