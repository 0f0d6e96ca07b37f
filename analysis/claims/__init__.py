"""The paper's claims held against the evidence."""
