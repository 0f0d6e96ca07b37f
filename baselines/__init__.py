"""Methods to compare with: planners and sanity agents behind one protocol, named by dotted strings in ``conf/baseline/``."""
