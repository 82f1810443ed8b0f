"""``python -m benchmarks.serve LIBRARY CHECKOUT``: a process of one library, asked for passes.

A request is a line of JSON, and so is the answer. A request as a third argument is done once.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable
from importlib import import_module
from typing import Any

LEAST = 0.05
"""CPU seconds of a turn: shorter passes are repeated."""
CLOCKS = {"cpu": time.process_time, "wall": time.perf_counter}


def work_of(request: dict[str, Any]) -> Callable[[], Any]:
    """The pass that an entry names."""
    library, _, name = request["work"].partition(".")
    maker: Callable[..., Any] = getattr(import_module(f"benchmarks.using_{library}"), name)
    made: Callable[[], Any] = maker(*request["arguments"])
    return made


def answer(request: dict[str, Any], works: dict[str, Callable[[], Any]]) -> dict[str, Any]:
    """To "prepare" (the first pass, its estimates go to a file), "pass" and "forget"."""
    if request["do"] == "forget":
        works.clear()
        return {"cpu": time.process_time()}
    if request["do"] == "prepare":
        import numpy as np

        works[request["key"]] = work = work_of(request)
        estimates = work()
        if estimates is not None:
            np.save(request["file"], np.asarray(estimates))
        return {}
    work, clock = works[request["key"]], CLOCKS[request["clock"]]
    begin, passes = clock(), 0
    while not passes or clock() - begin < LEAST:
        work()
        passes += 1
    return {"seconds": (clock() - begin) / passes}


def main() -> None:
    """Until there are no more requests."""
    checkout, *request = sys.argv[2:]
    sys.path.insert(0, checkout)
    if request:
        work_of(json.loads(request[0]))()
        return
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what a library prints is no answer
    works: dict[str, Callable[[], Any]] = {}
    for line in sys.stdin:
        try:
            found = answer(json.loads(line), works)
        except Exception as error:  # whatever a library raises
            found = {"error": f"{type(error).__name__}: {error}".replace("\n", " ")[:200]}
        print(json.dumps(found), file=answers, flush=True)


if __name__ == "__main__":
    main()
