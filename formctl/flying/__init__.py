"""Methods in the air: who flies, through which scenes, what is kept of it, and how it is flown again."""
