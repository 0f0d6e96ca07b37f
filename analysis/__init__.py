"""What the runs have shown: rows to statistics, tables, figures and one report.

Reads plain files only (JSON, YAML, Parquet) and imports none of the other packages, so it works from a notebook:

    from analysis import evidence, rows, tables
    store = rows.load("runs")
    seen = evidence.gather(store, profile="laptop")
    print(tables.main(seen)[0].markdown())
"""
