"""A policy as C: PyTorch's commands, nothing outside the limits whatever the inputs, no changed file flown."""

import json
import math
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import torch

from algos.export import c, contract, layout, sources
from algos.export.layout import Bounds
from algos.policy import Policy
from formctl import store
from formctl.deployment import export, toolchain
from formctl.deployment.contract import read
from formctl.errors import RunFailed
from formctl.evaluation import methods
from formctl.evaluation.rows import read_rows
from formctl.settings import build, compose

BOUNDS = Bounds()
WARNINGS = ["-std=c99", "-O1", "-pedantic", *toolchain.WARNINGS]
STUBS = Path(__file__).parent / "firmware_stubs"


def subject(name: str, *words: str) -> export.Subject:
    config = compose(["scenario=mixed", *words])
    method = methods.policy(name, config.runs)
    config = method.settings_of(config)
    return export.Subject(method, config, build.environment(build.world(config), "torch"))


@pytest.fixture(scope="module")
def mixed() -> export.Subject:
    return subject("mixed")


@pytest.fixture(scope="module")
def exported(call, tmp_path_factory) -> Path:
    """The shipped policy as C, by the command."""
    folder = tmp_path_factory.mktemp("onboard") / "firmware"
    answer = call("export", "mixed", f"runs={folder.parent}", "--c", str(folder), "--observations", "100")
    assert answer.code == 0, answer.err
    assert "instructions per inference" in answer.out and "nobody has flown it" in answer.out
    return folder


@pytest.fixture(scope="module")
def library(exported):
    return export.compiled(exported, BOUNDS)


@pytest.mark.parametrize(("formation", "balls"), [("triangle", 0), ("square", 1), ("pentagon", 3), ("hexagon", 5)])
def test_the_commands_are_torchs(mixed, library, formation, balls):
    """Any number of drones and balls, from one export."""
    env = subject("mixed", f"scenario.formation={formation}", f"scenario.balls={balls}").env
    inputs = contract.record_midway(mixed.policy, env, 60, seed=balls, frames=6)
    parity = export.compare(library, mixed.policy, env, inputs, BOUNDS)
    assert parity.balls == max(balls, 1) and 0 < parity.worst <= 1e-5


def test_a_policy_that_sees_its_last_command(tmp_path):
    given = subject("sim_to_real", "scenario.balls=1")
    export.to_c(given, tmp_path / "c", 60, "crazyflie", BOUNDS)
    assert "#define POLICY_PREVIOUS_COMMAND 1 " in (tmp_path / "c" / "policy_config.h").read_text()


def fuzzed(count: int, dtype: np.dtype, seed: int) -> np.ndarray:
    """Records of any bits, and of reasonable numbers with a few impossible ones among them."""
    rng = np.random.default_rng(seed)
    noise = np.frombuffer(rng.bytes(count * dtype.itemsize), dtype).copy()
    half = count // 2
    words = noise[:half].view("<u4").reshape(half, -1)
    plausible = rng.normal(0, 3, words.shape).astype("<f4")
    odd = rng.choice(np.array([np.nan, np.inf, -np.inf, 3e38, -3e38, 1e-40, 0], "<f4"), words.shape)
    plausible = np.where(rng.random(words.shape) < 0.02, odd, plausible)
    noise[:half] = plausible.view(dtype).reshape(half)
    noise["attitude_wxyz"][:half, 0] = 1
    noise["attitude_wxyz"][:half, 1:] *= 0.02
    for name in ("neighbours", "balls", "columns"):
        noise[name] = rng.integers(0, 9, count)
    return noise


def test_nothing_leaves_the_limits(mixed, library):
    setpoints, problems = library.compute(fuzzed(4000, library.dtype, seed=1))
    drone = mixed.config.drone
    assert np.isfinite(setpoints["command"]).all() and np.abs(setpoints["command"]).max() <= 1
    assert np.abs(setpoints["body_rates_rad_s"]).max() <= np.float32(drone.rate_clip)
    low, high = drone.thrust_range
    assert (setpoints["thrust_share"] >= low).all() and (setpoints["thrust_share"] <= np.float32(high)).all()
    assert 0 < np.mean(problems & 1) < 1, "both halves are met: states that are refused and states that are flown"
    assert (problems & 16).any() and (problems & 2).any() and (problems & 4).any() and (problems & 8).any()


def one(library, **changed) -> np.ndarray:
    """A drone at 1.5 m with two neighbours, a ball and a column."""
    record = np.zeros(1, library.dtype)
    record["position_m"], record["attitude_wxyz"] = (0, 1, 1.5), (1, 0, 0, 0)
    record["neighbours"], record["balls"], record["columns"] = 2, 1, 1
    record["neighbour"]["position_m"][0, :2] = ((1, 0, 1.5), (-1, 0, 1.5))
    record["ball"]["position_m"][0, 0], record["column"]["axis_m"][0, 0] = (1, 3, 1.5), (0.5, 3)
    for name, value in changed.items():
        record[name] = value
    return record


