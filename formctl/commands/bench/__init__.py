"""``formctl bench``: how fast world, learners and planners run on this machine, and what the search's store costs."""

import typer

from formctl.commands.bench.env import env
from formctl.commands.bench.eval import flights
from formctl.commands.bench.learn import learn
from formctl.commands.bench.pilot import pilot
from formctl.commands.bench.planners import planners
from formctl.commands.bench.store import store
from formctl.commands.bench.train import train

app = typer.Typer(help="Measure the speed of world, learners and store on this machine.", add_completion=False)


@app.callback()
def bench() -> None:
    """Measure the speed of world, learners and store on this machine."""


app.command("env")(env)
app.command("eval")(flights)
app.command("store")(store)
app.command("planners")(planners)
app.command("train")(train)
app.command("learn")(learn)
app.command("pilot")(pilot)
