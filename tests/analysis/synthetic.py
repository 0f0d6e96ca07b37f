"""A made-up store with known answers: run folders as the commands write them, filled from simple laws."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from envs.vocabulary import METRIC_VERSION

SAID = {
    "straight_line": ("Straight line", "sanity"),
    "hover": ("Hover", "sanity"),
    "swarm_rl": ("Swarm-RL", "published"),
    "rmader": ("R-MADER", "published"),
    "rmader_fair": ("R-MADER, fair", "fair"),
    "rmader_real": ("R-MADER, for real flights", "flight"),
    "swarm_formation": ("Swarm-Formation", "published"),
    "swarm_formation_fair": ("Swarm-Formation, fair", "fair"),
}
"""Label and role of every baseline, as its YAML says them."""
ABLE = {"straight_line": 0.16, "hover": 0.0, "swarm_rl": 0.80, "rmader": 0.24, "swarm_formation": 0.10}


@dataclass
class Made:
    """Writes run folders below ``root``; ids count upwards so that their order is their time."""

    root: Path
    count: int = 0
    ids: dict[str, str] = field(default_factory=dict)

    def run(self, kind: str, name: str, **record: Any) -> Path:
        """A run folder with its record; returns the folder."""
        self.count += 1
        id = f"20251101T{self.count:06d}-{self.count:04x}"
        folder = self.root / kind / name / id
        folder.mkdir(parents=True)
        config = record.pop("config", {})
        base = {"schema": 1, "kind": kind, "name": name, "id": id, "status": "done", "profile": "laptop", "seed": 0}
        base |= {"argv": ["formctl", kind], "created": "2025-11-01T10:00:00Z", "started": "2025-11-01T10:00:01Z"}
        base |= {"finished": "2025-11-01T10:20:00Z", "minutes": 19.5, "parents": [], "budget": {}, "result": {}}
        base |= {"error": None, "provenance": PROVENANCE}
        (folder / "run.json").write_text(json.dumps(base | record))
        (folder / "config.yaml").write_text(json.dumps(config))
        return folder

    def training(self, seed: int = 0, steps: int = 6_000_000, log: bool = True, **changed: Any) -> str:
        """A finished training; returns its id. ``changed``: profile, name, experiment, and the names of groups."""
        facts = {
            "algo": "mappo",
            "encoder": "attention",
            "curriculum": "three_period",
            "reward": "shaped",
            "name": "main",
        }
        profile = changed.pop("profile", "laptop")
        facts |= changed
        config = {key: {"name": facts[key]} for key in ("algo", "encoder", "curriculum", "reward")}
        config |= {"train": {"steps": steps}, "weights": {"name": facts.get("weights", "@stage1/best")}, "seed": seed}
        config |= {"scenario": {"name": facts["scenario"]}} if "scenario" in facts else {}
        method = {key: facts[key] for key in ("name", "algo", "encoder", "curriculum", "experiment") if key in facts}
        method |= {"kind": "policy", "weights": WEIGHTS, "steps": steps, "seed": seed}
        folder = self.run("train", facts["name"], profile=profile, seed=seed, method=method, config=config)
        record = json.loads((folder / "run.json").read_text())
        record["method"]["run"] = folder.name
        (folder / "run.json").write_text(json.dumps(record))
        if log:
            (folder / "metrics.jsonl").write_text(log_lines(seed + len(facts["encoder"] + facts["curriculum"]), steps))
        return folder.name

    def policy(self, id: str) -> dict[str, Any]:
        """The ``method`` facts of a training made before."""
        folder = next(self.root.glob(f"train/*/{id}"))
        return dict(json.loads((folder / "run.json").read_text())["method"])

    def baseline(self, name: str) -> dict[str, Any]:
        """The ``method`` facts of a baseline."""
        return {"name": name, "kind": "baseline", "algo": "", "encoder": "", "curriculum": "", "weights": []} | {
            "steps": 0,
            "seed": 0,
            "run": "",
        }

    def evaluation(
        self, method: Mapping[str, Any], frames: Sequence[pd.DataFrame] | pd.DataFrame, **record: Any
    ) -> Path:
        """An evaluation of ``method`` with these episode rows."""
        frame = frames if isinstance(frames, pd.DataFrame) else pd.concat(frames, ignore_index=True)
        settings = record.pop("config", {"scenario": {"hit_radius": 0.15}, "eval": {"strict_radius": 0.21}})
        if method["kind"] == "baseline":
            label, role = SAID[str(method["name"])]
            said = {"label": label, "role": role, "target": str(method["name"]).partition("_fair")[0]}
            settings = {"baseline": said} | settings
        parents = [method["run"]] if method["run"] else []
        folder = self.run("eval", str(method["name"]), method=method, config=settings, parents=parents, **record)
        profile = record.get("profile", "laptop")
        frame = frame.assign(method=method["name"], seed=method["seed"], run=folder.name, profile=profile)
        frame.to_parquet(folder / "episodes.parquet", index=False)
        return folder


PROVENANCE = {
    "git": {"commit": "38e1a72c0ffee", "dirty": False},
    "versions": {"python": "3.11.7", "torch": "2.13.0", "mujoco": "4.0.1"},
    "host": {"name": "bench", "processor": "AMD EPYC", "cores": 2, "memory_gib": 23.5},
}
WEIGHTS = [0.25, 0.25, 0.3, 0.2]


def episodes(
    count: int,
    success: float,
    fm: float = 0.2,
    *,
    seed: int = 0,
    scenario: str = "mixed",
    columns: int = 10,
    balls: int = 2,
    ball_aim: str = "drone",
    sim: str = "torch",
    bank: str = "b" * 12,
    metric_version: int = METRIC_VERSION,
) -> pd.DataFrame:
    """Rows of ``count`` episodes: success and FM drawn from simple laws, other flags made consistent with them."""
    rng = np.random.default_rng([seed, count, columns, balls])
    ok = rng.random(count) < success
    strict = ok & (rng.random(count) < 0.95)
    formation = rng.random(count) < 0.97
    flight = ok | (rng.random(count) < 0.6)
    obstacle = ok | ~flight
    action = rng.random(count) < 0.9
    frame = pd.DataFrame({"scenario_id": np.arange(count), "cfr": ok, "cfr_strict": strict, "reached": flight})
    frame["sr"] = ok & formation & action
    frame = frame.assign(ok_formation=formation, ok_flight=flight, ok_obstacle=obstacle, ok_action=action)
    frame["fm"] = rng.gamma(8, fm / 8, count)
    frame = frame.assign(scenario=scenario, columns=columns, balls=balls, ball_aim=ball_aim, drones=3, sim=sim)
    return frame.assign(
        drone="crazyflie", bank=bank, metric_version=metric_version, failure=np.where(ok, "", "column"), hit_ball=False
    )


def log_lines(seed: int, steps: int, points: int = 60) -> str:
    """A training's ``metrics.jsonl``: three periods, a collision-free share that rises and an FM that falls."""
    rng = np.random.default_rng(seed)
    lines = []
    for number in range(1, points + 1):
        share = number / points
        period = "free" if share <= 0.05 else "static" if share <= 0.52 else "mixed"
        began, top = {"free": (0.0, 1.0), "static": (0.05, 0.93), "mixed": (0.52, 0.90)}[period]
        free = top - 0.55 * np.exp(-9 * (share - began)) + rng.normal(0, 0.015)
        entry = {"steps": int(share * steps), "period": period, "minutes": 40 * share}
        entry["train/collision_free"] = float(np.clip(free, 0, 1))
        entry["train/cfr"] = float(np.clip(free * (1 - np.exp(-7 * share)), 0, 1))
        entry["train/fm"] = float(0.15 + 1.2 * np.exp(-5 * share) + abs(rng.normal(0, 0.02)))
        lines.append(json.dumps(entry))
    return "\n".join(lines) + "\n"


