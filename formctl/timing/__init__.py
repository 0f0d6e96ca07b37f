"""How fast learners are: what `formctl bench` takes apart and holds against marks and a yardstick."""
