"""The report: its sections from one profile's evidence, the folder they are written to, and the README's block."""

from analysis.report.compose import Report, Section, compose
from analysis.report.files import write

__all__ = ["Report", "Section", "compose", "write"]
