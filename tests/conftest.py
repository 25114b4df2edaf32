"""Small matrices and parallel tests: threads inside the linear algebra only get in each other's way. Set before numpy loads."""

import os

for variable in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(variable, "1")
