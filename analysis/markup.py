"""Tables in Markdown, LaTeX (booktabs) and HTML. A missing cell points to its command, listed below the table."""

import re
from html import escape

from analysis.cells import Cell, Column, Table

_LATEX = {
    "\\": r"\textbackslash{}",
    "&": r"\&",
    "%": r"\%",
    "$": r"\$",
    "#": r"\#",
    "_": r"\_",
    "{": r"\{",
    "}": r"\}",
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
    """GitHub-flavoured Markdown: heading, pipe table, caption, commands and stamp."""
    lines = [f"**{table.title}**", ""]
    lines.append("| " + " | ".join(_pipe(column.title) for column in table.columns) + " |")
    lines.append("|" + "|".join(":--" if column.left else "--:" for column in table.columns) + "|")
    for row in table.rows:
        cells = []
        for cell in row:
            mark = f" [{table.mark(cell)}]" if cell.command else ""
            cells.append(_pipe(cell.plain() + mark))
        lines.append("| " + " | ".join(cells) + " |")
    lines += ["", table.caption]
    lines += [f"- {note}" for note in table.notes]
    if table.commands:
        lines += ["", "To fill what was not measured:", ""]
        lines += [f"{number}. `{command}`" for number, command in enumerate(table.commands, start=1)]
    return "\n".join([*lines, "", f"<sub>{table.stamp}</sub>", ""])


def latex(table: Table) -> str:
    """A ``table*`` float for IEEEtran with booktabs rules; needs ``\\usepackage{booktabs,array}`` only."""
    layout = "".join(_latex_column(column) for column in table.columns)
    lines = [
        "% " + str(table.stamp).replace("·", "|").replace("–", "-"),
        r"\begin{table*}[t]",
        r"  \centering\small",
        rf"  \caption{{{latex_text(table.title)}. {latex_text(table.caption)}}}",
        rf"  \label{{tab:{table.key}}}",
        rf"  \begin{{tabular}}{{{layout}}}",
        r"    \toprule",
        "    " + " & ".join(latex_text(column.title) for column in table.columns) + r" \\",
        r"    \midrule",
    ]
    for number, row in enumerate(table.rows):
        if number in table.groups and number > 0:
            lines.append(r"    \addlinespace")
        cells = (_latex_cell(table, cell, column) for cell, column in zip(row, table.columns, strict=True))
        lines.append("    " + " & ".join(cells) + r" \\")
    lines += [r"    \bottomrule", r"  \end{tabular}"]
    small = [latex_text(note) for note in table.notes]
    small += [rf"$^{{{n}}}$\,\texttt{{{latex_text(command)}}}" for n, command in enumerate(table.commands, start=1)]
    small.append(latex_text(str(table.stamp)))
    lines += [
        rf"  \\[2pt] {{\scriptsize {text}}}" if n == 0 else rf"  \\ {{\scriptsize {text}}}"
        for n, text in enumerate(small)
    ]
    return "\n".join([*lines, r"\end{table*}", ""])


def _latex_column(column: Column) -> str:
    if column.wide:
        return rf">{{\raggedright\arraybackslash}}p{{{column.wide:g}\textwidth}}"
    return "l" if column.left else "c"


def html(table: Table) -> str:
    """A ``<figure>`` with the table, its caption, the commands that fill it and its stamp; styled by the report."""
    head = "".join(f'<th scope="col"{_align(column.left)}>{escape(column.title)}</th>' for column in table.columns)
    body = []
    for number, row in enumerate(table.rows):
        kind = ' class="group"' if number in table.groups and number > 0 else ""
        cells = "".join(_html_cell(table, cell, column) for cell, column in zip(row, table.columns, strict=True))
        body.append(f"<tr{kind}>{cells}</tr>")
    notes = "".join(f"<p class=note>{escape(note)}</p>" for note in table.notes)
    commands = "".join(f"<li><code>{escape(command)}</code></li>" for command in table.commands)
    fill = f'<div class="fill"><p>To fill what was not measured:</p><ol>{commands}</ol></div>' if commands else ""
    caption = f"<figcaption><b>{escape(table.title)}.</b> {escape(table.caption)}</figcaption>"
    grid = f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(body)}</tbody></table>"
    stamp = f'<p class="stamp">{escape(str(table.stamp))}</p>'
    below = f"{notes}{fill}{stamp}"
    return f'<figure class="table" id="tab-{table.key}">{caption}<div class="scroll">{grid}</div>{below}</figure>'


def _pipe(text: str) -> str:
    return re.sub(r"\s+", " ", text).replace("|", "\\|")


def _latex_cell(table: Table, cell: Cell, column: Column) -> str:
    if cell.missing:
        mark = f"$^{{{table.mark(cell)}}}$" if cell.command else ""
        return rf"{{\itshape {latex_text(cell.text)}}}{mark}"
    text = latex_text(cell.text) + (f"$^{{{table.mark(cell)}}}$" if cell.command else "")
    if not cell.details:
        return text
    if column.wide:  # breaks its lines itself
        return text + "".join(rf"\newline {{\scriptsize {latex_text(line)}}}" for line in cell.details)
    # Several lines in one cell without another package: the number above, its small print below.
    small = "".join(rf"\\{{\scriptsize {latex_text(line)}}}" for line in cell.details)
    return rf"\shortstack[{'l' if column.left else 'c'}]{{{text}{small}}}"


def _html_cell(table: Table, cell: Cell, column: Column) -> str:
    known = (("left", column.left), ("wide", bool(column.wide)), ("missing", cell.missing), ("paper", cell.paper))
    kinds = [name for name, on in known if on]
    label = f' class="{" ".join(kinds)}"' if kinds else ""
    if cell.missing:
        mark = f" <sup>{table.mark(cell)}</sup>" if cell.command else ""
        return f'<td{label} title="{escape(cell.command, quote=True)}">{escape(cell.text)}{mark}</td>'
    mark = f" <sup>{table.mark(cell)}</sup>" if cell.command else ""
    small = "".join(f"<small>{escape(line)}</small>" for line in cell.details)
    return f"<td{label}>{escape(cell.text)}{mark}{small}</td>"


def _align(left: bool) -> str:
    return ' class="left"' if left else ""
