"""Several trainings in one call (``formctl train -m seed=0,1,2``): the same call again finishes what is missing."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from formctl import store
from formctl.console import say, table, warn
from formctl.errors import RunFailed
from formctl.settings import Config, build, expand_sweep
from formctl.stages import train
from formctl.store import Run
from formctl.store.compare import fingerprint
from formctl.store.files import StoreError


@dataclass(frozen=True)
class SweepMember:
    """One combination of a sweep."""

    words: tuple[str, ...]
    config: Config
    origin: str  # of its weights

    @property
    def digest(self) -> str:
        """Equal for equal settings."""
        return fingerprint(self.config.tree)


def train_all(overrides: Sequence[str]) -> list[Run]:
    """Train every combination of the comma lists, one after another; all settings are checked before the first begins.

    A member that is done already is left as it is, one that was stopped goes on, one that fails does not keep the
    others from their turn. Raises RunFailed at the end where some failed, KeyboardInterrupt at once.
    """
    combinations = expand_sweep(overrides)
    members = [SweepMember(tuple(words), *train.compose_training(words)) for words in combinations]
    for member in members:
        build.training(member.config)
    sweep = fingerprint({"members": [member.digest for member in members]})
    varied = [word for word in combinations[0] if word not in combinations[-1]]
    labels = [label(member, [word.partition("=")[0] for word in varied]) for member in members]
    runs: list[Run] = []
    failures: list[str] = []
    for member, name in zip(members, labels, strict=True):
        say(f"training {len(runs) + len(failures) + 1} of {len(members)}: {name}")
        try:
            with goes_on():
                runs.append(train_member(member, sweep))
        except (RunFailed, StoreError) as error:
            failures.append(f"{name}: {error}")
            warn(f"{name} failed: {error}")
    states = {run.record["settings"]: run for run in runs}
    lines = [
        (name, "done" if member.digest in states else "failed", getattr(states.get(member.digest), "path", ""))
        for member, name in zip(members, labels, strict=True)
    ]
    table(("training", "status", "run"), lines)
    if failures:
        raise RunFailed(
            f"{len(failures)} of {len(members)} trainings failed; the same command again tries them once more"
        )
    return runs


def train_member(member: SweepMember, sweep: str) -> Run:
    """Train one member, go on with it where it stopped, or find that it is done."""
    earlier = [
        run
        for run in store.scan(member.config.runs, kind="train", name=member.config.name)
        if run.record.get("sweep") == sweep and run.record.get("settings") == member.digest
    ]
    if done := next((run for run in earlier if run.status == "done"), None):
        say(f"there already: {done.path}")
        return done
    if stopped := next((run for run in earlier if run.status in ("interrupted", "failed", "created")), None):
        train.announce(member.config, train.steps_done(stopped), member.origin)
        train.fit(stopped, member.config)
        return stopped
    return train.execute(member.config, origin=member.origin, sweep=sweep, settings=member.digest)


def label(member: SweepMember, keys: Sequence[str]) -> str:
    """The words in which members differ."""
    return " ".join(word for word in member.words if word.partition("=")[0] in keys) or member.config.name


@contextmanager
def goes_on() -> Iterator[None]:
    """An interrupt tells how the whole sweep goes on, not only the member that was at work."""
    try:
        yield
    except KeyboardInterrupt as stop:
        said = str(stop).partition("; go on with")[0] or "interrupted"
        raise KeyboardInterrupt(f"{said}; the same command again goes on with this training and the rest") from stop
