"""Run folders read back: records, rows, who was measured and where, and what the paper has published."""
