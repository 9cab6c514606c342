"""Settings of all tests."""

import os

# Before NumPy is imported: BLAS threads wait for each other on small matrices when several tests run at once.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
