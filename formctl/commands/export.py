"""``formctl export``: a policy as ONNX, with a contract that says how to feed it and a proof that it is the same."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from formctl.commands.options import Overrides, ShowConfig, configs

if TYPE_CHECKING:
    from algos.export import Field, Parity
    from algos.policy import Policy
    from envs.formation import FormationEnv
    from formctl.evaluation.methods import Method
    from formctl.settings import Config

TOLERANCE = 1e-5
"""Largest difference between torch and onnxruntime of commands in [-1, 1] and thrust in [0, 1]."""

FORMAT = "formctl-contract-1"


def command(
    policy: Annotated[str, typer.Argument(metavar="RUN|FILE", help="A trained policy.")],
    overrides: Overrides = None,
    out: Annotated[Path | None, typer.Option(help="Write to this folder instead of RUNS/export/NAME/ID.")] = None,
    observations: Annotated[int, typer.Option(min=1, help="Recorded observations that the proof compares.")] = 1000,
    cfg: ShowConfig = False,
) -> None:
    """Write a policy as ONNX with a contract and a proof of parity.

    The graph takes measurements in SI units and gives body rates and thrust; the task (course, speed, height,
    formation) and the drone's limits are those of the settings: scenario=real_mixed drone.rate_clip=0.785
    drone.thrust_range=[0.4,0.9] for real flights.
    """
    from algos import export
    from formctl.console import say
    from formctl.evaluation import methods
    from formctl.settings import build
    from formctl.store import provenance

    export.require()
    words = list(overrides or [])
    (config,) = configs(words, show=cfg)
    method = methods.policy(policy, config.runs)
    loaded = method.policy()
    methods.check_observation(config, [method], words)
    config = method.settings_of(config)
    env = build.environment(build.world(config), "torch")
    loaded.check(env)
    run = provenance.new_run(
        config, "export", method.name, parents=method.parents, method=method.facts, scenario=config.scenario.name,
        folder=out,
    )  # fmt: skip
    with run.work() as live:
        path = live.path / "policy.onnx"
        say(f"about to trace {method.name} for scenario {config.scenario.name}: a minute or two")
        export.write(loaded, env, path)
        proofs = [prove(loaded, env, path, observations, config, balls) for balls in counts(loaded, config)]
        contract = describe(config, method, loaded, env, path, proofs)
        write(live.path / "contract.json", contract)
        live.update(result={"parity": [asdict(proof) for proof in proofs], "onnx_sha256": contract["onnx"]["sha256"]})
        show(proofs)
    say(f"policy:   {path}")
    say(f"contract: {run.path / 'contract.json'}")


def counts(policy: "Policy", config: "Config") -> list[int]:
    """Numbers of balls that the proof flies: the scenario's, and another one where the encoder takes any."""
    from algos.export import free_sizes

    own = config.scenario.balls
    return [own, own + 3] if "M" in free_sizes(policy) else [policy.balls]


def prove(
    policy: "Policy", env: "FormationEnv", path: Path, observations: int, config: "Config", balls: int
) -> "Parity":
    """Hold the file against torch on flights among ``balls`` balls. Raises RunFailed where they differ."""
    from algos import export
    from formctl.errors import RunFailed
    from formctl.settings import build, restore

    scene = restore(config.tree | {"scenario": config.tree["scenario"] | {"balls": balls}})
    inputs = export.record(policy, build.environment(build.world(scene), "torch"), observations, config.eval.seed)
    parity = export.compare(path, policy, env, inputs)
    if not parity.worst <= TOLERANCE:
        raise RunFailed(
            f"{path}: its command differs from torch's by {parity.worst:.1e} with {balls} balls, more than "
            f"{TOLERANCE:.0e}: do not fly this file"
        )
    return parity


def describe(
    config: "Config", method: "Method", policy: "Policy", env: "FormationEnv", path: Path, proofs: "list[Parity]"
) -> dict[str, Any]:
    """``contract.json``: everything that somebody without this program needs to fly the file."""
    import hashlib

    from algos import export
    from formctl.store import provenance

    scenario, drone = config.scenario, config.drone
    return {
        "format": FORMAT,
        "onnx": {
            "file": path.name,
            "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
            "opset": export.OPSET,
            "free_sizes": list(export.free_sizes(policy)),
        },
        "rate_hz": 1 / drone.control_period,
        "frames": {
            "world": "x right of the course, y along it, z up; origin on the ground below the formation's start",
            "body": "x forward, y left, z up; rates by the right-hand rule; drones face world x and fly along y",
            "quaternion": "w, x, y, z; rotates body vectors into the world",
        },
        "inputs": [entry(field, env) for field in export.fields(policy)],
        "outputs": [entry(field, env) for field in export.OUTPUTS],
        "limits": {
            "rate_clip_rad_s": min(drone.rate_clip, drone.rate_limit),
            "thrust_range": list(drone.thrust_range),
            "thrust_full_scale_n": 4 * drone.max_thrust,
            "thrust_bias": drone.thrust_bias,
            "thrust_note": "a command c lifts full_scale * (c + bias): the simulated motor map adds the bias",
        },
        "crazyflie": {
            "cflib": "Commander.send_setpoint(roll, pitch, yawrate, thrust), flightmode.stabModeRoll and Pitch at 0",
            "rates": "degrees of rates_setpoint",
            "thrust": "round(65535 * min(1, thrust_setpoint + thrust_bias)); the firmware cuts at 60000",
        },
        "task": {
            "start_m": list(scenario.start),
            "velocity_m_s": list(scenario.velocity),
            "height_m": scenario.height,
            "slots_m": env.slots.tolist(),
            "sensing_range_m": scenario.sensing_range,
            "altitude_m": list(scenario.altitude),
        },
        "observation": {"name": policy.observation.name, "inside_the_graph": True},
        "parity": {"tolerance": TOLERANCE, "runtime": "onnxruntime", "flights": [asdict(proof) for proof in proofs]},
        "policy": method.facts,
        "provenance": provenance.collect(),
    }


def entry(field: "Field", env: "FormationEnv") -> dict[str, Any]:
    """An input or output as the contract names it."""
    shape = [env.drones if part == "N" else int(part) if part.isdigit() else part for part in field.shape]
    kind = "bool" if field.unit == "bool" else "float32"
    unit = "" if field.unit == "bool" else field.unit
    return {"name": field.name, "shape": shape, "type": kind, "unit": unit, "frame": field.frame} | {
        "meaning": field.meaning
    }


def write(path: Path, contract: dict[str, Any]) -> None:
    """The contract with its own hash: of everything in it but the hash."""
    import hashlib
    import json

    from formctl.store.files import plain, write_json

    text = json.dumps(plain(contract), sort_keys=True)
    write_json(path, contract | {"sha256": hashlib.sha256(text.encode()).hexdigest()})


def show(proofs: "list[Parity]") -> None:
    """The proofs as a table."""
    from formctl import console

    rows = [
        (f"{p.observations:,}", p.columns, p.balls, *(f"{value:.1e}" for value in p.largest.values()), "equal")
        for p in proofs
    ]
    names = ("rates, rad/s", "thrust", "command")
    console.table(
        ("observations", "columns", "balls", *names, f"command within {TOLERANCE:.0e}"),
        rows,
        title="torch against onnxruntime",
    )
