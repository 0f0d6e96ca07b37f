"""What a user reads after a mistake, word for word, and the exit code that goes with it."""

import signal
import subprocess
import sys
import types
from collections.abc import Callable
from pathlib import Path

import pytest

from formctl import cli
from formctl.errors import RunFailed
from tests.cli.conftest import Result

SCENARIOS = "base, dynamic, fixed4, free, mixed, real, real_dynamic, real_mixed, real_static, stage1, static"
WRONG_CALLS = {
    # commands and options
    "trian": "No such command 'trian'. Did you mean 'train'?",
    "conf shwo": "No such command 'shwo'. Did you mean 'show'?",
    "conf show --mutlirun": "No such option: --mutlirun (Possible options: --multirun)",
    "bank create": "Missing option '--out'.",
    "train --seed 3": "No such option: --seed; settings are written without dashes, as KEY=VALUE",
    # the form of an override
    "conf show foo": "cannot read 'foo': write KEY=VALUE, for example seed=3",
    "conf show +a=3": "cannot read '+a=3': keys can be set, not added or deleted; write KEY=VALUE",
    "conf show ~seed": "cannot read '~seed': keys can be set, not added or deleted; write KEY=VALUE",
    "conf show seed=1,2": "seed=1,2 lists several values: add -m to run each of them",
    # names
    "conf show scenario.colums=3": "unknown key 'scenario.colums': did you mean 'scenario.columns'?",
    "conf show columns=3": "unknown key 'columns': did you mean 'scenario.columns'?",
    "conf show zzz=3": "unknown key 'zzz'; formctl conf keys lists them all",
    "conf show hydra.verbose=true": "unknown key 'hydra.verbose'; formctl conf keys lists them all",
    "conf show scenario=mixd": f"scenario has no choice 'mixd': did you mean 'mixed'?; the choices are {SCENARIOS}",
    "conf show scenario=null": f"scenario cannot be left out; the choices are {SCENARIOS}",
    "conf show profile=big": "profile has no choice 'big'; the choices are laptop, paper, smoke",
    "conf keys nothing": "no key starts with 'nothing'; formctl conf keys lists them all",
    # values
    "conf show search.trials=0": "search.trials=0 cannot be used: it should be greater than or equal to 1",
    "conf show search.trials=-3": "search.trials=-3 cannot be used: it should be greater than or equal to 1",
    "conf show eval.seconds=-1": "eval.seconds=-1 cannot be used: it should be greater than 0",
    "conf show seed=true": "seed=true cannot be used: it should be a valid integer",
    "conf show seed=1.5": "seed=1.5 cannot be used: it should be a valid integer",
    "conf show scenario.columns=many": 'scenario.columns="many" cannot be used: it should be a valid integer',
    "conf show scenario.ball_aim=x": "scenario.ball_aim=\"x\" cannot be used: it should be 'drone', 'box' or 'mix'",
    "conf show scenario.field=[1]": "scenario.field=[1] cannot be used: it should have more values",
    "conf show scenario.field=[1,2,3]": "scenario.field=[1, 2, 3] cannot be used: "
    "it should have at most 2 items, not 3",
    "conf show train.checkpoint_minutes=inf": "train.checkpoint_minutes=Infinity cannot be used: "
    "it should be a finite number",
    "conf show reward.target=os.system": "reward.target=os.system names no settings: it has to be a dataclass",
    "conf show reward.target=nope.Nope": "reward.target=nope.Nope cannot be imported (No module named 'nope')",
    # what only several values together can tell
    "conf show scenario.columns=513": "scenario.columns=513: the zigzag layout has 512 places for columns",
    "conf show scenario=fixed4 scenario.columns=5": "scenario.columns=5: the fixed4 layout has 4 places for columns",
    "conf show search.scenario.columns=600": "search.scenario.columns=600: "
    "the zigzag layout has 512 places for columns",
    "conf show scenario.balls=-1": "scenario.balls=-1: there cannot be less than none",
    "conf show weights=uniform weights.action=0.6": "the weights 0.25, 0.25, 0.25, 0.6 sum to 1.35, not to 1: "
    "set all four (weights.formation= weights.flight= weights.obstacle= weights.action=)",
    "conf show weights=uniform weights.action=-0.1": "weights.action=-0.1 cannot be used: "
    "it should be greater than or equal to 0",
    "conf show weights=@pilot/best": "weights=@pilot/best cannot be used here: "
    "give weights=NAME or the four weights.KEY=",
    "conf show algo=mappo_fast algo.minibatches=7": "algo.envs * algo.rollout = 16384 does not divide into "
    "algo.minibatches=7: change one of the three",
    # files
    "bank show nothing.npz": "no bank at nothing.npz: make one with 'formctl bank create --out nothing.npz'",
    "bank create --episodes 0 --out b.npz": "Invalid value for '--episodes': Input should be greater than or equal "
    "to 1",
    "replay x.mcap --video r5.png --out r5": "--video r5.png cannot be made: the film has to end in .mp4 or .gif",
    # methods
    "deploy --dry-run main:0 --baseline hover": "--dry-run flies an episode with the method that flew it: "
    "leave --baseline out",
    "deploy --dry-run main:0 --policy mixed --policy swarm_rl": "--dry-run flies an episode with the one policy "
    "that flew it: give --policy once",
}


