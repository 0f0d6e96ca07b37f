"""``formctl demo``: one mixed episode, in words and in a picture, on any machine within seconds."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from formctl.options import Overrides, configs

if TYPE_CHECKING:
    from analysis.figures.topview import Flight
    from formctl.config import Config
    from formctl.methods import Method

SHIPPED = Path(__file__).resolve().parent.parent / "_assets" / "policy.pt"
"""The trained policy that comes with the package, when it comes with one."""

CONTACTS = {
    "column": "a drone met a column",
    "ball": "a ball met a drone",
    "drone": "two drones met",
    "ground": "a drone fell to the ground",
    "ceiling": "a drone rose above the ceiling",
}
"""What ends a flight, in words."""


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
    flight, row = record(config, method)
    say(tell(row))
    draw(flight, f"{method.name}, scenario {config.scenario.name}", out)
    say(f"picture: {out}")


def record(config: "Config", method: "Method") -> "tuple[Flight, dict[str, Any]]":
    """Fly the first scenario of the configured seed; returns what was recorded and the episode's row."""
    import numpy as np
    import torch

    from analysis.figures.topview import Flight
    from envs import flight, obstacles
    from envs.bank import Bank
    from envs.spec import Scenarios, State
    from formctl import build
    from formctl.evaluation import batches

    env = build.environment(build.world(config), config.sim)
    agent = method.make(env)
    (scenarios,) = batches(Bank.create(config.scenario, 1, config.seed).scenarios, 1, env.dtype)
    times, drones, balls = [], [], []

    def act(state: State, given: Scenarios) -> torch.Tensor:
        position, _, flying = obstacles.balls_at(state, env.time(state))
        times.append(float(env.time(state)[0]))
        drones.append(state.position[0].numpy())
        balls.append(torch.where(flying[0, :, None], position[0], torch.nan).numpy())
        return agent.act(state, given)

    agent.reset(scenarios, env.reset(scenarios))
    rows = flight.fly(env, act, scenarios, config.eval)
    row = {key: values[0] for key, values in rows.items()}
    contact = (float(row["first_contact_time"]), int(row["contact_drone"]), str(row["failure"]))
    recorded = Flight(
        times=np.array(times),
        positions=np.stack(drones),
        columns=scenarios.columns[0].numpy(),
        balls=np.stack(balls),
        hits=[contact] if row["failure"] in CONTACTS else [],
        goal=config.scenario.goal,
        column_radius=config.scenario.column_radius,
        ball_radius=config.scenario.ball_radius,
    )
    return recorded, row


def tell(row: dict[str, Any]) -> str:
    """What happened, in a sentence."""
    met = CONTACTS.get(str(row["failure"]))
    first = f"{met} after {row['first_contact_time']:.1f} s" if met else "no collision"
    goal = f"every drone past the goal line after {row['time_to_goal']:.1f} s" if row["reached"] else "goal not reached"
    return f"{first}; {goal}; FM {row['fm']:.2f} m, mean speed {row['mean_speed']:.2f} m/s"


def draw(flight: "Flight", title: str, out: Path) -> None:
    """The episode from above, as PNG."""
    from analysis.figures.topview import draw_topview
    from formctl.files import atomic

    figure = draw_topview(flight, title)
    with atomic(out) as temporary:
        figure.savefig(temporary, dpi=150, format="png")
