"""Tests run studies and notebooks with few runs; the kernels of notebooks inherit this."""

import os

os.environ.setdefault("CELNAV_EFFORT", "0.03")
os.environ.setdefault("OMP_NUM_THREADS", "1")
