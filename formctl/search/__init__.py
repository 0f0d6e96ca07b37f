"""Stage 1 of the paper: a study of reward-weight vectors, a policy and a satisfaction rate for each (Sec. V-B1)."""
