"""The search over reward weights: a study of many trials that survives anything (paper, Sec. V-B1)."""
