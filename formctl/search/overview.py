"""How far a study is and what is best in it, asked of its database: nothing heavy is imported for it."""

import json
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from formctl.search.ledger import STATES, Ledger

_FIGURE = "CAST(NULLIF({name}.value_json, 'null') AS double precision)"
BEST = """SELECT t.trial_id, t.number FROM trials t
    JOIN trial_values v ON v.trial_id = t.trial_id AND v.objective = 0
    LEFT JOIN trial_user_attributes cfr ON cfr.trial_id = t.trial_id AND cfr.key = 'cfr'
    LEFT JOIN trial_user_attributes fm ON fm.trial_id = t.trial_id AND fm.key = 'fm'
    WHERE t.study_id = :study AND t.state = 'COMPLETE' AND v.value >= (SELECT min(value) FROM (
        SELECT value FROM trial_values JOIN trials ON trials.trial_id = trial_values.trial_id
        WHERE trials.study_id = :study AND trials.state = 'COMPLETE' AND objective = 0
        ORDER BY value DESC LIMIT :count) AS highest)
    ORDER BY v.value DESC, {cfr} DESC NULLS LAST, {fm} ASC NULLS LAST, t.number LIMIT :count""".replace(
    "{cfr}", _FIGURE.replace("{name}", "cfr")
).replace("{fm}", _FIGURE.replace("{name}", "fm"))
"""Highest SR; equal SR is decided by CFR, then lower FM, then lower number."""


@dataclass(frozen=True)
class Working:
    """A trial that is being worked on, or waits for a worker."""

    trial: int
    steps: int
    host: str | None  # None: nobody works on it
    process: int | None
    silent: float  # s since the last sign of life
    losses: int


def counts(ledger: Ledger) -> dict[str, int]:
    """Trials per state: done, failed, pruned, running."""
    found = dict.fromkeys(dict.fromkeys(STATES.values()), 0)
    for row in ledger.ask("SELECT state, count(*) AS trials FROM trials WHERE study_id = :study GROUP BY state"):
        found[STATES[row.state]] += row.trials
    return found


def working(ledger: Ledger) -> list[Working]:
    """Trials that are not finished, lowest number first."""
    rows = ledger.ask(
        """SELECT t.number, l.host, l.process, l.token, coalesce({now} - l.seen, 0) AS silent,
            coalesce(l.losses, 0) AS losses, (SELECT max(step) FROM trial_intermediate_values i
            WHERE i.trial_id = t.trial_id) AS steps
        FROM trials t LEFT JOIN formctl_leases l ON l.trial_id = t.trial_id
        WHERE t.study_id = :study AND t.state = 'RUNNING' ORDER BY t.number"""
    )
    return [
        Working(row.number, row.steps or 0, row.host if row.token else None, row.process, row.silent, row.losses)
        for row in rows
    ]


def losses(ledger: Ledger) -> int:
    """Workers that were lost in the middle of a trial, over the whole study."""
    (row,) = ledger.ask("SELECT coalesce(sum(losses), 0) AS total FROM formctl_leases WHERE study_id = :study")
    return int(row.total)


def top(ledger: Ledger, count: int) -> list[dict[str, Any]]:
    """The best finished trials as rows: ``trial``, ``trial_id`` and every column that is known of them."""
    found = ledger.ask(BEST, count=count)
    known = columns(ledger, [row.trial_id for row in found])
    return [{"trial": row.number, "trial_id": row.trial_id, "state": "done", **known[row.trial_id]} for row in found]


def one(ledger: Ledger, trial: int) -> dict[str, Any] | None:
    """The row of one trial; None where there is no such trial."""
    query = "SELECT trial_id, state FROM trials WHERE study_id = :study AND number = :trial"
    rows = ledger.ask(query, trial=trial)
    if not rows:
        return None
    known = columns(ledger, [rows[0].trial_id])[rows[0].trial_id]
    return {"trial": trial, "trial_id": rows[0].trial_id, "state": STATES[rows[0].state], **known}


def failures(ledger: Ledger, count: int) -> list[tuple[int, str]]:
    """The last failed trials and why."""
    rows = ledger.ask(
        """SELECT t.number, a.value_json FROM trials t
        LEFT JOIN trial_user_attributes a ON a.trial_id = t.trial_id AND a.key = 'error'
        WHERE t.study_id = :study AND t.state = 'FAIL' ORDER BY t.number DESC LIMIT :count""",
        count=count,
    )
    return [(row.number, str(json.loads(row.value_json or '"no reason on record"'))) for row in reversed(rows)]


def columns(ledger: Ledger, trial_ids: Iterable[int]) -> dict[int, dict[str, Any]]:
    """Parameters and attributes of trials, by their ids in the database."""
    ids = [int(trial_id) for trial_id in trial_ids]
    found: dict[int, dict[str, Any]] = {trial_id: {} for trial_id in ids}
    for start in range(0, len(ids), 500):
        some = ", ".join(map(str, ids[start : start + 500])) or "NULL"
        query = f"SELECT trial_id, param_name, param_value FROM trial_params WHERE trial_id IN ({some})"
        for row in ledger.ask(query):
            found[row.trial_id][row.param_name] = row.param_value
        query = f"SELECT trial_id, key, value_json FROM trial_user_attributes WHERE trial_id IN ({some})"
        for row in ledger.ask(query):
            found[row.trial_id][row.key] = json.loads(row.value_json)
    return found
