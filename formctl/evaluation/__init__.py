"""Methods in the air: one function flies, everything that needs flights calls it, and every episode becomes one row."""
