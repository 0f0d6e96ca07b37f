"""The report's tables: cells that know their number, and how they are set in HTML, LaTeX and Markdown."""
