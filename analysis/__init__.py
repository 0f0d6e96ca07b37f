"""What the runs have shown, in one direction: data -> stats -> tables -> figures -> claims -> report.

Reads plain files only (JSON, YAML, Parquet), so it works from a notebook:

    from analysis.data import evidence, rows
    from analysis.tables import main
    seen = evidence.gather(rows.load("runs"), profile="laptop")
    print(main.tables(seen)[0].frame())

``recordings`` stand beside: single episodes as numbers, MCAP and pages.
"""
