"""Methods to compare with: planners and sanity agents behind one protocol, one YAML each in ``conf/baseline/``."""
