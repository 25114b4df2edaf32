"""Speed and correctness next to other tools, measured in one run: `python -m benchmarks` from the project's root."""

import os

# One BLAS thread for every tool alike, before numpy loads: the matrices are tiny, and threads that wait for each other blur the times.
for _variable in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
