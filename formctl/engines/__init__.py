"""Where work runs: in this process, in worker processes, on a cluster. Nothing here knows what the work is."""
