"""Settings of all tests."""

import os
import signal

# Before NumPy is imported: BLAS threads wait for each other on small matrices when several tests run at once.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# A shell starts background jobs with SIGINT ignored, and children inherit that: tests that interrupt a
# program need it to listen.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
