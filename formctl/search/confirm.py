"""How good the chosen weights are on episodes and with seeds that they were not chosen on.

The highest of many noisy rates is too high: its trial was lucky as well as good. So the winner is flown on a bank of
its own, and the best trials are trained again, with seeds of their own and more steps; both rates are shown.
"""

from contextlib import closing
from typing import Any

from envs.bank import Bank
from formctl import store
from formctl.console import say, warn
from formctl.evaluation import methods
from formctl.evaluation.evaluate import evaluate
from formctl.evaluation.rows import rates, write_rows
from formctl.evaluation.scenes import EvaluationScene, save_bank
from formctl.search import table, trial, winner, worker
from formctl.search.leases import Ticket
from formctl.search.study import WeightStudy
from formctl.search.table import Row
from formctl.search.trial import TrialRequest
from formctl.settings import Config, build, restore
from formctl.store import provenance
from formctl.store.compare import fingerprint

BANK = "fresh.npz"
"""The episodes that no trial is chosen on, in the search's folder."""


def fly_winner(study: WeightStudy, run: store.Run, config: Config) -> Row:
    """Fly the winner on the fresh bank and note its rate, unless that is known; returns its row.

    Where its policy is on another host, that is said instead. Raises StoreError while no trial is done.
    """
    row, wanted = winner.choose(study.rows()), config.search.fresh_episodes
    if row["sr_fresh_n"] == wanted:
        return row
    policy = run.path / str(row["policy"])
    if not policy.is_file():
        warn(f"trial {row['trial']} is not flown again: its policy is on {row['host']}, not in {policy}")
        return row
    say(f"flying the winner, trial {row['trial']}, on {wanted} fresh episodes")
    settings = restore(trial.settings(config, study.name, row["trial"], table.weights(row)))
    build.use_threads(settings)
    scene = EvaluationScene(build.world(settings), fresh_bank(run, config))
    rows = evaluate(methods.policy(str(policy), config.runs), [scene], settings)
    write_rows(policy.with_name("fresh.parquet"), rows)
    figures = rates(rows)
    study.note_trial(row["trial"], **{f"sr_fresh{part}": figures[f"sr{part}"] for part in ("", "_k", "_n")})
    study.write_table()
    return winner.choose(study.rows())


def retrain_best(study: WeightStudy, run: store.Run, config: Config) -> None:
    """Train the best trials of a whole study again as ``search.confirm`` says, and note what became of them.

    It is a study of its own in the same database: it can be interrupted, resumed and shared as the search is.
    """
    spec = config.search.confirm
    if not spec.trials:
        return
    fresh_bank(run, config)
    best = winner.by_rate(study.rows())[: spec.trials]
    again = [(row, config.seed + 1 + number) for row in best for number in range(spec.seeds)]
    with closing(retraining(study, run, config, [row for row, _ in again])) as retrained:
        if retrained.missing(len(again)):
            say(f"training the best {len(best)} trials again: {spec.seeds} seeds each, {spec.budget} times the steps")

            def ask(ticket: Ticket) -> TrialRequest:
                return request(config, run, ticket, *again[ticket.trial])

            if study.url.drivername == "sqlite":  # its one owner is here
                retrained.leases.end_all()
            worker.work(retrained, config, len(again), ask, label=f"confirm {run.path.parent.name}")
        note(study, [row for row, _ in again], retrained.rows())


def retraining(study: WeightStudy, run: store.Run, config: Config, trained: list[Row]) -> WeightStudy:
    """The study that trains the weights of these trials of ``study`` again, one training each, made or gone on with."""
    numbers, vectors = [row["trial"] for row in trained], [table.weights(row) for row in trained]
    digest = fingerprint({"of": numbers, "confirm": config.tree["search"]["confirm"]})
    folder = run.path / "confirm" / digest
    folder.mkdir(parents=True, exist_ok=True)
    retrained = WeightStudy.create(
        folder,
        seed=study.seed,
        rule="given",
        settings=study.settings,
        url=study.url,
        name=f"{study.name}.confirm-{digest}",
        vectors=vectors,
        trials=len(trained),
    )
    retrained.lease = study.lease
    return retrained


def note(study: WeightStudy, trained: list[Row], rows: list[Row]) -> None:
    """Put on the record of each trial how often its weights satisfied when they were trained again."""
    for number in dict.fromkeys(row["trial"] for row in trained):
        done = [rows[k] for k, row in enumerate(trained) if row["trial"] == number and rows[k]["state"] == "done"]
        if done:
            k, n = sum(row["sr_k"] for row in done), sum(row["sr_n"] for row in done)
            study.note_trial(number, sr_again=k / n, sr_again_k=k, sr_again_n=n, seeds_again=len(done))
    study.write_table()


def request(config: Config, run: store.Run, ticket: Ticket, row: Row, seed: int) -> TrialRequest:
    """The training of a trial's weights with another seed and more steps."""
    number, steps = row["trial"], config.search.confirm.budget * config.search.steps
    tree: dict[str, Any] = trial.settings(config, run.path.parent.name, number, table.weights(row))
    tree |= {"seed": seed, "name": f"{tree['name']}-seed{seed}", "train": tree["train"] | {"steps": steps}}
    own = {"label": f"trial {number}, seed {seed}", "folder": f"trials/{number:04d}-seed{seed}-{steps}", "bank": BANK}
    return TrialRequest(str(run.path), run.path.name, ticket.trial, settings=tree, argv=provenance.argv(), **own)


def fresh_bank(run: store.Run, config: Config) -> Bank:
    """The episodes that no trial is chosen on, drawn once and kept."""
    path, scenario, episodes = run.path / BANK, config.search.scenario, config.search.fresh_episodes
    if path.exists() and len(bank := Bank.load(path)) == episodes:
        return bank
    return save_bank(path, scenario, episodes, build.held_out_seed(config.seed, "fresh"))
