"""Filters on a device: their PTX as it is written, and their flights by a driver that is the host's."""

from __future__ import annotations

import ctypes
import re
import shutil
import subprocess

import numpy as np
import pytest
import test_compiled as bodies
import test_compiled_runs as runs
from fake_cuda import Driver, installed
from twice import assert_same, told, twice

import celnav
from celnav.tape import cuda

pytest.importorskip("llvmlite")

ROUNDED = re.compile(r"^\s*(?:@\S+\s+)?((?:add|sub|mul|fma|mad|div|rcp|sqrt)\.\S*f64)", re.M)


@pytest.fixture
def driver(monkeypatch):
    found = installed(monkeypatch, Driver())
    yield found
    assert not found.memory


def flown(*arguments, **options):
    """A flight by numpy and one by the device, which agree."""
    known, found = twice(*arguments, engine="cuda", **options)
    assert_same(known, found, engine="cuda")
    return known, found


def sound(text, tmp_path):
    """PTX has its entry, of eleven parameters, no calls, and is rounded as IEEE has it; ``ptxas`` takes it, where there is one."""
    assert len(re.findall(r"^\.visible \.entry entry\(", text, re.M)) == 1
    assert len(re.findall(r"^\s+\.param \.u64 .*entry_param_\d+", text, re.M)) == 11
    assert ".extern" not in text
    assert not re.search(r"\bcall\b", text)
    found = set(ROUNDED.findall(text))
    assert found
    assert all(".rn." in name for name in found), found
    assert not re.search(r"\.(approx|ftz|full)\b", text)
    if assembler := shutil.which("ptxas"):
        (tmp_path / "text.ptx").write_text(text)
        done = subprocess.run([assembler, "-arch=sm_80", "text.ptx", "-o", "text.cubin"], cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr


# -- every filter --------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", bodies.FALLS)
def test_filters_of_a_falling_body(name, driver, tmp_path):
    filter, z = bodies.FALLS[name]
    flown(filter, bodies.MANY, bodies.TIMES, z, keep="cov")
    for text in driver.sources:
        sound(text, tmp_path)
