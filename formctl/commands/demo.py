"""``formctl demo``: one mixed episode, in words and in a picture, on any machine within seconds."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from formctl.options import Overrides, configs

if TYPE_CHECKING:
    import numpy as np

    from envs.formation import FormationEnv
    from formctl.config import Config
    from formctl.methods import Method

SHIPPED = Path(__file__).resolve().parent.parent / "_assets" / "policy.pt"
"""The trained policy that comes with the package, when it comes with one."""


class Flight(NamedTuple):
    """One episode as recorded; T commands, N drones, M balls."""

    row: dict[str, Any]  # its row, as in episodes.parquet
    drones: "np.ndarray"  # (T, N, 3) m
    balls: "np.ndarray"  # (T, M, 3) m, NaN while not in the air
    columns: "np.ndarray"  # (C, 2) m


def command(
    overrides: Overrides = None,
    out: Annotated[Path, typer.Option(help="Where the picture goes.")] = Path("formctl-demo.png"),
) -> None:
    """Fly one episode of the mixed scenario and show what happened."""
    from formctl import methods
    from formctl.console import say

    (config,) = configs(overrides)
    if SHIPPED.exists():
        method = methods.policy(str(SHIPPED), config.runs)
        say("flying the policy that ships with formctl")
    else:
        method = methods.baseline("straight_line", overrides or [])
        say("no trained policy ships with this version: flying the straight-line agent, which avoids nothing")
    flight = record(config, method)
    say(tell(flight.row))
    draw(flight, method.name, config, out)
    say(f"picture: {out}")


def record(config: "Config", method: "Method") -> Flight:
    """Fly the first scenario of the configured seed and keep every position."""
    import numpy as np
    import torch

    from envs import flight, obstacles
    from envs.bank import Bank
    from envs.spec import Scenarios, State
    from formctl import build
    from formctl.evaluation import batches

    env: FormationEnv = build.environment(build.world(config), config.sim)
    agent = method.make(env)
    (scenarios,) = batches(Bank.create(config.scenario, 1, config.seed).scenarios, 1, env.dtype)
    drones, balls = [], []

    def act(state: State, given: Scenarios) -> torch.Tensor:
        position, _, flying = obstacles.balls_at(state, env.time(state))
        drones.append(state.position[0].numpy())
        balls.append(torch.where(flying[0, :, None], position[0], torch.nan).numpy())
        return agent.act(state, given)

    agent.reset(scenarios, env.reset(scenarios))
    rows = flight.fly(env, act, scenarios, config.eval)
    row = {key: values[0] for key, values in rows.items()}
    return Flight(row, np.stack(drones), np.stack(balls), scenarios.columns[0].numpy())


def tell(row: dict[str, Any]) -> str:
    """What happened, in a sentence."""
    words = {
        "": "no collision, and every drone passed the goal line in time",
        "column": "a drone met a column",
        "ball": "a drone was hit by a ball",
        "drone": "two drones met",
        "ground": "a drone fell to the ground",
        "ceiling": "a drone rose above the ceiling",
        "late": "no collision, but the goal line was not passed in time",
    }
    when = "" if row["failure"] in ("", "late") else f" after {row['first_contact_time']:.1f} s"
    time = f", goal after {row['time_to_goal']:.1f} s" if row["reached"] else ""
    return f"{words[str(row['failure'])]}{when}{time}; FM {row['fm']:.2f}, mean speed {row['mean_speed']:.2f} m/s"


def draw(flight: Flight, name: str, config: "Config", out: Path) -> None:
    """Top view: paths of the drones, columns, and paths of the balls."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Circle

    from formctl.files import atomic

    figure = Figure(figsize=(11, 3), layout="constrained")
    axes = figure.subplots()
    for number in range(flight.drones.shape[1]):
        axes.plot(flight.drones[:, number, 1], flight.drones[:, number, 0], lw=1.2, label=f"drone {number + 1}")
    for x, y in flight.columns:
        axes.add_patch(Circle((y, x), config.scenario.column_radius, color="0.35"))
    for number in range(flight.balls.shape[1]):
        axes.plot(flight.balls[:, number, 1], flight.balls[:, number, 0], ":", color="tab:red", lw=1.5)
    for line in config.scenario.field:
        axes.axvline(line, color="0.8", lw=0.8, zorder=0)
    axes.set(xlabel="y in m, direction of flight", ylabel="x in m", aspect="equal", ylim=(-4, 4))
    axes.set_title(f"{name}, scenario {config.scenario.name}: columns grey, balls dotted", fontsize=9)
    axes.legend(loc="upper left", fontsize=7, ncols=flight.drones.shape[1])
    with atomic(out) as temporary:
        figure.savefig(temporary, dpi=150, format="png")
