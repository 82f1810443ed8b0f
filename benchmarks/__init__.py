"""Speed of celnav against its peers; see README.md. Not part of the package.

Importing this package holds every numerical library to one thread, so that CPU time is the cost of
the algorithm. That works only before numpy is imported: start it with ``python -m benchmarks``.
"""

import os

for _name in ("OMP", "OPENBLAS", "MKL", "NUMEXPR", "NUMBA", "VECLIB_MAXIMUM"):
    os.environ[f"{_name}_NUM_THREADS"] = "1"
os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
os.environ["JAX_PLATFORMS"] = "cpu"
os.environ["JAX_ENABLE_X64"] = "1"