def test_what_is_broken_counts_as_absent(library):
    """A neighbour, ball or column that is no number flies as if it were not there, and is told."""
    for what, member, problem in (("neighbour", "position_m", 2), ("ball", "velocity_m_s", 4), ("column", "axis_m", 8)):
        broken = one(library)
        count = f"{what}s"
        broken[what][member][0, int(broken[count][0]) - 1, 0] = np.nan
        absent = one(library, **{count: broken[count] - 1})
        (got, problems), (expected, none) = library.compute(broken), library.compute(absent)
        assert problems[0] == problem and none[0] == 0
        assert (got["command"] == expected["command"]).all()


@pytest.mark.parametrize("member", ["time_s", "position_m", "attitude_wxyz", "velocity_m_s", "body_rates_rad_s"])
def test_an_invalid_state_hovers(mixed, library, member):
    record = one(library)
    record[member] = np.nan
    setpoints, problems = library.compute(record)
    assert problems[0] == 1
    from envs.dynamics import hover_action

    assert setpoints["command"][0] == pytest.approx(hover_action(mixed.config.drone), abs=1e-6)


def test_softmax_of_large_numbers(mixed, tmp_path):
    """Weights a thousand times too large saturate and stay finite."""
    policy = Policy.load(methods.shipped()["mixed"])
    with torch.no_grad():
        policy.encoder.mix.query.weight *= 1e3
        policy.encoder.gather.query.weight *= 1e3
    inputs = contract.record_midway(mixed.policy, mixed.env, 12, seed=0, frames=3)
    vectors = c.golden(policy, mixed.env, inputs, BOUNDS, count=2)
    for name, text in sources.render(policy, mixed.env, BOUNDS, vectors, {}).items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    found = export.CompiledPolicy(toolchain.shared_library(tmp_path, tmp_path / "policy.so"), BOUNDS)
    setpoints, _ = found.compute(layout.pack(inputs, mixed.env, BOUNDS))
    assert np.isfinite(setpoints["command"]).all()


def test_the_cortex_m4_computes_the_same(exported, library, mixed):
    """Machine code of the target, on an emulator: the commands, and what they take (floors of the product)."""
    cortex_m4 = pytest.importorskip("formctl.deployment.cortex_m4")
    chip = cortex_m4.CortexM4(toolchain.firmware(exported, exported.parent / "policy.elf"), BOUNDS)
    assert chip.self_test()[0] == 0
    inputs = contract.record_midway(mixed.policy, mixed.env, 16, seed=5, frames=4)
    packed = layout.pack(inputs, mixed.env, BOUNDS)
    assert chip.compute(packed)[0]["command"] == pytest.approx(library.compute(packed)[0]["command"], abs=1e-5)
    told = read(exported)["c"]["cortex_m4"]
    assert told["flash"] <= 100 * 1024 and told["stack"] <= 12_000 and told["instructions"] <= 500_000


def test_the_contract_holds_the_golden_vectors(exported, library):
    told = read(exported)
    assert len(told["golden"]) == 8
    record = np.zeros(1, library.dtype)
    for vector in told["golden"]:
        record[:] = np.zeros(1, library.dtype)
        for name, value in vector["inputs"].items():
            if name in ("neighbour", "ball", "column"):
                for index, entry in enumerate(value):
                    for member, numbers in entry.items():
                        record[name][member][0, index] = numbers
            else:
                record[name] = value
        assert library.compute(record)[0]["command"][0] == pytest.approx(vector["command"], abs=1e-5)


def copied(exported: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(exported, tmp_path / "copy"))


