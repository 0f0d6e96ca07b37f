"""What people look at: the files that a recording becomes."""
