"""What all tests share: one thread each, no windows, no settings from the developer's shell."""

import os

os.environ["OMP_NUM_THREADS"] = "1"  # before torch is imported; two workers share two cores
os.environ["MPLBACKEND"] = "Agg"
os.environ["COLUMNS"] = "100"  # help pages and tables are compared word for word
os.environ.pop("FORMCTL_TRACEBACK", None)
