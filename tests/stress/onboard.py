"""The exported C in full: recorded observations of 3 to 6 drones and 0 to 5 balls against PyTorch, and sanitizers.

    python tests/stress/onboard.py [POLICY] [OBSERVATIONS]

Parity first, then the recorded and as many fuzzed inputs through a binary built with AddressSanitizer and
UndefinedBehaviorSanitizer. Prints a table; fails where a command differs by more than 1e-5 or a sanitizer speaks.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from algos.export import c, contract, layout
from algos.export.layout import Bounds
from formctl.deployment import export, toolchain
from formctl.evaluation import methods
from formctl.settings import build, compose

FORMATIONS = ("triangle", "square", "pentagon", "hexagon")
BALLS = range(6)
SANITIZERS = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-fno-omit-frame-pointer", "-g", "-O1"]
DRIVER = r"""
#include <stdio.h>
#include "policy.h"
int main(void) {
    struct policy_inputs inputs;
    struct policy_setpoint setpoint;
    unsigned long count = 0, outside = 0;
    while (fread(&inputs, sizeof inputs, 1, stdin) == 1) {
        (void)policy_compute(&inputs, &setpoint);
        int inside = setpoint.thrust_share >= POLICY_THRUST_LEAST_SHARE;
        inside = inside && setpoint.thrust_share <= POLICY_THRUST_MOST_SHARE;
        for (int i = 0; i < 3; i++) {
            inside = inside && setpoint.body_rates_rad_s[i] >= -POLICY_RATE_CLIP_RAD_S &&
                     setpoint.body_rates_rad_s[i] <= POLICY_RATE_CLIP_RAD_S;
        }
        outside += !inside;
        count++;
    }
    printf("%lu %lu\n", count, outside);
    return outside != 0;
}
"""


def subject(name: str, *words: str) -> export.Subject:
    """The policy in the mixed scene with other drones and balls."""
    config = compose(["scenario=mixed", *words])
    method = methods.policy(name, config.runs)
    config = method.settings_of(config)
    return export.Subject(method, config, build.environment(build.world(config), "torch"))


def fuzzed(count: int, dtype: np.dtype) -> np.ndarray:
    """Half any bits, half plausible numbers with impossible ones among them."""
    rng = np.random.default_rng(0)
    records = np.frombuffer(rng.bytes(count * dtype.itemsize), dtype).copy()
    words = records[: count // 2].view("<u4").reshape(count // 2, -1)
    odd = rng.choice(np.array([np.nan, np.inf, -np.inf, 3e38, -3e38, 1e-40, 0, 1e4, -1e4], "<f4"), words.shape)
    plausible = np.where(rng.random(words.shape) < 0.02, odd, rng.normal(0, 3, words.shape)).astype("<f4")
    records[: count // 2] = plausible.view(dtype).reshape(-1)
    records["attitude_wxyz"][: count // 2] = (1, 0, 0, 0)
    records["previous_command"][: count // 2] = 0
    for name in ("neighbours", "balls", "columns"):
        records[name] = rng.integers(0, 9, count)
    return records


def sanitized(folder: Path, records: np.ndarray, name: str) -> None:
    """Run ``records`` through the C under both sanitizers. Raises SystemExit for a finding."""
    driver = folder / "driver.c"
    driver.write_text(DRIVER)
    binary = folder / "driver"
    toolchain.compile_c(toolchain.host_compiler(), ["-std=c99", *SANITIZERS], [driver, folder / "policy.c"], binary)
    done = subprocess.run([binary], input=records.tobytes(), capture_output=True)
    if done.returncode:
        raise SystemExit(f"{name}: {done.stdout.decode()} {done.stderr.decode()[:2000]}")
    print(f"sanitizers, {name}: {done.stdout.decode().split()[0]} inputs, no finding, none outside the limits")


def main(name: str = "mixed", observations: int = 10_000) -> None:
    """Parity, then sanitizers."""
    bounds = Bounds()
    given = subject(name)
    each = -(-observations // (len(FORMATIONS) * len(BALLS)))
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "c"
        export.to_c(given, folder, 100, "crazyflie", bounds)
        library = export.compiled(folder, bounds)
        worst, count, packed = 0.0, 0, []
        for formation in FORMATIONS:
            for balls in BALLS:
                env = subject(name, f"scenario.formation={formation}", f"scenario.balls={balls}").env
                inputs = contract.record_midway(given.policy, env, each, seed=balls)
                records = layout.pack(inputs, env, bounds)
                difference = library.compute(records)[0]["command"] - c.setpoints(given.policy, env, inputs)[2]
                largest = float(np.abs(difference).max())
                print(f"{formation:9} {balls} balls: {len(records):6,} commands, largest difference {largest:.1e}")
                worst, count = max(worst, largest), count + len(inputs["time"])
                packed.append(records)
        print(f"{count:,} observations, largest difference of a command {worst:.1e}")
        recorded = np.concatenate(packed)
        sanitized(folder, recorded[:: max(1, len(recorded) // observations)], "recorded")
        sanitized(folder, fuzzed(observations, recorded.dtype), "fuzzed")
    if worst > export.TOLERANCE:
        raise SystemExit(f"{worst:.1e} is more than {export.TOLERANCE:.0e}")


if __name__ == "__main__":
    main(*sys.argv[1:2], *map(int, sys.argv[2:3]))
