"""Tables in Markdown, LaTeX (booktabs) and HTML."""

import re
from html import escape

import pandas as pd
from pandas.io.formats.style import Styler

from analysis.tables.table import Cell, Column, Table

_LATEX = {
    "\\": r"\textbackslash{}",
    **{mark: rf"\{mark}" for mark in "&%$#_{}"},
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "–": "--",
    "−": "$-$",
    "·": r"$\cdot$",
    "≥": r"$\geq$",
    "≤": r"$\leq$",
    "±": r"$\pm$",
    "↑": r"$\uparrow$",
    "↓": r"$\downarrow$",
    "Δ": r"$\Delta$",
    "×": r"$\times$",
    "|": r"\textbar{}",
    "<": r"$<$",
    ">": r"$>$",
}


def latex_text(text: str) -> str:
    """Plain text as LaTeX: every special character escaped."""
    return "".join(_LATEX.get(character, character) for character in text)


def markdown(table: Table) -> str:
    """GitHub-flavoured Markdown: heading, pipe table, caption, notes and stamp."""
    lines = [f"**{table.title}**", ""]
    lines.append("| " + " | ".join(_pipe(column.title) for column in table.columns) + " |")
    lines.append("|" + "|".join(":--" if column.left else "--:" for column in table.columns) + "|")
    lines += ["| " + " | ".join(_pipe(cell.plain()) for cell in row) + " |" for row in table.rows]
    notes = [f"- {note}" for note in table.notes]
    return "\n".join([*lines, "", table.caption, *notes, "", f"<sub>{table.stamp}</sub>", ""])


def latex(table: Table) -> str:
    """A ``table*`` float for IEEEtran with booktabs rules; needs ``\\usepackage{booktabs,array}`` only."""
    cells = [[_latex_cell(cell, column) for column, cell in zip(table.columns, row, strict=True)] for row in table.rows]
    frame = pd.DataFrame(cells, columns=[latex_text(column.title) for column in table.columns])
    layout = "".join(map(_latex_column, table.columns))
    body = frame.style.hide(axis="index").to_latex(hrules=True, column_format=layout).splitlines()
    first = body.index(r"\midrule") + 1
    for number in sorted(set(table.groups) - {0}, reverse=True):
        body.insert(first + number, r"\addlinespace")
    small = [latex_text(text) for text in (*table.notes, str(table.stamp))]
    return "\n".join(
        [
            "% " + str(table.stamp).replace("·", "|").replace("–", "-"),
            r"\begin{table*}[t]",
            r"\centering\small",
            rf"\caption{{{latex_text(table.title)}. {latex_text(table.caption)}}}",
            rf"\label{{tab:{table.key}}}",
            *body,
            *[rf"\\{'[2pt]' * (not n)} {{\scriptsize {text}}}" for n, text in enumerate(small)],
            r"\end{table*}",
            "",
        ]
    )


def html(table: Table) -> str:
    """A ``<figure>`` with the table, its caption, notes and stamp; styled by the report."""
    caption = f"<figcaption><b>{escape(table.title)}.</b> {escape(table.caption)}</figcaption>"
    notes = "".join(f"<p class=note>{escape(note)}</p>" for note in table.notes)
    stamp = f'<p class="stamp">{escape(str(table.stamp))}</p>'
    cells = _cells(table).format(_html_cell)  # type: ignore[arg-type]
    grid = cells.to_html(table_uuid=table.key, cell_ids=False)
    return (
        f'<figure class="table" id="tab-{table.key}">{caption}<div class="scroll">{grid}</div>{notes}{stamp}</figure>'
    )


def _cells(table: Table) -> Styler:
    """The table as pandas styles it: a frame of cells with their classes and alignment."""
    frame = pd.DataFrame(
        [list(row) for row in table.rows], columns=[escape(c.title) for c in table.columns], dtype=object
    )
    classes = [[_classes(c, column) for column, c in zip(table.columns, row, strict=True)] for row in table.rows]
    left = [
        {"selector": f".col{n}", "props": "text-align: left"} for n, column in enumerate(table.columns) if column.left
    ]
    rules = [
        {"selector": f"tbody tr:nth-child({number + 1}) td", "props": "border-top-color: currentColor"}
        for number in table.groups
        if number
    ]
    marks = pd.DataFrame(classes, index=frame.index, columns=frame.columns)
    return frame.style.hide(axis="index").set_td_classes(marks).set_table_styles([*left, *rules])  # type: ignore[list-item]


def _classes(cell: Cell, column: Column) -> str:
    known = (("wide", bool(column.wide)), ("missing", cell.missing), ("paper", cell.paper))
    return " ".join(name for name, on in known if on)


def _html_cell(cell: Cell) -> str:
    return escape(cell.text) + "".join(f"<small>{escape(line)}</small>" for line in cell.details)


def _latex_column(column: Column) -> str:
    if column.wide:
        return rf">{{\raggedright\arraybackslash}}p{{{column.wide:g}\textwidth}}"
    return "l" if column.left else "c"


def _latex_cell(cell: Cell, column: Column) -> str:
    text = rf"{{\itshape {latex_text(cell.text)}}}" if cell.missing else latex_text(cell.text)
    if not cell.details:
        return text
    if column.wide:  # breaks its lines itself
        return text + "".join(rf"\newline {{\scriptsize {latex_text(line)}}}" for line in cell.details)
    # Several lines in one cell without another package: the number above, its small print below.
    small = "".join(rf"\\{{\scriptsize {latex_text(line)}}}" for line in cell.details)
    return rf"\shortstack[{'l' if column.left else 'c'}]{{{text}{small}}}"


def _pipe(text: str) -> str:
    return re.sub(r"\s+", " ", text).replace("|", "\\|")