def test_changed_cut_and_missing_files_are_refused(call, exported, tmp_path):
    folder = copied(exported, tmp_path)
    answer = call("export", "--check", str(folder))
    assert answer.code == 0 and "19 files as they were exported" in answer.out
    weights = folder / "policy_weights.h"
    text = weights.read_text()
    weights.write_text(text[: len(text) // 2])
    answer = call("export", "--check", str(folder))
    assert answer.code == 2 and "policy_weights.h was changed after the export (its hash differs)" in answer.line
    weights.unlink()
    assert "policy_weights.h is missing" in call("export", "--check", str(folder)).line
    contract_file = folder / "contract.json"
    contract_file.write_text(json.dumps(json.loads(contract_file.read_text()) | {"rate_hz": 100.0}))
    assert "contract.json was changed after the export" in call("export", "--check", str(folder)).line
    contract_file.write_text(contract_file.read_text()[:500])
    assert "contract.json is damaged" in call("export", "--check", str(folder)).line
    assert "holds no export" in call("export", "--check", str(tmp_path)).line


def test_the_c_itself_refuses_a_changed_weight(exported, tmp_path):
    """On board there is no contract: the self-test compares the weights' hash, and the golden commands."""
    folder = copied(exported, tmp_path)
    weights = folder / "policy_weights.h"
    lines = weights.read_text().splitlines(keepends=True)
    place = next(i for i, line in enumerate(lines) if line.startswith("    "))
    lines[place] = "    9.0f," + lines[place].split(",", 1)[1]
    weights.write_text("".join(lines))
    with pytest.raises(RunFailed, match=r"its self-test says [15]"):
        export.compiled(folder, BOUNDS)


def test_files_of_two_exports_do_not_compile_together(exported, tmp_path):
    folder = copied(exported, tmp_path)
    config = folder / "policy_config.h"
    config.write_text(config.read_text().replace("POLICY_EXPORT 0x", "POLICY_EXPORT 0x1"))
    with pytest.raises(RunFailed, match="another export"):
        export.compiled(folder, BOUNDS)


def test_another_layout_is_refused(exported):
    with pytest.raises(RunFailed, match=r"its inputs take \d+ bytes, not \d+"):
        export.compiled(exported, Bounds(balls=4))


@pytest.mark.parametrize(
    ("words", "answer"),
    [
        (("encoder=no_sa",), "--c exports encoder=attention, not encoder="),
        (("observation=paper_raw",), "--c exports observation=paper "),
        (("encoder.width=192",), "the policy does not fit crazyflie"),
    ],
)
def test_what_c_does_not_compute_is_refused_in_one_line(words, answer):
    from algos.policy import Policy

    config = compose(["scenario=mixed", *words])
    env = build.environment(build.world(config), "torch")
    policy = Policy(config.encoder, env.layout, config.observation, "crazyflie", 2)
    with pytest.raises(ValueError, match=answer) as found:
        c.check(policy, env)
        c.fit(policy, BOUNDS, c.TARGETS["crazyflie"])
    assert "\n" not in str(found.value)


@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_it_compiles_without_a_warning(exported, compiler, tmp_path):
    if not shutil.which(compiler):
        pytest.skip(f"{compiler} is not installed")
    for source in sorted(exported.glob("*.c")):
        subprocess.run([compiler, *WARNINGS, "-c", str(source), "-o", str(tmp_path / "o")], check=True)
    application = sorted((exported / "crazyflie" / "src").glob("*.c"))
    assert len(application) == 4
    for source in application:
        options = ["-std=gnu11", "-O1", *toolchain.WARNINGS, f"-I{STUBS}"]
        subprocess.run([compiler, *options, "-c", str(source), "-o", str(tmp_path / "o")], check=True)


def test_the_application_guards_and_listens(exported, tmp_path):
    """The guard and the packets, in C on this machine (crazyflie_test.c says what is tested)."""
    application = exported / "crazyflie" / "src"
    sources = [Path(__file__).parent / "crazyflie_test.c", application / "guard.c", application / "radio.c"]
    binary = tmp_path / "crazyflie_test"
    options = ["-std=gnu11", *toolchain.WARNINGS, f"-I{application}", f"-I{exported}"]
    toolchain.compile_c(toolchain.host_compiler(), options, sources, binary)
    done = subprocess.run([binary], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
    assert not math.isnan(float(done.stdout.split()[0]))


def test_a_missing_compiler_is_one_line(monkeypatch):
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(toolchain.shutil, "which", lambda name: None)
    monkeypatch.setattr(toolchain, "find_spec", lambda name: None)
    with pytest.raises(ValueError, match="there is no C compiler here: install gcc or clang"):
        toolchain.host_compiler()
    with pytest.raises(ValueError, match=r"pip install 'formctl\[onboard\]'"):
        toolchain.cross_compiler()


def test_an_evaluation_in_another_body(call, tmp_path):
    """The exported C flies the same episodes; the emulated chip is another body of the same kind."""
    words = ("eval.compile=false", "eval.seconds=0.3", "eval.time_limit=0.2", "scenario=mixed", f"runs={tmp_path}")
    answer = call("eval", "--policy", "mixed", "--body", "torch,c,cortex-m4", "--episodes", "2", "--jobs", "1", *words)
    assert answer.code == 0, answer.err
    assert "against torch, on the same episodes" in answer.out
    names = {run.record["method"].get("body"): run for run in store.scan(tmp_path, kind="eval")}
    assert set(names) == {None, "c", "cortex-m4"}
    rows = {body: read_rows(run.path / "episodes.parquet") for body, run in names.items()}
    for body in ("c", "cortex-m4"):
        assert rows[body]["fm"].to_numpy() == pytest.approx(rows[None]["fm"].to_numpy(), abs=1e-4)
        assert set(rows[body]["method"]) == {f"dense ({body})"}


def test_an_unknown_body_is_one_line(call):
    answer = call("eval", "--policy", "mixed", "--body", "fpga")
    assert answer.code == 2 and "there is no body 'fpga', only torch, onnx, c, cortex-m4" in answer.line