def trials(count: int, seed: int = 0) -> pd.DataFrame:
    """A study's table: weights uniform on the simplex, SR highest where obstacle and action carry weight."""
    rng = np.random.default_rng(seed)
    weights = rng.dirichlet(np.ones(4), size=count)
    centre = np.array([0.22, 0.2, 0.33, 0.25])
    chance = 0.92 * np.exp(-9 * ((weights - centre) ** 2).sum(axis=1))
    hits = rng.binomial(200, chance)
    frame = pd.DataFrame(weights, columns=["w_formation", "w_flight", "w_obstacle", "w_action"])
    frame.insert(0, "trial", np.arange(count))
    frame.insert(1, "state", "done")
    frame = frame.assign(seed=np.arange(count), steps=1_000_000, minutes=6.0, sr_k=hits, sr_n=200, sr=hits / 200)
    return frame.assign(cfr=np.minimum(1, hits / 200 + 0.05), fm=0.2, policy="", error="")


def full_store(root: Path, profile: str = "laptop", count: int = 300, seeds: Sequence[int] = (0, 1, 2)) -> Made:
    """A store in which everything was measured: three seeds, all baselines, both sweeps, ablations, a study."""
    made = Made(root)
    study = made.run("search", "main", profile=profile, config={"search": {"steps": 1_000_000}})
    trials(48).to_parquet(study / "trials.parquet", index=False)
    for seed in seeds:
        id = made.training(seed, profile=profile)
        made.evaluation(made.policy(id), _everything(count, 0.92 - 0.02 * seed, 0.16, 0.006, seed), profile=profile)
    for name, base in ABLE.items():
        level = {"swarm_rl": 0.9, "rmader": 2.8, "swarm_formation": 1.4}.get(name, 0.02)
        few = count if base in (0.16, 0.0, 0.8) else max(20, count // 10)
        made.evaluation(made.baseline(name), _everything(few, base, level, 0.02, 77), profile=profile)
    for encoder, curriculum in (("no_ca", "three_period"), ("no_sa", "three_period"), ("mlp", "three_period")):
        id = made.training(0, profile=profile, encoder=encoder, curriculum=curriculum, name=f"{encoder}-{curriculum}")
        made.evaluation(made.policy(id), episodes(count, 0.6, 0.3, seed=5), profile=profile)
    for curriculum in ("three_period_dynamic", "two_period", "none"):
        id = made.training(0, profile=profile, curriculum=curriculum, name=f"attention-{curriculum}")
        made.evaluation(made.policy(id), episodes(count, 0.7, 0.25, seed=6), profile=profile)
    return made


def _everything(count: int, base: float, fm: float, slope: float, seed: int) -> list[pd.DataFrame]:
    frames = [episodes(count, base, fm, seed=seed)]
    for columns in (5, 10, 15, 20):
        share = float(np.clip(base - slope * (columns - 8), 0, 1))
        frames.append(
            episodes(count, share, fm * (1 + 0.02 * columns), seed=seed, scenario="static", columns=columns, balls=0)
        )
    for balls in (1, 2, 3, 4, 5):
        share = float(np.clip(base - 2.5 * slope * (balls - 1.5), 0, 1))
        frames.append(
            episodes(count, share, fm * (1 + 0.05 * balls), seed=seed, scenario="dynamic", columns=0, balls=balls)
        )
    return frames