@pytest.mark.parametrize("call", WRONG_CALLS)
def test_a_wrong_call_gets_one_line_and_exit_code_2(call: str, formctl: Callable[..., Result]) -> None:
    result = formctl(*call.split())
    assert result == Result(2, "", f"formctl: {WRONG_CALLS[call]}\n")


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch) -> Callable[[BaseException], None]:
    """Make ``formctl demo`` raise what the test wants."""

    def install(error: BaseException) -> None:
        def fails() -> None:
            raise error

        module = types.SimpleNamespace(command=fails)
        monkeypatch.setattr(cli, "import_module", lambda name: module)

    return install


Raising = Callable[[BaseException], None]


def test_a_failed_run_is_one_line_and_exit_code_1(command: Raising, formctl: Callable[..., Result]) -> None:
    command(RunFailed("training diverged at step 7:\n  see runs/train/main/x/log.txt"))
    assert formctl("demo") == Result(1, "", "formctl: training diverged at step 7: see runs/train/main/x/log.txt\n")


def test_a_full_disk_is_one_line_and_exit_code_1(command: Raising, formctl: Callable[..., Result]) -> None:
    command(OSError(28, "No space left on device", "runs/x"))
    assert formctl("demo") == Result(1, "", "formctl: runs/x: no space left on device\n")


def test_an_unforeseen_error_names_the_file_with_its_traceback(
    command: Raising, formctl: Callable[..., Result]
) -> None:
    command(KeyError("speed"))
    result = formctl("demo")
    assert result.code == 1
    start = "formctl: KeyError: 'speed'; the details are in "
    assert result.err.startswith(start)
    log = Path(result.err.removeprefix(start).strip())
    assert "raise error" in log.read_text()
    log.unlink()


def test_developers_can_have_the_traceback(
    command: Raising, formctl: Callable[..., Result], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FORMCTL_TRACEBACK", "1")
    command(ValueError("no"))
    with pytest.raises(ValueError, match="no"):
        formctl("demo")


def test_an_interrupt_says_how_to_go_on(command: Raising, formctl: Callable[..., Result]) -> None:
    command(KeyboardInterrupt())
    assert formctl("demo") == Result(130, "", "formctl: interrupted; the same command again goes on where it stopped\n")
    command(KeyboardInterrupt("interrupted: formctl train --resume 1234 goes on"))
    assert formctl("demo") == Result(130, "", "formctl: interrupted: formctl train --resume 1234 goes on\n")


def test_ctrl_c_on_a_real_process_ends_it_with_130() -> None:
    program = (
        "import signal, types; from formctl import cli; "
        "signal.signal(signal.SIGINT, signal.default_int_handler); "  # a job in the background may ignore it
        "wait = lambda: (print('ready', flush=True), signal.pause()); "
        "cli.import_module = lambda name: types.SimpleNamespace(command=wait); raise SystemExit(cli.run(['demo']))"
    )
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", program], stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert process.stdout.readline() == "ready\n"
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 130
        assert process.stderr.read() == "formctl: interrupted; the same command again goes on where it stopped\n"


def test_a_closed_pipe_is_no_error() -> None:
    line = f"{sys.executable} -m formctl --help | true"
    done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=False)
    assert done.stderr == ""
